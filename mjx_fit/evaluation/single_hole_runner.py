"""Runner of experiments with consecutive attempts at one hole: sensors, request and work in parts."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import Places
from mjx_fit.engines.failures import Reporting
from mjx_fit.evaluation import parts, result_file
from mjx_fit.evaluation.parts import Rows
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.jobs.pool import Tell
from mjx_fit.task import single_hole
from mjx_fit.task.estimator import Update, filter_update, frame_update, position_update
from mjx_fit.task.holes import Holes, Outcome
from mjx_fit.task.methods import HoleMethod
from mjx_fit.training.checkpoint import FRAME_BY_FRAME
from mjx_fit.training.sensor_loader import TrainedSensor
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.progress import COMPILING, Progress

Outcomes = dict[str, Outcome]
Ids = Int[np.ndarray, "n"]


def holes_at(peg_type: Ids, hole_type: Ids, places: Places) -> Holes:
    """Return the setup of trials at drawn places."""
    position, estimate = np.asarray(places.hole_pos_world), np.asarray(places.estimate_world)
    physics = jax.tree.map(np.asarray, places.physics)
    return Holes(peg_type, hole_type, position, estimate, places.key, physics)


@dataclass(frozen=True)
class Study:
    """Definition of an experiment.

    Attributes:
        experiment: Name of the experiment.
        methods: Methods to compare.
        asked: Entries of the request that are specific to the experiment.
        max_attempts: Maximum number of attempts at one hole.
        n: Number of trials of each method.
        holes: Function that draws the holes of trials, by id.
        rows: Function that returns the rows of a result file for those trials.
        summarise: Function that summarises all rows.
    """

    experiment: str
    methods: tuple[HoleMethod, ...]
    asked: dict[str, Any]
    max_attempts: int
    n: int
    holes: Callable[[Config, Ids], Holes]
    rows: Callable[[Ids, Holes, Outcomes], Rows]
    summarise: Callable[[Rows], list[Row]]


def run(study: Study, request: Request) -> Result:
    """Run a study, resume it, or read its finished result.

    Args:
        study: Definition of the experiment.
        request: Request of the experiment.

    Raises:
        RequestError: A value is invalid, a method lacks its sensor, or the file holds another result.
    """
    sensors, config, differs = _sensors(study.methods, request)
    request = replace(request, config=config)
    asked = {
        "methods": [method.name for method in study.methods],
        **study.asked,
        **request.asked_policy(),
        **request.asked_parts(),
        "sensor": {name: sensor.fingerprint for name, sensor in sensors.items()},
        "differs_from_training": differs,
    }
    here = result_file.header(study.experiment, config, request.seed, request.engine.name, asked)
    result = result_file.once(request.out, here, lambda: _worked_out(study, request, here, sensors))
    parts.finish(request.out)
    return result


def _worked_out(
    study: Study, request: Request, here: result_file.Header, sensors: dict[str, TrainedSensor]
) -> Result:
    config, out, engine, n_methods = request.config, request.out, request.engine, len(study.methods)
    update = single_hole.update_of_rows(study.methods, _updates(study.methods, sensors, config))
    pieces, broken = (
        parts.pieces(study.n, n_methods, engine.name, config, request.rows_of_parts),
        result_file.broken(out),
    )

    def work(ids: Ids, tell: Tell) -> Rows:
        world = study.holes(config, ids)
        reporting = Reporting(engine, config, broken / f"trials-{ids[0]:06d}")
        table = single_hole.HoleTable(config, study.methods, world, study.max_attempts)
        for number, attempts in enumerate(single_hole.rounds(table, reporting, update), 1):
            tell(0, f"{attempts} attempts in round {number}")
        wanted = np.tile(ids < study.n, n_methods)
        return list(compress(study.rows(ids, world, table.outcomes()), wanted))

    begins = COMPILING if engine.name == "mjx" else ""
    finished = min(parts.kept(out) * len(pieces[0]), study.n) * n_methods
    with Progress(f"{study.experiment}: trials", study.n * n_methods, finished, begins) as progress:

        def told(rows: Rows, _: int, text: str) -> None:
            progress(len(rows), text)

        rows = parts.in_parts(out, here, pieces, work, told, request.pool)
    result = result_file.write(out, here, study.summarise(rows), rows)
    parts.finish(out)
    return result


def _sensors(
    methods: tuple[HoleMethod, ...], request: Request
) -> tuple[dict[str, TrainedSensor], Config, list[str]]:
    """Return sensors by method, the configuration with the run's network, and differences from training."""
    sensors, config, differs = {}, request.config, []
    for method in methods:
        if not method.reads or _reads_geometry(method, config):
            continue
        sensor = request.baseline if method.reads == "frame" else request.sensor
        if sensor is None and method.reads == "frame" and request.sensor:
            raise RequestError(
                f"--run: the run lacks {FRAME_BY_FRAME}, which method {method.name!r} needs; remove it from "
                "--methods, or train with a train.baseline_share above 0"
            )
        if sensor is None:
            raise RequestError(f"--run is required: method {method.name!r} needs a trained sensor")
        sensors[method.name] = sensor
        # Network and training of the baseline are the run's, except for what defines the baseline.
        if method.reads != "frame":
            config = sensor.adapt(config)
        differs = differs or sensor.differences(config)
    return sensors, config, differs


def _updates(
    methods: tuple[HoleMethod, ...], sensors: dict[str, TrainedSensor], config: Config
) -> dict[str, Update]:
    kinds = {"filter": filter_update, "position": position_update, "frame": frame_update}
    return {
        method.name: kinds[method.reads](config, sensors[method.name].network)
        if method.name in sensors
        else filter_update(config, None)
        for method in methods
        if method.reads
    }


def _reads_geometry(method: HoleMethod, config: Config) -> bool:
    return method.reads == "filter" and config.filter.reads == "geometry"
