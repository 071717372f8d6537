"""Result file of a request: lookup of a finished result, and writing."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config, config_from_stored, config_to_tree
from mjx_fit.evaluation import results
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.utils import files, locks, provenance
from mjx_fit.utils.errors import RequestError, require
from mjx_fit.utils.filesystem import path_inside
from mjx_fit.utils.randomness import require_seed

Header = dict[str, Any]
"""Start of a result file, JSON-ready: everything its rows depend on except versions and device."""


def header(experiment: str, config: Config, seed: int, engine: str, request: dict[str, Any]) -> Header:
    """Return the header of a result file.

    Args:
        experiment: Name of the experiment.
        config: Configuration.
        seed: Root seed.
        engine: Name of the engine; without simulation, that of the data set.
        request: Other parts of the request: methods, number of trials, fingerprints of the sensors.
    """
    return {
        "experiment": experiment,
        "config": config_to_tree(config),
        "seed": seed,
        "request": request,
        "engine": engine,
    }


def finished(out: Path, here: Header) -> Result | None:
    """Return the result if the same request is already finished, otherwise None.

    Args:
        out: Result file.
        here: Header of the result.

    Raises:
        RequestError: The path cannot be a result file, or the file holds another result.
    """
    require_seed(here["seed"])
    if out.suffix != ".json":  # a report finds results by this suffix
        raise RequestError(f"--out: {out} is invalid: it must end in .json")
    if not out.exists():
        files.require_writable(out)  # check before minutes of work
        return None
    if out.is_dir():
        raise RequestError(f"--out: {out} cannot be used: it is a folder; name a .json file")
    there = results.read(out)
    stored = {name: getattr(there, name) for name in here}
    stored["config"] = config_to_tree(config_from_stored(there.config))  # an older version wrote fewer keys
    if stored != here:
        raise RequestError(f"--out: {out} cannot be used: it holds another result; choose a new file")
    return there


def once(out: Path, here: Header, work: Callable[[], Result]) -> Result:
    """Return the result of a request: read if finished, otherwise computed while its file is locked.

    Args:
        out: Result file.
        here: Header of the result.
        work: Function that computes the result and writes it.

    Raises:
        RequestError: As for ``finished``, or another process works on the file or has just written another
            result to it.
    """
    done = finished(out, here)
    if done is not None:
        return done
    with locks.holding_file(out):
        return finished(out, here) or work()


def write(out: Path, here: Header, summary: list[Row], rows: list[dict[str, Any]]) -> Result:
    """Write a result file."""
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
    """Return the folder of the diverged simulations of a result file."""
    return path_inside(out.parent, out.with_suffix(".broken").name)


def rounded(values: Float[np.ndarray, " n"]) -> list[float | None]:
    """Round numbers for a row to five digits, which exceeds their precision; NaN becomes null."""
    return [float(f"{value:.5g}") if math.isfinite(value) else None for value in values.tolist()]


MAX_TRIALS, MAX_SEEDS, MAX_ROWS = 10**6, 10**4, 10**7
"""Limits of an experiment; each method, trial and seed has a row of a few hundred bytes."""


def require_trials(trials: int, methods: int = 1, seeds: int = 1) -> None:
    """Check the number of trials and seeds, and of the resulting rows.

    Raises:
        RequestError: A number is out of range.
    """
    require("--trials", trials, 1, MAX_TRIALS)
    require("--seeds", seeds, 1, MAX_SEEDS)
    each = methods * seeds
    require("--trials", trials, 1, MAX_ROWS // each, f"each has {each} rows, one for each method and seed")
