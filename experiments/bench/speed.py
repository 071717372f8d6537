"""Speed of sockets and pegs askew with commands of six dimensions, beside upright ones and an older version.

    git worktree add OLD a82d773^
    python experiments/bench/speed.py OLD OUT.json [--repeats K]

OLD is a tree of the library before poses. Simulated seconds per second of open-loop spirals on holes that do
not match, so that an attempt lasts 10 s: in FORGE's dynamics, upright, by both trees; and in the world
`bench`, with a tool that rocks and with one that does not. Each case has a process of its own, which compiles
first; they take turns.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[2]
WORLDS = {"native": 128, "mjx": 16}
ONE = """
import sys, time
import jax, numpy as np
from mjx_fit import draw_attempts, make_engine
from mjx_fit.utils.rates import ACTION_S
from mjx_fit.config.files import read_config
from pathlib import Path
engine, worlds, file, *sets = sys.argv[1], int(sys.argv[2]), *sys.argv[3:]
config = read_config([Path(file)], sets)
attempts = draw_attempts(jax.random.key(1), 2 * worlds, config=config)
apart = np.flatnonzero(np.asarray(attempts.peg_type) != np.asarray(attempts.hole_type))[:worlds]
attempts = jax.tree.map(lambda leaf: leaf[apart], attempts)
run = make_engine(engine, config).run
run(attempts)
began = time.perf_counter()
done = run(attempts)
print(ACTION_S * float(np.sum(done.felt.length)) / (time.perf_counter() - began))
"""


STILL = ("spiral.tilt_rad=0", "spiral.yaw_rad=0")


def rate(tree: Path, world: str, sets: tuple[str, ...], engine: str) -> float:
    """Return the simulated seconds per second of one process, after a run that compiles."""
    file = tree / "configs/worlds" / f"{world}.yaml"
    command = [sys.executable, "-c", ONE, engine, str(WORLDS[engine]), str(file), *sets]
    env = {**os.environ, "PYTHONPATH": str(tree)}
    done = subprocess.run(command, cwd=tree, env=env, capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1])


def main(old: Path, out: Path, repeats: int) -> None:
    from mjx_fit.report import script

    cases = {
        "before": (old.resolve(), "forge", ()),
        "upright": (HERE, "forge", ()),
        "askew": (HERE, "bench", ()),
        "askew, the tool does not rock": (HERE, "bench", STILL),
    }
    told = {}
    for engine, worlds in WORLDS.items():
        rates: dict[str, list[float]] = {name: [] for name in cases}
        for _ in range(repeats):
            for name, (tree, world, sets) in cases.items():
                rates[name].append(rate(tree, world, sets, engine))
                print(engine, name, rates[name][-1], flush=True)
        ratio = {name: float(np.median(np.divide(own, rates["before"]))) for name, own in rates.items()}
        told[engine] = {"worlds": worlds, "simulated_s_per_s": rates, "median_ratio_to_before": ratio}
    script.save(out, told)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("old", type=Path, metavar="OLD")
    parser.add_argument("out", type=Path, metavar="OUT.json")
    parser.add_argument("--repeats", type=int, default=3, metavar="K")
    asked = parser.parse_args()
    main(asked.old, asked.out, asked.repeats)
