"""The experiments: what is run, and what of it is kept. Each writes one result file."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from mjx_fit.dataset.draws import draw_places, mismatched_pairs
from mjx_fit.errors import RequestError
from mjx_fit.evaluation import outcome, parts, results
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.results import Result
from mjx_fit.progress import COMPILING, Progress
from mjx_fit.randomness import root_key
from mjx_fit.simulate.broken import Reporting, report
from mjx_fit.simulate.threads import even_batch
from mjx_fit.task import assembly as assembly_
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.task.methods import ASSEMBLY, Method, chosen
from mjx_fit.task.table import Table
from mjx_fit.task.trials import draw_trials
from mjx_fit.training.trained_sensor import TrainedSensor
from mjx_fit.types import Rollout
from mjx_fit.wrist import peak_force

ATTEMPT_BATCH = 256


def attempt(request: Request) -> Result:
    """Single attempts of Algorithm 4 from the detector's estimate.

    Args:
        request: Its trials count matched attempts for each shape, and mismatched ones in all, over the pairs
            in turn.

    Raises:
        RequestError: A value is not allowed, or the file holds another result.
    """
    n_types = request.config.scene.n_types
    outcome.require_trials(request.trials, n_types + (n_types > 1))  # of each shape, and mismatched ones
    asked = {"trials": request.trials}
    here = outcome.header("attempt", request.config, request.seed, request.engine.name, asked)
    return outcome.once(request.out, here, lambda: _attempt(request, here))


def _attempt(request: Request, here: outcome.Header) -> Result:
    config, engine, actions = request.config, request.engine, request.config.task.attempt_actions
    peg_type, hole_type = _attempt_pairs(request.trials, config.scene.n_types)
    n = len(peg_type)
    batch = even_batch(n, ATTEMPT_BATCH)
    root, dumps = root_key(request.seed, "attempt"), outcome.broken(request.out)
    rows: list[dict[str, Any]] = []
    with Progress("attempts", n, 0, COMPILING if engine.name == "mjx" else "") as progress:
        for start in range(0, n, batch):
            ids = np.arange(start, start + batch)
            hole_pos, estimate, wiggle, _ = draw_places(root, jnp.asarray(ids), config)
            attempts = spirals_at(peg_type[ids % n], hole_type[ids % n], hole_pos, estimate, wiggle)
            rollouts = engine.run(attempts, actions, ids < n)
            report(rollouts, attempts, ids, actions, config, dumps)
            rows += _attempt_rows(rollouts, ids[ids < n], config.scene.names)
            progress(len(rows), f"{sum(row['inserted'] for row in rows)} inserted")
    return outcome.write(request.out, here, results.summarise_attempt(rows), rows)


def assembly(request: Request) -> Result:
    """Whole assemblies under several methods, which share every trial's holes, pegs, detections and noise.

    Args:
        request: Its trials count assemblies.

    Raises:
        RequestError: A value is not allowed, a method needs a sensor and there is none, or the file holds
            another result.
    """
    picked = chosen(request.methods, ASSEMBLY)
    outcome.require_trials(request.trials, len(picked))
    reading = [method.name for method in picked if method.needs_sensor]
    sensor = request.sensor if reading else None
    if reading and sensor is None:
        raise RequestError(f"--run: none is not allowed: {reading[0]} needs the folder of a training run")
    if sensor:
        request = replace(request, config=sensor.adapt(request.config))
    asked = {
        "methods": [method.name for method in picked],
        "trials": request.trials,
        "sensor": sensor.fingerprint if sensor else None,
        "differs_from_training": sensor.differences(request.config) if sensor else [],
    }
    here = outcome.header("assembly", request.config, request.seed, request.engine.name, asked)
    result = outcome.once(request.out, here, lambda: _assembly(request, here, picked, sensor))
    parts.finish(request.out)
    return result


def _assembly(
    request: Request, here: outcome.Header, picked: tuple[Method, ...], sensor: TrainedSensor | None
) -> Result:
    config, out, trials, engine = request.config, request.out, request.trials, request.engine
    pieces = parts.pieces(trials, len(picked), engine.name)
    network = sensor.network if sensor else None
    update = assembly_.update_of_rows(config, picked, len(pieces[0]), network)
    pegs_each = len(picked) * config.task.n_holes
    before = min(parts.kept(out) * len(pieces[0]), trials) * pegs_each
    with Progress(
        "assembly: pegs", trials * pegs_each, before, COMPILING if engine.name == "mjx" else ""
    ) as progress:

        def work(ids: Int[np.ndarray, "n"]) -> parts.Rows:
            table = Table(config, picked, draw_trials(config, request.seed, ids), request.seed)
            reporting = Reporting(engine, config, outcome.broken(out) / f"trials-{ids[0]:06d}")
            for _ in assembly_.rounds(table, reporting, update):
                pegs = before + int(table.pegs_done.sum())
                left = f"{table.active.sum()} of {len(table.active)} assemblies open"
                progress(min(pegs, trials * pegs_each), left)
            return [row for row in table.rows() if row["trial"] < trials]

        def told(rows: parts.Rows) -> None:
            nonlocal before
            before = max(before, len(rows) * config.task.n_holes)
            progress(before, _running(rows))

        rows = parts.in_parts(out, here, pieces, work, told)
    result = outcome.write(out, here, results.summarise_assembly(rows), rows)
    parts.finish(out)
    return result


def _running(rows: parts.Rows) -> str:
    """Mean attempts of each method so far."""
    return ", ".join(
        f"{method} {np.mean([sum(row['attempts']) for row in own]):.1f}"
        for method, own in results.by_method(rows).items()
    )


def _attempt_pairs(trials: int, n_types: int) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    matched, others = np.repeat(np.arange(n_types), trials), mismatched_pairs(n_types)
    others = others[np.arange(trials) % len(others)] if len(others) else others
    return np.concatenate([matched, others[:, 0]]), np.concatenate([matched, others[:, 1]])


def _attempt_rows(
    rollouts: Rollout, ids: Int[np.ndarray, "n"], names: tuple[str, ...]
) -> list[dict[str, Any]]:
    error = np.linalg.norm(rollouts.felt.estimate_world - rollouts.truth.hole_pos_world, axis=1)
    force, wrongly = peak_force(rollouts.felt), rollouts.inserted_wrongly
    return [
        {
            "trial": int(trial),
            "pair": [names[rollouts.felt.peg_type[i]], names[rollouts.truth.hole_type[i]]],
            "matched": bool(rollouts.felt.peg_type[i] == rollouts.truth.hole_type[i]),
            "inserted": bool(rollouts.succeeded[i]),
            "valid": bool(rollouts.truth.valid[i]),
            "length": int(rollouts.felt.length[i]),
            "peak_force_n": float(force[i]),
            "error_m": float(error[i]),
            **({"inserted_wrongly": True} if wrongly[i] else {}),
        }
        for i, trial in enumerate(ids)
    ]
