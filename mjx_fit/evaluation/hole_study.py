"""An experiment with attempts in a row at one hole: its sensors, its request, and its work in parts."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from mjx_fit import config as config_
from mjx_fit.config import Config
from mjx_fit.errors import RequestError
from mjx_fit.evaluation import outcome, parts
from mjx_fit.evaluation.parts import Rows
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.progress import COMPILING, Progress
from mjx_fit.sensors.model import ContactSensor
from mjx_fit.settings import SensorConfig, TrainConfig
from mjx_fit.simulate.broken import Reporting
from mjx_fit.simulate.select import make_engine
from mjx_fit.task import hole
from mjx_fit.task.learning import Update, filter_update, frame_update
from mjx_fit.task.methods import HoleMethod
from mjx_fit.training import checkpoint
from mjx_fit.training.baseline import FRAME_BY_FRAME

Outcomes = dict[str, hole.Outcome]
Ids = Int[np.ndarray, "n"]


@dataclass(frozen=True)
class Study:
    """What an experiment is made of.

    Attributes:
        experiment: Its name.
        methods: What it compares.
        asked: Of the request, what only it has.
        max_attempts: At one hole.
        n: Trials under each method.
        holes: The world of some trials, by their ids.
        rows: The rows of a result file for those trials.
        summarise: What all rows come to.
    """

    experiment: str
    methods: tuple[HoleMethod, ...]
    asked: dict[str, Any]
    max_attempts: int
    n: int
    holes: Callable[[Config, Ids], hole.Holes]
    rows: Callable[[Ids, hole.Holes, Outcomes], Rows]
    summarise: Callable[[Rows], list[Row]]


def run(study: Study, config: Config, out: Path, folder: Path, seed: int, engine: str) -> Result:
    """Runs the study, or goes on with it, or reads what came of it.

    Args:
        study: What is to be done.
        config: The configuration.
        out: The result file.
        folder: Of the training run whose sensors are used.
        seed: Root seed.
        engine: ``auto``, ``mjx`` or ``native``.

    Raises:
        RequestError: A value is not allowed, the run lacks a sensor, or the file holds another result.
    """
    sensors, config, differs = _sensors(study.methods, folder, config)
    request = {
        "methods": [method.name for method in study.methods],
        **study.asked,
        "sensor": {name: checkpoint.fingerprint_of(sensor) for name, sensor in sensors.items()},
        "differs_from_training": differs,
    }
    asked = outcome.Asked(out, study.experiment, config, seed, request, engine)
    result = outcome.once(asked, lambda: _worked_out(study, asked, sensors))
    parts.finish(out)
    return result


def _worked_out(study: Study, asked: outcome.Asked, sensors: dict[str, ContactSensor]) -> Result:
    config, out, engine = asked.config, asked.out, asked.engine
    simulator, n_methods = make_engine(engine, config), len(study.methods)
    updates = _updates(study.methods, sensors, config)
    pieces = parts.pieces(study.n, n_methods, simulator.name)
    finished = min(parts.kept(out) * len(pieces[0]), study.n) * n_methods
    begins = COMPILING if simulator.name == "mjx" else ""
    with Progress(f"{study.experiment}: trials", study.n * n_methods, finished, begins) as progress:

        def attempted(attempts: int) -> None:
            progress(finished, f"{attempts} attempts in this round")

        def work(ids: Ids) -> Rows:
            world = study.holes(config, ids)
            reporting = Reporting(simulator, config, outcome.broken(out) / f"trials-{ids[0]:06d}")
            outcomes = hole.run(
                config, study.methods, world, study.max_attempts, reporting, updates, attempted
            )
            wanted = np.tile(ids < study.n, n_methods)
            return list(compress(study.rows(ids, world, outcomes), wanted))

        def told(rows: Rows) -> None:
            nonlocal finished
            finished = max(finished, len(rows))
            progress(finished)

        rows = parts.in_parts(asked, pieces, work, told)
    result = outcome.write(asked, study.summarise(rows), rows)
    parts.finish(out)
    return result


def _sensors(
    methods: tuple[HoleMethod, ...], folder: Path, config: Config
) -> tuple[dict[str, ContactSensor], Config, list[str]]:
    """Sensors by method, the configuration with the run's network, and in what it differs from training's."""
    sensors, differs = {}, []
    for method in methods:
        if not method.reads:
            continue
        own = folder if method.reads == "filter" else folder / FRAME_BY_FRAME
        if method.reads == "frame" and not own.is_dir():
            raise RequestError(
                f"--run: {folder} is not allowed: {method.name} needs its {FRAME_BY_FRAME}, which is not "
                "there; leave it out of --methods, or train with a train.baseline_share above 0"
            )
        sensors[method.name], trained = checkpoint.load_sensor(own)
        # The baseline's network and training are the run's, but for what makes it the baseline.
        like = outcome.with_network_of(trained, config) if method.reads == "filter" else config
        differs = differs or config_.differences(*(_without_network(one) for one in (trained, like)))
        config = like
    return sensors, config, differs


def _without_network(config: Config) -> Config:
    return replace(config, sensor=SensorConfig(), train=TrainConfig())


def _updates(
    methods: tuple[HoleMethod, ...], sensors: dict[str, ContactSensor], config: Config
) -> dict[str, Update]:
    kinds = {"filter": filter_update, "frame": frame_update}
    return {
        method.name: kinds[method.reads](config, sensors[method.name]) for method in methods if method.reads
    }
