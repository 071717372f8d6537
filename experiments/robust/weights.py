"""Collect data and train the weights that ship; run the same command again to resume.

    python experiments/robust/weights.py OUT
    python experiments/robust/weights.py OUT --unrandomised    as many attempts, nothing randomised

OUT receives a data set for each entry of ``SETS``, and the training run ``run``. Unrandomised, every set is
of the world ``paper`` (``forge`` and ``far`` go to ``paper_2`` and ``paper_far``), readings have the errors
of ``home``, and the run is ``run_unrandomised``: it differs in the randomisation, not in size.
Readings are simulated when a trace is read, so that the data of the world ``paper`` serve every measurement.
In ``far`` the detector errs by up to 3 cm: a sensor that never started far from the hole is sure of itself
there, and wrong. A whole set of such starts instead of ``forge`` costs accuracy in ``forge``.
"""

import argparse
from pathlib import Path

from mjx_fit.report import script

FAR = ("--set", "detector.half_width_m=0.03", "--set", "detector.prior_std_m=0.015")
SETS = {
    "paper": ("paper", "--episodes", "12000", "--seed", "24"),
    "forge": ("forge", "--episodes", "12000", "--seed", "25"),
    "far": ("forge", "--episodes", "6000", "--seed", "28", *FAR),
}
"""World and options of each data set."""
UNRANDOMISED = {"paper": "paper", "forge": "paper_2", "far": "paper_far"}
"""Name of each data set where nothing is randomised."""


def main(out: Path, *, randomised: bool) -> None:
    names = {name: name for name in SETS} if randomised else UNRANDOMISED
    for name, (drawn, *options) in SETS.items():
        world = drawn if randomised else "paper"
        script.command("collect", "--out", out / names[name], "--sequence", "3", "--world", world, *options)
    run = out / ("run" if randomised else "run_unrandomised")
    training = ["--world", "forge" if randomised else "home", "--config", "configs/cpu.yaml"]
    script.command("train", "--data", *(out / name for name in names.values()), "--out", run, *training)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--unrandomised", action="store_true")
    asked = parser.parse_args()
    main(asked.out, randomised=not asked.unrandomised)
