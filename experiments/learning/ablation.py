"""Ablate the sensor: one setting changed at a time, with equal training.

    python experiments/learning/ablation.py FOLDER [ROW ...]

Data and runs go to FOLDER, outside the checkout; the table goes to ``ablation.json`` next to this file. Rerun
the command to resume. Every row trains for about ``STEPS`` steps of 32 windows with seed 0, and with two more
seeds where the row decides a default. The evaluation is one update after each failed spiral of the same set.
"""

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import shared

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config, config_from_tree, config_to_tree
from mjx_fit.config.worlds import world_file
from mjx_fit.data import reader
from mjx_fit.data.collect import collect
from mjx_fit.data.plan import Plan
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.calibration import calibrate
from mjx_fit.evaluation.results import Result
from mjx_fit.report import script
from mjx_fit.training.loop import train
from mjx_fit.training.run import Run
from mjx_fit.training.split import usable_sides
from mjx_fit.utils import process_setup, provenance, resources

HERE = Path(__file__).parent
STEPS = 2400
TEST = Plan(episodes=3000, actions=100, policy="spiral", seed=1000)

AS_IT_WAS = ("sensor.positional=true", "sensor.pose=world")
"""Settings of ``configs/cpu.yaml`` before this ablation."""

PAPER = ("noise=peg", "contact_features=false", "places=0", "positional=false")
"""The paper's sensor."""


@dataclass(frozen=True)
class Row:
    """Training of one row.

    Attributes:
        data: Training data.
        changes: Changes ``section.key=value`` to ``configs/cpu.yaml`` with ``AS_IT_WAS``.
        seeds: Number of training seeds; the data are the same.
    """

    data: Plan
    changes: tuple[str, ...] = ()
    seeds: int = 1


SPIRAL = Plan(episodes=3000, actions=100, policy="spiral", seed=2)
ROWS = {
    "base": Row(SPIRAL, seeds=3),
    "spiral, 1000": Row(Plan(1000, 100, "spiral", seed=2)),
    "spiral, 300": Row(Plan(300, 100, "spiral", seed=2)),
    "random": Row(Plan(3000, 200, "random", seed=2)),
    "mixed": Row(Plan(3000, 200, "mixed", seed=2)),
    "sequences of 3": Row(Plan(3000, 100, "spiral", seed=2, sequence=3)),
    "R per peg": Row(SPIRAL, ("sensor.noise=peg",)),
    "no centre of pressure": Row(SPIRAL, ("sensor.contact_features=false",)),
    "no places": Row(SPIRAL, ("sensor.places=0",)),
    "no positional encoding": Row(SPIRAL, ("sensor.positional=false",), seeds=3),
    "no mirror": Row(SPIRAL, ("train.mirror=false",)),
    "the paper's sensor": Row(SPIRAL, tuple(f"sensor.{change}" for change in PAPER)),
}


def main(folder: Path, names: list[str]) -> None:
    path = HERE / "ablation.json"
    there = json.loads(path.read_text()) if path.is_file() else {}
    rows = there["rows"] if there.get("steps") == STEPS else {}
    test = _collected(folder, TEST)
    for name in names or ROWS:
        row = ROWS[name]
        scores, *others = (
            _scores(_trained_and_judged(folder, name, row, test, seed)) for seed in range(row.seeds)
        )
        rows[name] = {
            "interactions": row.data.episodes,
            "changes": list(row.changes),
            "device": provenance.device(),
            **scores,
            "other_seeds": others,
        }
        script.save(path, {"steps": STEPS, "rows": {name: rows[name] for name in ROWS if name in rows}})


def _trained_and_judged(folder: Path, name: str, row: Row, test: Path, seed: int) -> Result:
    data = _collected(folder, row.data)
    name += f" seed {seed}" if seed else ""
    run = folder / "runs" / name.replace(" ", "_").replace(",", "").replace("'", "")
    files = [*world_file(shared.WORLD), resources.folder("configs") / "cpu.yaml"]
    config = _with_epochs(read_config(files, (*AS_IT_WAS, *row.changes)), data)
    train(reader.load(data), config, Run(run, seed))
    return calibrate(shared.CONFIG, run / "calibration.json", run, test, seed=0)


def _collected(folder: Path, plan: Plan) -> Path:
    data = folder / "data" / f"{plan.policy}-{plan.episodes}-{plan.sequence}-{plan.seed}"
    collect(shared.CONFIG, data, plan, make_engine("auto", shared.CONFIG))
    return data


def _with_epochs(config: Config, data: Path) -> Config:
    """Set the number of epochs that gives about ``STEPS`` steps."""
    training, _ = usable_sides(reader.load(data), config, seed=0)
    epochs = max(1, round(STEPS / math.ceil(len(training) / config.train.batch_size)))
    tree = config_to_tree(config)
    tree["train"] |= {"epochs": epochs, "baseline_share": 0.0}
    return config_from_tree(tree)


def _scores(result: Result) -> dict:
    """Return the scores by which rows are compared, each with its interval."""
    wanted = {
        ("position_error_cm", "all"),
        ("position_nll", "all"),
        ("coverage_90", "all"),
        ("match_auroc", "all"),
        ("type_brier", "all"),
    }
    pairs = [row for row in result.summary if row.metric == "match_auroc" and row.group.count(":") == 1]
    scores = {
        row.metric: {"value": row.value, "low": row.low, "high": row.high}
        for row in result.summary
        if row.method == "full" and (row.metric, row.group) in wanted
    }
    return scores | {"least_pair_auroc": min(row.value for row in pairs)}


if __name__ == "__main__":
    if len(sys.argv) < 2 or set(sys.argv[2:]) - set(ROWS):
        sys.exit(f"usage: python {sys.argv[0]} FOLDER [{' | '.join(ROWS)}]")
    process_setup.configure()
    main(Path(sys.argv[1]), sys.argv[2:])
