"""Assembly experiment: whole assemblies with several methods, on the same trials."""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from mjx_fit.engines.failures import Reporting
from mjx_fit.evaluation import parts, result_file, results
from mjx_fit.evaluation.effort_summary import seconds_of_pegs, shares_in_time, summarise_effort
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.jobs.pool import Tell
from mjx_fit.scene.scenarios import draw_trials
from mjx_fit.task.assembly import confirmation_of_rows, rounds, update_of_rows
from mjx_fit.task.assembly_state import Table
from mjx_fit.task.methods import ASSEMBLY, Method, chosen
from mjx_fit.training.sensor_loader import TrainedSensor
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.progress import COMPILING, Progress


def assembly(request: Request) -> Result:
    """Run whole assemblies with several methods, which share holes, pegs, detections and noise of each trial.

    Args:
        request: Request; its trials are assemblies.

    Raises:
        RequestError: A value is invalid, a method lacks its sensor, or the file holds another result.
    """
    picked = chosen(request.methods, ASSEMBLY)
    result_file.require_trials(request.trials, len(picked))
    reading = [method.name for method in picked if method.needs_sensor]
    if request.config.filter.reads == "geometry":
        reading = []
    sensor = request.sensor if reading else None
    if reading and sensor is None:
        raise RequestError(f"--run is required: method {reading[0]!r} needs a trained sensor")
    if sensor:
        request = replace(request, config=sensor.adapt(request.config))
    asked = {
        "methods": [method.name for method in picked],
        "trials": request.trials,
        **request.asked_policy(),
        **request.asked_parts(),
        "sensor": sensor.fingerprint if sensor else None,
        "differs_from_training": sensor.differences(request.config) if sensor else [],
    }
    here = result_file.header("assembly", request.config, request.seed, request.engine.name, asked)
    result = result_file.once(request.out, here, lambda: _assembly(request, here, picked, sensor))
    parts.finish(request.out)
    return result


def _assembly(
    request: Request, here: result_file.Header, picked: tuple[Method, ...], sensor: TrainedSensor | None
) -> Result:
    config, out, trials, engine = request.config, request.out, request.trials, request.engine
    pieces = parts.pieces(trials, len(picked), engine.name, config, request.rows_of_parts)
    network = sensor.network if sensor else None
    update = update_of_rows(config, picked, len(pieces[0]), network)
    confirm = confirmation_of_rows(config, picked, len(pieces[0]), network)
    broken, n_holes, seed = result_file.broken(out), config.task.n_holes, request.seed

    def work(ids: Int[np.ndarray, "n"], tell: Tell) -> parts.Rows:
        table = Table(config, picked, draw_trials(config, seed, ids), seed)
        reporting = Reporting(engine, config, broken / f"trials-{ids[0]:06d}")
        for _ in rounds(table, reporting, update, confirm):
            open_ = f"{table.active.sum()} of {len(table.active)} assemblies open"
            tell(int(table.pegs_done.sum()), open_)
        return [row for row in table.rows() if row["trial"] < trials]

    pegs = trials * len(picked) * n_holes
    before = min(parts.kept(out) * len(pieces[0]), trials) * len(picked) * n_holes
    begins = COMPILING if engine.name == "mjx" else ""
    with Progress("assembly: pegs", pegs, before, begins) as progress:

        def told(rows: parts.Rows, done: int, text: str) -> None:
            progress(min(len(rows) * n_holes + done, pegs), text or _running(rows))

        rows = parts.in_parts(out, here, pieces, work, told, request.pool)
    result = result_file.write(out, here, summarise(rows), rows)
    parts.finish(out)
    return result


def summarise(trials: parts.Rows) -> list[Row]:
    """Compute the rows of ``summarise_assembly``, and seconds and newtons of whole assemblies.

    Seconds are those of all pegs together; ``in_by_5s`` and so on are shares of pegs, not of assemblies. A
    peg that a human inserted is in by no time, and one in a hole of another type is not in.
    """
    rows = results.summarise_assembly(trials)
    for method, own in results.by_method(trials).items():
        rows += summarise_effort(method, own)
        timed = [trial for trial in own if "seconds" in trial]
        if timed:
            draws = [trial["trial"] for trial in timed for _ in trial["pegs"]]
            rows += shares_in_time(method, seconds_of_pegs(timed), draws, "all")
    return rows


def _running(rows: parts.Rows) -> str:
    """Format the mean number of attempts of each method so far."""
    return ", ".join(
        f"{method} {np.mean([sum(row['attempts']) for row in own]):.1f}"
        for method, own in results.by_method(rows).items()
    )
