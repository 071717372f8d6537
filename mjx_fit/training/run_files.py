"""Read and write the files of a training run: ``run.json`` and ``metrics.jsonl``."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mjx_fit.config.schema import Config
from mjx_fit.utils import bounded_json, files, locks
from mjx_fit.utils.errors import RequestError

CONFIG, RUN, METRICS = "config.yaml", "run.json", "metrics.jsonl"
_NEEDED = ("val_nll", "prior_nll")
"""Metrics that the summary of a run needs."""
_LARGEST, _LARGEST_LINE = 2**30, 2**16
"""Maximum size of ``metrics.jsonl`` and of one of its lines, bytes: enough for a million epochs."""


def read(out: Path, needed: Sequence[str] = (), option: str = "--out") -> dict[str, Any]:
    """Read ``run.json``.

    Args:
        out: Folder of the run.
        needed: Required keys.
        option: Command-line option that named the folder, for error lines.

    Raises:
        RequestError: The file is damaged.
    """
    path = out / RUN
    try:
        run = bounded_json.read(path)
        if not isinstance(run, dict):
            raise ValueError(f"it holds a {type(run).__name__}, expected an object")
        missing = [name for name in needed if name not in run]
        if missing:
            raise ValueError(f"the key {missing[0]} is missing")
    except (OSError, ValueError) as error:
        raise damaged(path, error, option) from None
    return run


def read_metrics(out: Path, epochs: int | None = None) -> list[dict[str, Any]]:
    """Read the first epochs of ``metrics.jsonl``, or all; a kill may have truncated the next line.

    Raises:
        RequestError: A line is damaged or missing.
    """
    path = out / METRICS
    rows = []
    for number, line in enumerate(_lines(path)[:epochs]):
        try:
            row = bounded_json.loads(line.decode(), _LARGEST_LINE)
            if row["epoch"] != number or not all(isinstance(row[key], float | int) for key in _NEEDED):
                raise ValueError(f"expected epoch {number}")
        except (ValueError, KeyError, TypeError) as error:
            raise damaged(path, f"line {number + 1}: {error}") from None
        rows.append(row)
    if len(rows) < (epochs or 0):
        raise damaged(path, f"it ends after epoch {len(rows)}, but the checkpoint after {epochs}")
    return rows


def keep_metrics(out: Path, epochs_done: int) -> None:
    """Truncate ``metrics.jsonl`` to the epochs of the checkpoint; later epochs are repeated."""
    rows = read_metrics(out, epochs_done)
    files.write_bytes(out / METRICS, b"".join(line + b"\n" for line in _lines(out / METRICS)[: len(rows)]))


def append_metrics(out: Path, row: dict) -> None:
    """Append the line of one epoch."""
    locks.require_all()
    files.append_line(out / METRICS, json.dumps(row))


def summary(out: Path) -> str:
    """Summarise the result of a run in one line."""
    run = read(out)
    try:
        sides = " and ".join(
            f"{verb} on {run[side]['interactions']:,} interactions at {run[side]['holes']:,} holes"
            for verb, side in (("trained", "training"), ("validated", "validation"))
            if side in run  # earlier runs did not count them
        )
    except (KeyError, TypeError, ValueError) as error:
        raise damaged(out / RUN, error) from None
    rows = read_metrics(out)
    if not rows:
        raise damaged(out / METRICS, "it holds no epoch")
    best = min(rows, key=lambda row: row["val_nll"])
    helps = best["val_nll"] < best["prior_nll"]
    return (
        f"{sides or 'trained'}; validation NLL {best['val_nll']:.3f} after epoch {best['epoch'] + 1} of "
        f"{len(rows)}, {best['prior_nll']:.3f} without the sensor (lower is better)"
        + ("" if helps else ": the sensor does not help yet; train longer or on more data")
    )


def ended(out: Path, config: Config) -> str:
    """Explain why a finished run ended and how to resume it."""
    done = len(_lines(out / METRICS))
    if done < config.train.epochs:
        return (
            f"stopped early after {done} of {config.train.epochs} epochs: the last {config.train.patience} "
            "brought no improvement; increase train.patience to resume"
        )
    another = f"use --init {out} to start another run from this one"
    if config.train.schedule == "cosine":
        return f"all {done} epochs are done, and train.schedule cosine has ended; {another}"
    return f"all {done} epochs are done; increase --epochs to resume, or {another}"


def damaged(path: Path, what: object, option: str = "--out") -> RequestError:
    """Return the error for a damaged file of a run, with damage that no kill can cause."""
    return RequestError(
        f"{option}: {path} cannot be used: it is damaged ({what}); restore it or choose a new folder"
    )


def _lines(path: Path) -> list[bytes]:
    """Read the lines of a file, or none if it does not exist; the last line may be truncated."""
    if not path.is_file():
        return []
    if path.stat().st_size > _LARGEST:
        raise damaged(path, f"it has more than {_LARGEST:,} bytes")
    return path.read_bytes().splitlines()
