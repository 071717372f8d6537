"""Train a sensor on NIST's eight pegs and three plug noses; run the same command again to resume.

    python experiments/parts/learned.py OUT [--until data|training|evaluation]

World ``forge``, parts ``nist``, task ``nist.yaml``: detections within 5 mm. OUT receives the data sets
``learn`` and ``held_out``, the training run ``run``, and results of ``evaluate``. A stage is commands
of the library, which continue where they were stopped.
"""

import argparse
from pathlib import Path

from mjx_fit.report import script

HERE = Path(__file__).parent
TASK = ("--world", "forge", "--parts", "nist", "--config", HERE / "nist.yaml")
EVALUATIONS = {
    "position": ("full", 300),
    "insertion": ("full,no_update,sample,oracle", 120, "--seeds", 1),
    "assembly": ("full,failure_only,oracle", 20),
}
STAGES = ("data", "training", "evaluation")


def main(out: Path, until: str) -> None:
    """Run the stages up to the one asked for."""
    reached = STAGES.index(until)
    script.command(
        "collect", "--out", out / "learn", "--episodes", 9_000, "--sequence", 3, "--seed", 34, *TASK
    )
    script.command(
        "collect", "--out", out / "held_out", "--episodes", 2_000, "--sequence", 3, "--seed", 35, *TASK
    )
    if reached >= 1:
        training = ("--config", HERE.parents[1] / "configs" / "cpu.yaml")
        script.command("train", "--data", out / "learn", "--out", out / "run", *TASK, *training)
    if reached >= 2:
        own = ("--run", out / "run", *TASK)
        held_out = ("--data", out / "held_out", *own)
        script.command("evaluate", "calibration", "--out", out / "calibration.json", *held_out)
        script.command("evaluate", "attempt", "--out", out / "attempt.json", "--trials", 100, *TASK)
        for experiment, (methods, trials, *more) in EVALUATIONS.items():
            asked = ("--methods", methods, "--trials", trials, *more)
            script.command("evaluate", experiment, "--out", out / f"{experiment}.json", *asked, *own)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--until", choices=STAGES, default=STAGES[-1])
    asked = parser.parse_args()
    main(asked.out, asked.until)
