"""The folder of a training run: config.yaml, run.json, metrics.jsonl, checkpoints.

One folder is one run: the same configuration but for the number of epochs, the same seed and the same data.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from mjx_fit import config as config_
from mjx_fit import files, provenance
from mjx_fit.config import Config
from mjx_fit.errors import RequestError

CONFIG, RUN, METRICS = "config.yaml", "run.json", "metrics.jsonl"


def identity(config: Config) -> Config:
    """The part of the configuration that makes it this run.

    A run may be continued to more epochs, unless its learning rate was to reach zero with the last, and with
    more patience.
    """
    epochs = config.train.epochs if config.train.schedule == "cosine" else 1
    return replace(config, train=replace(config.train, epochs=epochs, patience=0))


def members(out: Path, count: int, inside: str = "") -> list[Path]:
    """The folders of the runs of an ensemble; of one alone, its own.

    Raises:
        RequestError: There must be at least one, or the folder holds what is no part of so many.
    """
    if count < 1:
        raise RequestError(f"--members: {count} is not allowed: it must be at least 1")
    if count == 1:
        return [out / inside]
    folders = [out / f"member-{member}" for member in range(count)]
    parts = {"checkpoints", "frame_by_frame", *(folder.name for folder in folders)}
    foreign = sorted({path.name for path in out.iterdir()} - parts) if out.is_dir() else []
    if foreign:
        raise RequestError(
            f"--out: {out} is not allowed: it holds other files ({foreign[0]}); choose a new folder"
        )
    return [folder / inside for folder in folders]


def check(out: Path, config: Config, seed: int, data: str, origin: dict[str, Any] | None = None) -> None:
    """Make sure that the folder is new or holds this very run; write nothing.

    Args:
        out: The folder.
        config: The configuration.
        seed: Root seed.
        data: Fingerprint of the data.
        origin: Of the sensor that the training starts from, if it is a trained one.

    Raises:
        RequestError: It is not a folder, or it holds another run or other files.
    """
    if out.exists() and not out.is_dir():
        raise RequestError(f"--out: {out} is not allowed: it must be a folder")
    if not (out / RUN).is_file():
        _require_free(out, config)
        return
    try:
        there = json.loads((out / RUN).read_text())
        differences = [
            f"{name} is {there[name]} there and {here} here"
            for name, here in (("seed", seed), ("data", data))
            if there[name] != here
        ]
        origin_there = dict(there["init"]) if "init" in there else None
    except (ValueError, KeyError, TypeError):
        raise RequestError(f"--out: {out} is not allowed: its {RUN} cannot be read") from None
    _require_origin(out, origin_there, origin)
    before = config_.load(out / CONFIG)
    differences += config_.differences(*map(identity, (before, config)))
    _require_end(out, before, config, differences)
    if differences:
        raise RequestError(
            f"--out: {out} is not allowed: it holds another run ({differences[0]}); choose a new folder"
        )


def write(
    out: Path,
    config: Config,
    seed: int,
    data: str,
    first_hole: dict[str, Any],
    sequences: Int[np.ndarray, "episodes"],
    sides: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]],
    origin: dict[str, Any] | None = None,
) -> None:
    """Write down what the run is; ``run.json`` last, and only once.

    Args:
        out: The folder.
        config: The configuration.
        seed: Root seed.
        data: Fingerprint of the data.
        first_hole: Of the data, by which others at the same holes are known.
        sequences: Which sequence, that is which hole, each episode belongs to.
        sides: Indices of the training and of the validation episodes.
        origin: Of the sensor that the training starts from, if it is a trained one.
    """
    out.mkdir(parents=True, exist_ok=True)
    files.write_text(out / CONFIG, config_.to_yaml(config))
    if not (out / RUN).is_file():
        run = {
            "seed": seed,
            "data": data,
            "first_hole": first_hole,
            **{
                side: {"interactions": len(ids), "holes": len(np.unique(np.asarray(sequences)[ids]))}
                for side, ids in zip(("training", "validation"), sides, strict=True)
            },
            "versions": provenance.versions(),
            "device": provenance.device(),
            **({} if origin is None else {"init": origin}),
        }
        files.write_text(out / RUN, json.dumps(run, indent=2) + "\n")


def summary(out: Path) -> str:
    """What a run has come to, in a line."""
    run = json.loads((out / RUN).read_text())
    sides = " and ".join(
        f"{verb} on {run[side]['interactions']:,} interactions at {run[side]['holes']:,} holes"
        for verb, side in (("trained", "training"), ("validated", "validation"))
        if side in run  # earlier runs did not count them
    )
    rows = [json.loads(line) for line in (out / METRICS).read_text().splitlines()]
    best = min(rows, key=lambda row: row["val_nll"])
    helps = best["val_nll"] < best["prior_nll"]
    return (
        f"{sides or 'trained'}; validation NLL {best['val_nll']:.3f} after epoch {best['epoch'] + 1} of "
        f"{len(rows)}, {best['prior_nll']:.3f} without the sensor (lower is better)"
        + ("" if helps else ": it is worse than none; train longer or on more data")
    )


def ended(out: Path, config: Config) -> str:
    """Why a finished run is over, and how it goes on, in words."""
    done = len((out / METRICS).read_text().splitlines())
    if done < config.train.epochs:
        return (
            f"stopped early after {done} of {config.train.epochs} epochs: the last {config.train.patience} "
            "were no better; a larger train.patience goes on"
        )
    another = f"--init {out} starts another run from it"
    if config.train.schedule == "cosine":
        return f"all {done} epochs are done, and with them train.schedule cosine; {another}"
    return f"all {done} epochs are done; more --epochs go on, {another}"


def _require_origin(out: Path, there: dict[str, Any] | None, here: dict[str, Any] | None) -> None:
    """Refuse to continue a run from other weights than it started from."""
    if (there or {}).get("sensor") == (here or {}).get("sensor"):
        return
    started = "new weights" if there is None else "a trained sensor"
    how = "leave --init away" if there is None else "give the --init that it was begun with"
    raise RequestError(
        f"--init: {'none' if here is None else 'this one'} is not allowed: {out} started from {started}"
        f"{' that is not this one' if there and here else ''}; {how}, or choose a new folder"
    )


def _require_end(out: Path, before: Config, now: Config, differences: list[str]) -> None:
    """Refuse to move the end of a run where it cannot be moved."""
    cosine = [words for words in differences if words.startswith("train.epochs ")]
    if cosine and cosine == differences:
        raise RequestError(
            f"--epochs: {now.train.epochs} is not allowed: {cosine[0]}, where train.schedule cosine brings "
            f"the learning rate to zero; start another run from this one: --init {out} --out NEW"
        )
    there, here = before.train.patience, now.train.patience
    if not differences and here and (not there or here < there):
        raise RequestError(
            f"config: train.patience: {here} is not allowed: {out} has {there or '0 (never stop early)'}, "
            "which may only grow"
        )


def keep_metrics(out: Path, epochs_done: int) -> None:
    """Cut ``metrics.jsonl`` back to the epochs that the checkpoint knows; the rest is run again."""
    path = out / METRICS
    lines = path.read_text().splitlines(keepends=True) if path.is_file() else []
    # Line by line in order: the last one may have been torn by a kill.
    files.write_text(path, "".join(lines[:epochs_done]))


def append_metrics(out: Path, row: dict) -> None:
    """Add the line of one epoch."""
    with (out / METRICS).open("a") as file:
        file.write(json.dumps(row) + "\n")


def _require_free(out: Path, config: Config) -> None:
    """A folder without a run may hold what a killed start of this very run left behind, and nothing else."""
    begun = {CONFIG: config_.to_yaml(config)}
    for path in sorted(out.iterdir()) if out.is_dir() else ():
        torn = path.name in (f"{CONFIG}.tmp", f"{RUN}.tmp")
        if not torn and not (path.is_file() and path.read_text(errors="replace") == begun.get(path.name)):
            raise RequestError(
                f"--out: {out} is not allowed: it holds other files ({path.name}); choose a new folder"
            )
