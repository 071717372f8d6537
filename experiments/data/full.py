"""Measure time and memory of collecting the full data set: ``python experiments/data/full.py DIR``.

The data go to DIR; the numbers and figures go next to this file, named after DIR.
"""

import resource
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import jax

from mjx_fit.config.schema import config_from_tree
from mjx_fit.data import reader
from mjx_fit.data.episode import happened
from mjx_fit.data.manifest import read_manifest
from mjx_fit.report import script
from mjx_fit.report.figures import data_set

HERE = Path(__file__).parent
EPISODES = 3000


def main(folder: Path) -> None:
    if folder.exists():
        sys.exit(f"{folder} already exists: a finished collection cannot be timed")
    argv = ["collect", "--out", str(folder), "--policy", "random", "--actions", "200"]
    argv += ["--episodes", str(EPISODES)]
    began = time.monotonic()
    subprocess.run([sys.executable, "-m", "mjx_fit", *argv], check=True)
    seconds = time.monotonic() - began
    peak_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024

    episodes, there = reader.load(folder), read_manifest(folder)
    keep = happened(episodes)
    data = jax.tree.map(lambda leaf: leaf[keep], episodes.rollout)
    results = {
        "seconds": round(seconds, 1),
        "peak_memory_mb": round(peak_mb),
        "request": {name: value for name, value in there.request.items() if name != "config"},
        "holds": reader.describe(folder),
    }
    config = config_from_tree(there.request["config"])
    script.save(HERE / f"{folder.name}.json", results)
    for name, figure in (
        ("visited", lambda data, config: data_set.visited_positions(data)),
        ("lengths", lambda data, config: data_set.interaction_lengths(data, config.scene.names)),
        ("forces", data_set.forces_by_pair),
    ):
        script.draw(
            HERE / f"{folder.name}_{name}.png",
            partial(figure, data, config),
        )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(f"usage: python {sys.argv[0]} DIR")
    main(Path(sys.argv[1]))
