"""Folder of a training run: config.yaml, run.json, metrics.jsonl, checkpoints.

Each folder holds one run, defined by its configuration (except the number of epochs), seed and data.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from mjx_fit.config.files import read_stored_config
from mjx_fit.config.schema import Config, config_differences, config_to_yaml
from mjx_fit.training import run_files
from mjx_fit.training.run import Lineage
from mjx_fit.training.run_files import CONFIG, METRICS, RUN
from mjx_fit.utils import files, provenance
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.filesystem import refuse_link

_ENTRIES = (CONFIG, RUN, METRICS, "checkpoints", "checkpoints/best", "checkpoints/last")
"""Paths that a run writes to; none may be a symbolic link."""


def identity(config: Config) -> Config:
    """Return the part of the configuration that identifies a run.

    A run may resume with more patience. It may resume with more epochs unless its learning rate reaches zero
    at the last epoch.
    """
    epochs = config.train.epochs if config.train.schedule == "cosine" else 1
    return replace(config, train=replace(config.train, epochs=epochs, patience=0))


def check(out: Path, config: Config, lineage: Lineage) -> None:
    """Check that the folder is new or holds this run, without writing to it.

    Args:
        out: Folder of the run.
        config: Configuration of the run.
        lineage: Origin of the sensor.

    Raises:
        RequestError: The path is not a folder, or it holds another run or other files.
    """
    if out.exists() and not out.is_dir():
        raise RequestError(f"--out: {out} is invalid: expected a folder")
    for name in _ENTRIES:
        refuse_link(out / name)
    if not (out / RUN).is_file():
        _require_free(out, config)
        return
    there = run_files.read(out, needed=("seed", "data"))
    differences = [
        f"{name} is {there[name]} there and {here} here"
        for name, here in (("seed", lineage.seed), ("data", lineage.data))
        if there[name] != here
    ]
    _require_origin(out, there.get("init"), lineage.origin)
    before = read_stored_config(out / CONFIG)
    differences += config_differences(identity(before), identity(config))
    _require_end(out, before, config, differences)
    if differences:
        raise RequestError(
            f"--out: {out} cannot be used: it holds another run ({differences[0]}); choose a new folder"
        )


def require_same_arithmetic(out: Path) -> None:
    """Check that a run resumes with the process settings of its first start.

    Different library versions cause only a warning.

    Raises:
        RequestError: A setting that changes the arithmetic, such as ``XLA_FLAGS``, differs.
    """
    if not (out / RUN).is_file():
        return
    there, here = run_files.read(out).get("versions", {}), provenance.versions()
    for name, old, new in provenance.differing(*map(provenance.settings_of, (there, here))):
        raise RequestError(
            f"{name}: {new} cannot be used here: {out} was begun with {old}, and its results depend on it"
        )
    for name, old, new in provenance.differing(there, here)[:1]:
        print(
            f"mjx-fit: {out} was begun with {name} {old} and resumes with {new}: last digits may differ",
            file=sys.stderr,
        )


def write(
    out: Path,
    config: Config,
    lineage: Lineage,
    first_holes: list[dict[str, Any]],
    sequences: Int[np.ndarray, "episodes"],
    sides: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]],
) -> None:
    """Write the configuration and the identity of a run; ``run.json`` comes last, and only once.

    Args:
        out: Folder of the run.
        config: Configuration of the run.
        lineage: Origin of the sensor.
        first_holes: First hole of each data set, which identifies other data at the same holes.
        sequences: Sequence, and thus the hole, of each episode.
        sides: Train/validation split: indices of the episodes.
    """
    files.write_text(out / CONFIG, config_to_yaml(config))
    if not (out / RUN).is_file():
        run = {
            "seed": lineage.seed,
            "data": lineage.data,
            "first_hole": first_holes[0],
            **({"other_first_holes": first_holes[1:]} if first_holes[1:] else {}),
            **{
                side: {"interactions": len(ids), "holes": len(np.unique(np.asarray(sequences)[ids]))}
                for side, ids in zip(("training", "validation"), sides, strict=True)
            },
            "versions": provenance.versions(),
            "device": provenance.device(),
            **({} if lineage.origin is None else {"init": lineage.origin}),
        }
        files.write_text(out / RUN, json.dumps(run, indent=2) + "\n")


def _require_origin(out: Path, there: dict[str, Any] | None, here: dict[str, Any] | None) -> None:
    """Refuse to resume a run with initial weights other than its own."""
    if (there or {}).get("sensor") == (here or {}).get("sensor"):
        return
    started = "new weights" if there is None else "a trained sensor"
    how = "omit --init" if there is None else "use the --init of its first start"
    raise RequestError(
        f"--init: {'none' if here is None else 'this one'} cannot be used: {out} started from {started}"
        f"{' other than this one' if there and here else ''}; {how}, or choose a new folder"
    )


def _require_end(out: Path, before: Config, now: Config, differences: list[str]) -> None:
    """Refuse changes of epochs or patience that the run cannot resume with."""
    cosine = [words for words in differences if words.startswith("train.epochs ")]
    if cosine and cosine == differences:
        raise RequestError(
            f"--epochs: {now.train.epochs} cannot be used: {cosine[0]}, and train.schedule cosine brings "
            f"the learning rate to zero; start another run from this one: --init {out} --out NEW"
        )
    there, here = before.train.patience, now.train.patience
    if not differences and here and (not there or here < there):
        raise RequestError(
            f"config: train.patience: {here} cannot be used: {out} has {there or '0 (never stop early)'}, "
            "and patience may only grow"
        )


def _require_free(out: Path, config: Config) -> None:
    """Check that a folder without a run holds nothing except remains of a killed start of this run."""
    begun = {CONFIG: config_to_yaml(config)}
    for name in files.foreign(out, {RUN}):
        path = out / name
        torn = files.is_temporary(name, of={CONFIG})
        if not torn and not (
            path.is_file() and path.read_bytes().decode(errors="replace") == begun.get(name)
        ):
            raise RequestError(
                f"--out: {out} cannot be used: it holds other files ({name}); choose a new folder"
            )
