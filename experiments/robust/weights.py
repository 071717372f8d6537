"""Collect data and train the weights that ship; run the same command again to resume.

    python experiments/robust/weights.py OUT
    python experiments/robust/weights.py OUT --unrandomised    the first data set alone, nothing randomised

OUT receives a data set for each entry of ``SETS``, and the training run ``run`` or ``run_unrandomised``.
Readings are simulated when a trace is read, so that the data of the world ``paper`` serve every measurement.
In ``far`` the detector errs by up to 3 cm: a sensor that never started far from the hole is sure of itself
there, and wrong. A whole set of such starts instead of ``forge`` costs accuracy in ``forge``.
"""

import argparse
import subprocess
import sys
from pathlib import Path

FAR = ("--set", "detector.half_width_m=0.03", "--set", "detector.prior_std_m=0.015")
SETS = {
    "paper": ("--world", "paper", "--episodes", "12000", "--seed", "24"),
    "forge": ("--world", "forge", "--episodes", "12000", "--seed", "25"),
    "far": ("--world", "forge", "--episodes", "6000", "--seed", "28", *FAR),
}
"""Options of each data set; the first is the one without randomised physics."""


def main(out: Path, *, randomised: bool) -> None:
    sets = SETS if randomised else {"paper": SETS["paper"]}
    for name, options in sets.items():
        _command("collect", "--out", out / name, "--sequence", "3", *options)
    run = out / ("run" if randomised else "run_unrandomised")
    training = ["--world", "forge" if randomised else "home", "--config", "configs/cpu.yaml"]
    _command("train", "--data", *(out / name for name in sets), "--out", run, *training)


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
