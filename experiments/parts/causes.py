"""Show why the sensor for NIST's parts learns as much as it does, after ``learned.py OUT``; resumes.

    python experiments/parts/causes.py OUT [VARIANT ...]

``reach`` groups the failed attempts of ``calibration.json`` by what the pegs met: the axis of the peg passed
over the hole, where the plate no longer carries the peg on all sides; only a part of its section did; or
none. Variants are other sensors, judged on the same attempts: ``exact`` is trained and judged without errors
of measurement; ``half`` and ``quarter`` are trained on the first attempts, with as many updates. Results are
in ``causes.json``.
"""

import argparse
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from learned import HERE, TASK
from shapely import MultiPolygon
from shapely.affinity import translate

from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.config.sections.measurement import PoseConfig, WristConfig
from mjx_fit.data import reader
from mjx_fit.data.manifest import MANIFEST_NAME, read_complete_manifest, write_manifest
from mjx_fit.evaluation.scores import inside
from mjx_fit.evaluation.statistics import bootstrap_mean
from mjx_fit.report import script
from mjx_fit.scene.outline import hole_outline, peg_outline
from mjx_fit.types import Rollout
from mjx_fit.utils import process_setup

MM_PER_CM = 10
EPOCHS = 50
VARIANTS = {"exact": 1, "half": 2, "quarter": 4}
"""Names of other sensors: each is trained on one of so many parts of the data."""
MET = ("none", "section", "axis")
FILE = HERE / "causes.json"

Trials = list[dict[str, Any]]


def main(out: Path, variants: list[str]) -> None:
    """Group the errors, and train the variants."""
    shipped = trials_of(out / "calibration.json")
    found = {"all": by_part(shipped), **{name: by_part(variant(out, name)) for name in variants}}
    script.save(FILE, {"reach": reach(out, shipped), "sensors": found})


def reach(out: Path, trials: Trials) -> dict[str, Any]:
    """Return position errors by what the peg met, and by part."""
    data = reader.load(out / "held_out")
    row_of = {key: i for i, key in enumerate(zip(data.sequence.tolist(), data.number.tolist(), strict=True))}
    scene = read_config([*parts_file("nist"), HERE / "nist.yaml"]).scene
    outlines = [(peg_outline(shape, scene), hole_outline(shape, scene)) for shape in scene.shapes]
    met = [what_met(data.rollout, row_of[trial["trial"], trial["attempt"] - 1], outlines) for trial in trials]
    return {
        what: by_part([trial for trial, one in zip(trials, met, strict=True) if one == what]) for what in MET
    }


def what_met(done: Rollout, row: int, outlines: list[tuple[MultiPolygon, MultiPolygon]]) -> str:
    """Return what came over the hole in an attempt: the peg's axis, a part of its section, or none."""
    felt, truth = done.felt, done.truth
    peg, hole = outlines[int(felt.peg_type[row])][0], outlines[int(truth.hole_type[row])][1]
    path = np.asarray(felt.trace.tip_pos_world)[row, : int(felt.length[row]), :2]
    x, y = (path - np.asarray(truth.hole_pos_world)[row]).T
    if shapely.contains_xy(hole, x, y).any():
        return "axis"
    over = any(translate(peg, dx, dy).intersects(hole) for dx, dy in zip(x, y, strict=True))
    return "section" if over else "none"


def variant(out: Path, name: str) -> Trials:
    """Train a variant and return its trials on the held-out attempts."""
    exact = exact_readings() if name == "exact" else ()
    run, result = out / f"run_{name}", out / f"calibration_{name}.json"
    parts = VARIANTS[name]
    length = ("--epochs", EPOCHS * parts, "--set", "train.baseline_share=0")
    training = ("--config", HERE.parents[1] / "configs" / "cpu.yaml", *length)
    script.command("train", "--data", first(out, parts), "--out", run, *TASK, *training, *exact)
    held_out = ("--data", out / "held_out", "--run", run)
    script.command("evaluate", "calibration", "--out", result, *held_out, *TASK, *exact)
    return trials_of(result)


def exact_readings() -> list[str]:
    """Return options that take all errors from what is measured."""
    sections = {"wrist": WristConfig().without_errors(), "pose": PoseConfig().without_errors()}
    return [
        f"--set={section}.{name}={value}"
        for section, exact in sections.items()
        for name, value in vars(exact).items()
        if value == 0
    ]


def first(out: Path, parts: int) -> Path:
    """Return a data set of the first attempts, one of so many parts of all."""
    if parts == 1:
        return out / "learn"
    folder, whole = out / f"learn_{parts}", read_complete_manifest(out / "learn")
    shards = whole.shards[: len(whole.shards) // parts]
    folder.mkdir(exist_ok=True)
    for shard in shards:
        if not (folder / shard.name).exists():
            os.link(out / "learn" / shard.name, folder / shard.name)
    if not (folder / MANIFEST_NAME).exists():
        request = whole.request | {"episodes": sum(shard.episodes for shard in shards)}
        write_manifest(folder, replace(whole, request=request, shards=shards))
    return folder


def trials_of(file: Path) -> Trials:
    """Return the trials of method ``full``."""
    return [trial for trial in json.loads(file.read_text())["trials"] if trial["method"] == "full"]


def by_part(trials: Trials) -> dict[str, Any]:
    """Return position errors before and after the update, mm, and coverage, for all pegs and for each."""
    pegs = ["all", *sorted({trial["pair"][0] for trial in trials})]
    return {peg: errors([t for t in trials if peg in ("all", t["pair"][0])]) for peg in pegs}


def errors(trials: Trials) -> dict[str, Any]:
    """Return means with their intervals by bootstrap over holes."""
    holes = [trial["trial"] for trial in trials]
    columns = {
        "before_mm": np.array([MM_PER_CM * trial["prior_error_cm"] for trial in trials]),
        "after_mm": np.array([MM_PER_CM * trial["error_cm"] for trial in trials]),
        "coverage_90": inside(np.array([trial["squared_mahalanobis"] for trial in trials]), 0.9),
    }
    means = {
        name: [round(one, 3) for one in bootstrap_mean(values, holes)] for name, values in columns.items()
    }
    return {"n": len(trials), **means}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("variants", nargs="*", metavar="VARIANT")
    asked = parser.parse_args()
    process_setup.configure()
    main(asked.out, asked.variants or list(VARIANTS))
