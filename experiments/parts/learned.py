"""Train a sensor on NIST's eight pegs and three plug noses; run the same command again to resume.

    python experiments/parts/learned.py OUT [--until data|training|evaluation]

World ``forge``, parts ``nist``, task ``nist.yaml``: detections within 5 mm. OUT receives the data sets
``learn`` and ``held_out``, the training run ``run``, results of ``evaluate``, and ``first_attempts.json``,
whose rates are α in ``nist.yaml``. Commands of the library continue where they were stopped.
"""

import argparse
from pathlib import Path

import numpy as np

from mjx_fit.data import reader
from mjx_fit.data.episode import happened
from mjx_fit.data.manifest import read_manifest
from mjx_fit.report import script

HERE = Path(__file__).parent
TASK = ("--world", "forge", "--parts", "nist", "--config", HERE / "nist.yaml")
BEFORE_ALPHA = ("--set", "task.success_probability=null")
"""The first data set gives these probabilities; its attempts do not depend on them."""
EVALUATIONS = {
    "insertion": ("full,no_update,sample,oracle", 80, "--seeds", 1),
    "assembly": ("full,failure_only,oracle", 12),
}
STAGES = ("data", "training", "evaluation")


def main(out: Path, until: str) -> None:
    """Run the stages up to the one asked for."""
    reached = STAGES.index(until)
    learn = ("--episodes", 9_000, "--sequence", 3, "--seed", 34)
    script.command("collect", "--out", out / "learn", *learn, *TASK, *BEFORE_ALPHA)
    held_out = ("--episodes", 1_500, "--sequence", 3, "--seed", 35)
    script.command("collect", "--out", out / "held_out", *held_out, *TASK)
    script.save(out / "first_attempts.json", first_attempts(out / "learn"))
    if reached >= 1:
        training = ("--config", HERE.parents[1] / "configs" / "cpu.yaml")
        script.command("train", "--data", out / "learn", "--out", out / "run", *TASK, *training)
    if reached >= 2:
        own = ("--run", out / "run", *TASK)
        of_held_out = ("--data", out / "held_out", *own)
        script.command("evaluate", "calibration", "--out", out / "calibration.json", *of_held_out)
        for experiment, (methods, trials, *more) in EVALUATIONS.items():
            asked = ("--methods", methods, "--trials", trials, *more)
            script.command("evaluate", experiment, "--out", out / f"{experiment}.json", *asked, *own)


def first_attempts(folder: Path) -> dict[str, list[int]]:
    """Count insertions into own holes at the first attempt, by part: inserted and tried."""
    data = reader.load(folder)
    felt, truth = data.rollout.felt, data.rollout.truth
    first = happened(data) & (np.asarray(data.number) == 0)
    found = {}
    for kind, name in enumerate(read_manifest(folder).shapes):
        own = first & (np.asarray(felt.peg_type) == kind) & (np.asarray(truth.hole_type) == kind)
        found[name] = [int(np.asarray(truth.inserted)[own].sum()), int(own.sum())]
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--until", choices=STAGES, default=STAGES[-1])
    asked = parser.parse_args()
    main(asked.out, asked.until)
