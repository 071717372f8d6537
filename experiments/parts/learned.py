"""Train a sensor on NIST's eight pegs and three plug noses; run the same command again to resume.

    python experiments/parts/learned.py OUT [--until data|training|evaluation]

World ``forge``, parts ``nist``, task ``nist.yaml``: detections within 5 mm. OUT receives the data sets
``learn`` and ``held_out``, the training run ``run``, and results of ``evaluate``. A stage is a command of the
library, which continues where it was stopped.
"""

import argparse
from pathlib import Path

from mjx_fit.report import script

HERE = Path(__file__).parent
TASK = ("--world", "forge", "--parts", "nist", "--config", HERE / "nist.yaml")
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
        script.command("evaluate", "position", "--out", out / "position.json", "--trials", 600, *own)
        script.command("evaluate", "insertion", "--out", out / "insertion.json", "--trials", 300, *own)
        script.command("evaluate", "assembly", "--out", out / "assembly.json", "--trials", 60, *own)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--until", choices=STAGES, default=STAGES[-1])
    asked = parser.parse_args()
    main(asked.out, asked.until)
