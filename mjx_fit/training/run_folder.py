"""The folder of a training run: config.yaml, run.json, metrics.jsonl, checkpoints.

One folder is one run: the same configuration but for the number of epochs, the same seed and the same data.
"""

import inspect
import json
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from jaxtyping import Int

from mjx_fit import config as config_
from mjx_fit import files, locks, provenance
from mjx_fit.config import Config
from mjx_fit.errors import RequestError
from mjx_fit.filesystem import inside as inside_
from mjx_fit.filesystem import refuse_link

P = ParamSpec("P")
R = TypeVar("R")

CONFIG, RUN, METRICS = "config.yaml", "run.json", "metrics.jsonl"
_ENTRIES = (CONFIG, RUN, METRICS, "checkpoints", "checkpoints/best", "checkpoints/last")
"""What is written to in the folder: none may be a link."""
_NEEDED = ("val_nll", "prior_nll")
"""Metrics that say what a run has come to."""


def identity(config: Config) -> Config:
    """The part of the configuration that makes it this run.

    A run may be continued to more epochs, unless its learning rate was to reach zero with the last.
    """
    if config.train.schedule == "cosine":
        return config
    return replace(config, train=replace(config.train, epochs=1))


def members(out: Path, count: int, inside: str = "") -> list[Path]:
    """The folders of the runs of an ensemble; of one alone, its own.

    Raises:
        RequestError: There must be at least one, or the folder holds what is no part of so many.
    """
    if count < 1:
        raise RequestError(f"--members: {count} is not allowed: it must be at least 1")
    if count == 1:
        return [_below(out, inside)]
    names = [f"member-{member}" for member in range(count)]
    foreign = files.foreign(out, {"checkpoints", "frame_by_frame", *names})
    if foreign:
        raise RequestError(
            f"--out: {out} is not allowed: it holds other files ({foreign[0]}); choose a new folder"
        )
    return [_below(inside_(out, name), inside) for name in names]


def _below(out: Path, inside: str) -> Path:
    return inside_(out, inside) if inside else out


def held(train: Callable[P, R]) -> Callable[P, R]:
    """Hold the folder of a run, and those in it that are trained into, while a function trains there.

    Args:
        train: Has parameters ``out``, ``members`` and, where it may be another than the run's, ``inside``.

    Returns:
        The same function. It raises a RequestError where another process trains in one of the folders, and a
        WorkError where one is taken away.
    """
    signature = inspect.signature(train)

    @wraps(train)
    def trains(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        out, count = Path(bound.arguments["out"]), bound.arguments["members"]
        folders = [out, *members(out, count, bound.arguments.get("inside", ""))]
        with ExitStack() as stack:
            for folder in dict.fromkeys(folders):
                # What is finished may be read-only.
                stack.enter_context(locks.holding(folder, even_if_read_only=True))
            return train(*args, **kwargs)

    return trains


def check(out: Path, config: Config, seed: int, data: str) -> None:
    """Make sure that the folder is new or holds this very run; write nothing.

    Raises:
        RequestError: It is not a folder, or it holds another run or other files.
    """
    if out.exists() and not out.is_dir():
        raise RequestError(f"--out: {out} is not allowed: it must be a folder")
    for name in _ENTRIES:
        refuse_link(out / name)
    if not (out / RUN).is_file():
        _require_free(out, config)
        return
    there = read(out)
    if not {"seed", "data"} <= there.keys():
        raise _damaged(out / RUN, "it lacks the seed or the data")
    differences = [
        f"{name} is {there[name]} there and {here} here"
        for name, here in (("seed", seed), ("data", data))
        if there[name] != here
    ]
    differences += config_.differences(*map(identity, (config_.load(out / CONFIG), config)))
    if differences:
        raise RequestError(
            f"--out: {out} is not allowed: it holds another run ({differences[0]}); choose a new folder"
        )


def read(out: Path, option: str = "--out") -> dict[str, Any]:
    """What ``run.json`` says; ``option`` is the one that the folder was given by.

    Raises:
        RequestError: It is damaged.
    """
    path = out / RUN
    try:
        run = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(run, dict):
            return run
        what = "it is no object"
    except (OSError, ValueError, RecursionError) as error:
        what = _in_a_line(error)
    raise _damaged(path, what, option)


def read_metrics(out: Path, epochs: int | None = None) -> list[dict[str, Any]]:
    """The first epochs of ``metrics.jsonl``, or all; a kill may have torn the line behind them.

    Raises:
        RequestError: A line is damaged or missing.
    """
    path = out / METRICS
    lines = path.read_bytes().splitlines(keepends=True) if path.is_file() else []
    rows = []
    for number, line in enumerate(lines[:epochs]):
        try:
            row = json.loads(line.decode())
            if row["epoch"] != number or not all(isinstance(row[key], float | int) for key in _NEEDED):
                raise ValueError(f"it is not of epoch {number}")
        except (ValueError, RecursionError, KeyError, TypeError) as error:
            raise _damaged(path, f"line {number + 1}: {_in_a_line(error)}") from None
        rows.append(row)
    if len(rows) < (epochs or 0):
        raise _damaged(path, f"it ends after epoch {len(rows)}, and the checkpoint after {epochs}")
    return rows


def _damaged(path: Path, what: str, option: str = "--out") -> RequestError:
    return RequestError(
        f"{option}: {path} is not allowed: it is damaged ({what}); restore it, or choose a new folder"
    )


def _in_a_line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:120]


