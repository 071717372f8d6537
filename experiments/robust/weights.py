"""Collect data and train the weights that ship; run the same command again to resume.

    python experiments/robust/weights.py OUT                   under two hours on two cores
    python experiments/robust/weights.py OUT --unrandomised    the first data set alone, nothing randomised

OUT receives the data sets ``paper`` and ``forge``, and the training run ``run`` or ``run_unrandomised``.
Readings are simulated when a trace is read, so that the data of the world ``paper`` serve every measurement.
"""

import argparse
import subprocess
import sys
from pathlib import Path

SEEDS = {"paper": 24, "forge": 25}
EPISODES, SEQUENCE = 12_000, 3


def main(out: Path, *, randomised: bool) -> None:
    worlds = SEEDS if randomised else {"paper": SEEDS["paper"]}
    for world, seed in worlds.items():
        amount = ["--episodes", EPISODES, "--sequence", SEQUENCE, "--seed", seed]
        _command("collect", "--out", out / world, "--world", world, *amount)
    run = out / ("run" if randomised else "run_unrandomised")
    training = ["--world", "forge" if randomised else "home", "--config", "configs/cpu.yaml"]
    _command("train", "--data", *(out / world for world in worlds), "--out", run, *training)


def _command(*words: object) -> None:
    """Run a command of the library; it does nothing if it has finished before."""
    subprocess.run([sys.executable, "-m", "mjx_fit", *map(str, words)], check=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--unrandomised", action="store_true")
    asked = parser.parse_args()
    main(asked.out, randomised=not asked.unrandomised)
