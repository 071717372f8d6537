"""The result file of a request: whether it is there already, and writing it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from mjx_fit import config as config_
from mjx_fit import files, provenance
from mjx_fit.config import Config
from mjx_fit.errors import RequestError
from mjx_fit.evaluation import results
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.randomness import require_seed
from mjx_fit.simulate.engine import resolve


def finished(
    out: Path, experiment: str, config: Config, seed: int, request: dict, engine: str
) -> Result | None:
    """The result, if this very request was finished before."""
    require_seed(seed)
    engine = resolve(engine)
    if not out.exists():
        files.require_writable(out)  # before minutes of work, not behind them
        return None
    if out.is_dir():
        raise RequestError(f"--out: {out} is not allowed: it is a folder; name a .json file")
    there = results.read(out)
    here = (experiment, config_.to_tree(config), seed, request, engine)
    if (there.experiment, there.config, there.seed, there.request, there.engine) != here:
        raise RequestError(f"--out: {out} is not allowed: it holds another result; choose a new file")
    return there


def write(
    out: Path,
    experiment: str,
    config: Config,
    seed: int,
    request: dict[str, Any],
    engine: str,
    summary: list[Row],
    rows: list[dict[str, Any]],
) -> Result:
    """Write what was counted."""
    result = Result(
        experiment=experiment,
        config=config_.to_tree(config),
        seed=seed,
        request=request,
        engine=resolve(engine),
        device=provenance.device(),
        versions=provenance.versions(),
        summary=summary,
        trials=rows,
    )
    results.write(out, result)
    return result


def require_positive(field: str, value: int) -> None:
    """Refuse a number of things that is not one."""
    if value < 1:
        raise RequestError(f"{field}: {value} is not allowed: it must be at least 1")


def with_network_of(trained: Config, config: Config) -> Config:
    """The configuration with the sensor and training of a run, which may not be asked to be others."""
    for section in ("sensor", "train"):
        asked, there = getattr(config, section), getattr(trained, section)
        if asked not in (there, getattr(Config(), section)):
            word = next(
                word for word in config_.differences(trained, config) if word.startswith(f"{section}.")
            )
            raise RequestError(f"config: {word}: it is a property of the --run and cannot be changed")
    return replace(config, sensor=trained.sensor, train=trained.train)
