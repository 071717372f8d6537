"""The result file of a request: whether it is there already, and writing it."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config, config_to_tree
from mjx_fit.evaluation import results
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.utils import files, locks, provenance
from mjx_fit.utils.errors import RequestError, require
from mjx_fit.utils.filesystem import path_inside
from mjx_fit.utils.randomness import require_seed

Header = dict[str, Any]
"""What a result file begins with, JSON-ready: all that its rows depend on but versions and device."""


def header(experiment: str, config: Config, seed: int, engine: str, request: dict[str, Any]) -> Header:
    """What a result file begins with.

    Args:
        experiment: Its name.
        config: The configuration.
        seed: Root seed.
        engine: The engine's name; where nothing is simulated, the one that the data were made with.
        request: The rest: methods, number of trials, the sensors by their fingerprints.
    """
    return {
        "experiment": experiment,
        "config": config_to_tree(config),
        "seed": seed,
        "request": request,
        "engine": engine,
    }


def finished(out: Path, here: Header) -> Result | None:
    """The result, if this very request was finished before.

    Args:
        out: The result file.
        here: What it begins with.

    Raises:
        RequestError: The file cannot be a result's, or holds another result.
    """
    require_seed(here["seed"])
    if out.suffix != ".json":  # by which a report finds it in a folder
        raise RequestError(f"--out: {out} is invalid: it must end in .json")
    if not out.exists():
        files.require_writable(out)  # before minutes of work, not after them
        return None
    if out.is_dir():
        raise RequestError(f"--out: {out} cannot be used: it is a folder; name a .json file")
    there = results.read(out)
    if {name: getattr(there, name) for name in here} != here:
        raise RequestError(f"--out: {out} cannot be used: it holds another result; choose a new file")
    return there


def once(out: Path, here: Header, work: Callable[[], Result]) -> Result:
    """The result of a request: read where it was finished before, else worked out while its file is held.

    Args:
        out: The result file.
        here: What it begins with.
        work: Makes the result and writes it.

    Raises:
        RequestError: As ``finished``, or another process works on it, or has finished another one just now.
    """
    done = finished(out, here)
    if done is not None:
        return done
    with locks.holding_file(out):
        return finished(out, here) or work()


def write(out: Path, here: Header, summary: list[Row], rows: list[dict[str, Any]]) -> Result:
    """Writes what was counted."""
    result = Result(
        **here,
        device=provenance.device(),
        versions=provenance.versions(),
        summary=summary,
        trials=rows,
    )
    results.write(out, result)
    return result


def broken(out: Path) -> Path:
    """Where the broken worlds of a result file are kept."""
    return path_inside(out.parent, out.with_suffix(".broken").name)


def rounded(values: Float[np.ndarray, " n"]) -> list[float | None]:
    """Numbers for a row: five digits, more than a draw leaves certain, keep files small; NaN is null."""
    return [float(f"{value:.5g}") if math.isfinite(value) else None for value in values.tolist()]


MAX_TRIALS, MAX_SEEDS, MAX_ROWS = 10**6, 10**4, 10**7
"""Of an experiment: a row for each method, trial and seed, of a few hundred bytes in the result file."""


def require_trials(trials: int, methods: int = 1, seeds: int = 1) -> None:
    """Refuse a number of trials that is none, or of which the rows would never all be there.

    Raises:
        RequestError: It is invalid.
    """
    require("--trials", trials, 1, MAX_TRIALS)
    require("--seeds", seeds, 1, MAX_SEEDS)
    each = methods * seeds
    require("--trials", trials, 1, MAX_ROWS // each, f"each has {each} rows, one for each method and seed")