def write(
    out: Path,
    config: Config,
    seed: int,
    data: str,
    first_hole: dict[str, Any],
    sequences: Int[np.ndarray, "episodes"],
    sides: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]],
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
    """
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
        }
        files.write_text(out / RUN, json.dumps(run, indent=2) + "\n")


def summary(out: Path) -> str:
    """What a run has come to, in a line."""
    run = read(out)
    try:
        sides = " and ".join(
            f"{verb} on {run[side]['interactions']:,} interactions at {run[side]['holes']:,} holes"
            for verb, side in (("trained", "training"), ("validated", "validation"))
            if side in run  # earlier runs did not count them
        )
    except (KeyError, TypeError, ValueError) as error:
        raise _damaged(out / RUN, _in_a_line(error)) from None
    rows = read_metrics(out)
    if not rows:
        raise _damaged(out / METRICS, "it holds no epoch")
    best = min(rows, key=lambda row: row["val_nll"])
    helps = best["val_nll"] < best["prior_nll"]
    return (
        f"{sides or 'trained'}; validation NLL {best['val_nll']:.3f} after epoch {best['epoch'] + 1} of "
        f"{len(rows)}, {best['prior_nll']:.3f} without the sensor (lower is better)"
        + ("" if helps else ": it is worse than none; train longer or on more data")
    )


def keep_metrics(out: Path, epochs_done: int) -> None:
    """Cut ``metrics.jsonl`` back to the epochs that the checkpoint knows; the rest is run again."""
    path = out / METRICS
    rows = read_metrics(out, epochs_done)
    lines = path.read_bytes().splitlines(keepends=True) if path.is_file() else []
    # Line by line in order: the last one may have been torn by a kill.
    files.write_bytes(path, b"".join(line.rstrip(b"\n") + b"\n" for line in lines[: len(rows)]))


def append_metrics(out: Path, row: dict) -> None:
    """Add the line of one epoch."""
    locks.require_all()
    files.append_line(out / METRICS, json.dumps(row))


def _require_free(out: Path, config: Config) -> None:
    """A folder without a run may hold what a killed start of this very run left behind, and nothing else."""
    begun = {CONFIG: config_.to_yaml(config)}
    for name in files.foreign(out, {RUN}):
        path = out / name
        torn = files.is_temporary(name, of={CONFIG})
        if not torn and not (
            path.is_file() and path.read_bytes().decode(errors="replace") == begun.get(name)
        ):
            raise RequestError(
                f"--out: {out} is not allowed: it holds other files ({name}); choose a new folder"
            )
