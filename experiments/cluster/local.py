"""Work on a local Ray cluster whose workers come and go, beside the same work in one process.

Usage: python experiments/cluster/local.py OUT.json [--episodes 600] [--draws 30]

Each worker is a node of its own with one CPU. Half way through a command one is killed and another one added.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from ray.cluster_utils import Cluster

MEMORY = 200_000_000
"""Bytes of a node's object store."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--episodes", type=int, default=600)
    parser.add_argument("--draws", type=int, default=30)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = measured(Path(folder), args.episodes, args.draws)
    args.out.write_text(json.dumps({"cpus": os.cpu_count(), **found}, indent=1) + "\n")
    print(json.dumps(found, indent=1))


SWEEP = Path(__file__).with_name("sweep.yaml")
COMMANDS = {
    "collect": "collect --episodes {episodes} --batch 50 --seed 3",
    "sweep": "sweep --config {sweep}",
    "insertion": "evaluate insertion --trials {draws} --seeds 2 --part-rows 20 --methods full,no_update",
}


def measured(folder: Path, episodes: int, draws: int) -> dict[str, Any]:
    """Return what came of each command, and its seconds."""
    filled = {
        name: words.format(episodes=episodes, draws=draws, sweep=SWEEP) for name, words in COMMANDS.items()
    }
    return {name: compared(words.split(), folder / name) for name, words in filled.items()}


def compared(words: list[str], folder: Path) -> dict[str, Any]:
    """Run a command in one process, with workers, with workers that come and go, and with a driver killed."""
    folder.mkdir()

    def out(name: str) -> Path:
        return folder / (f"{name}.json" if words[0] == "evaluate" else name)

    def same(name: str) -> bool:
        return digests(out(name)) == digests(out("one"))

    found: dict[str, Any] = {"one_process_s": run([*words, "--threads", "1"], out("one"))}
    for workers in (1, 2):
        name = f"workers_{workers}"
        found[f"{name}_s"] = on_cluster(workers, lambda address, name=name: run(words, out(name), address))
        found[f"{name}_same"] = same(name)
    half = found["workers_2_s"] / 2
    found["lost_and_added_s"] = on_cluster(
        3, lambda address: run(words, out("lost"), address), lambda cluster: change(cluster, half)
    )
    found["lost_and_added_same"] = same("lost")
    on_cluster(2, lambda address: twice(words, out("again"), address, half))
    return found | {"driver_killed_same": same("again")}


def on_cluster(
    workers: int, work: Callable[[str], float], disturb: Callable[[Cluster], None] = lambda _: None
) -> float:
    """Return the seconds of some work on a cluster, which is disturbed meanwhile."""
    cluster = Cluster(
        initialize_head=True,
        head_node_args={"num_cpus": 0, "include_dashboard": False, "object_store_memory": MEMORY},
    )
    try:
        for _ in range(workers):
            cluster.add_node(num_cpus=1, object_store_memory=MEMORY)
        with ThreadPoolExecutor() as threads:
            seconds = threads.submit(work, str(cluster.address))
            disturb(cluster)  # Ray starts nodes in the main thread only
            return seconds.result()
    finally:
        cluster.shutdown()


def change(cluster: Cluster, after_s: float) -> None:
    """Kill a worker and add another."""
    time.sleep(after_s)
    cluster.remove_node(cluster.list_all_nodes()[-1], allow_graceful=False)
    cluster.add_node(num_cpus=1, object_store_memory=MEMORY)


def run(words: list[str], out: Path, address: str | None = None, timeout_s: float | None = None) -> float:
    """Run a command of the library, and return its seconds."""
    more = ["--cluster", address] if address else []
    command = [sys.executable, "-m", "mjx_fit", *words, "--out", str(out), *more]
    began = time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=timeout_s)
    return round(time.monotonic() - began, 1)


def twice(words: list[str], out: Path, address: str, kill_after_s: float) -> float:
    """Kill the driver, and start it again."""
    try:
        run(words, out, address, kill_after_s)
    except subprocess.TimeoutExpired:
        print(f"the driver of {words[0]} was killed after {kill_after_s:.0f} s", file=sys.stderr)
    return run(words, out, address)


def digests(out: Path) -> dict[str, str]:
    """Return the digest of each shard, or of a result's trials."""
    out = out / "sweep.json" if (out / "sweep.json").is_file() else out
    if out.is_dir():
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(out.glob("*.h5"))}
    trials = json.loads(out.read_text())["trials"]
    return {out.suffix: hashlib.sha256(json.dumps(trials).encode()).hexdigest()}


if __name__ == "__main__":
    main()
