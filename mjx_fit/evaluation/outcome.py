"""The result file of a request: whether it is there already, and writing it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mjx_fit import config as config_
from mjx_fit import files, locks, provenance
from mjx_fit.config import Config
from mjx_fit.errors import RequestError, require
from mjx_fit.evaluation import results
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.filesystem import inside
from mjx_fit.randomness import require_seed
from mjx_fit.simulate.select import resolve


@dataclass(frozen=True)
class Asked:
    """What an experiment was asked for.

    Attributes:
        out: The result file.
        experiment: Its name.
        config: The configuration.
        seed: Root seed.
        request: The rest, JSON-ready: methods, number of trials, the sensors by their fingerprints.
        engine: ``auto``, ``mjx`` or ``native``; where nothing is simulated, what the data were made with.
    """

    out: Path
    experiment: str
    config: Config
    seed: int
    request: dict[str, Any]
    engine: str

    def to_tree(self) -> dict[str, Any]:
        """All of it but the file, JSON-ready."""
        return {
            "experiment": self.experiment,
            "config": config_.to_tree(self.config),
            "seed": self.seed,
            "request": self.request,
            "engine": resolve(self.engine),
        }


def finished(asked: Asked) -> Result | None:
    """The result, if this very request was finished before.

    Raises:
        RequestError: The file cannot be a result's, or holds another result.
    """
    require_seed(asked.seed)
    here, out = asked.to_tree(), asked.out
    if out.suffix != ".json":  # by which a report finds it in a folder
        raise RequestError(f"--out: {out} is not allowed: it must end in .json")
    if not out.exists():
        files.require_writable(out)  # before minutes of work, not behind them
        return None
    if out.is_dir():
        raise RequestError(f"--out: {out} is not allowed: it is a folder; name a .json file")
    there = results.read(out)
    if {name: getattr(there, name) for name in here} != here:
        raise RequestError(f"--out: {out} is not allowed: it holds another result; choose a new file")
    return there


def once(asked: Asked, work: Callable[[], Result]) -> Result:
    """The result of a request: read where it was finished before, else worked out while its file is held.

    Args:
        asked: The request.
        work: Makes the result and writes it.

    Raises:
        RequestError: As ``finished``, or another process works on it, or has finished another one just now.
    """
    done = finished(asked)
    if done is not None:
        return done
    with locks.holding_file(asked.out):
        return finished(asked) or work()


def write(asked: Asked, summary: list[Row], rows: list[dict[str, Any]]) -> Result:
    """Write what was counted."""
    result = Result(
        **asked.to_tree(),
        device=provenance.device(),
        versions=provenance.versions(),
        summary=summary,
        trials=rows,
    )
    results.write(asked.out, result)
    return result


def broken(out: Path) -> Path:
    """Where the broken worlds of a result file are kept."""
    return inside(out.parent, out.with_suffix(".broken").name)


def rounded(values: Float[np.ndarray, " n"]) -> list[float | None]:
    """Numbers for a row: five digits, more than a draw leaves certain, keep files small; NaN is null."""
    return [float(f"{value:.5g}") if math.isfinite(value) else None for value in values.tolist()]


MAX_TRIALS, MAX_SEEDS, MAX_ROWS = 10**6, 10**4, 10**7
"""Of an experiment: a row for each method, trial and seed, of a few hundred bytes in the result file."""


def require_trials(trials: int, methods: int = 1, seeds: int = 1) -> None:
    """Refuse a number of trials that is none, or of which the rows would never all be there.

    Raises:
        RequestError: It is not allowed.
    """
    require("--trials", trials, 1, MAX_TRIALS)
    require("--seeds", seeds, 1, MAX_SEEDS)
    each = methods * seeds
    require("--trials", trials, 1, MAX_ROWS // each, f"each has {each} rows, one for each method and seed")


def with_network_of(trained: Config, config: Config) -> Config:
    """The configuration with the sensor and training of a run, which may not be asked to be others.

    Raises:
        RequestError: They were, or the run knows other shapes.
    """
    if trained.scene.shapes != config.scene.shapes:
        there, here = (", ".join(one.scene.names) for one in (trained, config))
        raise RequestError(
            f"--run: not allowed with this scene.shapes ({here}): it was trained on others ({there})"
        )
    for section in ("sensor", "train"):
        asked, there = getattr(config, section), getattr(trained, section)
        if asked not in (there, getattr(Config(), section)):
            word = next(
                word for word in config_.differences(trained, config) if word.startswith(f"{section}.")
            )
            raise RequestError(f"config: {word}: it belongs to the trained sensor and cannot be changed")
    return replace(config, sensor=trained.sensor, train=trained.train)
