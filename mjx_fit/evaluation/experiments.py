"""The experiments: what is run, and what of it is kept. Each writes one result file."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from mjx_fit import config as config_
from mjx_fit.config import Config
from mjx_fit.dataset.draws import MISMATCHED, draw_places
from mjx_fit.errors import RequestError
from mjx_fit.evaluation import outcome, parts, results
from mjx_fit.evaluation.results import Result
from mjx_fit.policies import SPIRAL
from mjx_fit.progress import COMPILING, Progress
from mjx_fit.randomness import root_key
from mjx_fit.sensors.model import ContactSensor
from mjx_fit.settings import N_TYPES
from mjx_fit.simulate.broken import Reporting, report
from mjx_fit.simulate.select import make_engine
from mjx_fit.simulate.threads import even_batch
from mjx_fit.task import assembly as assembly_
from mjx_fit.task.learning import learner
from mjx_fit.task.methods import ASSEMBLY, Method, chosen
from mjx_fit.task.trials import draw_trials
from mjx_fit.training import checkpoint
from mjx_fit.types import Attempt, Interaction
from mjx_fit.wrist import peak_force

ATTEMPT_BATCH = 256


def attempt(config: Config, out: Path, trials: int, seed: int, engine: str) -> Result:
    """Single attempts of Algorithm 4 from the detector's estimate.

    Args:
        config: The configuration.
        out: The result file.
        trials: Matched attempts for each shape, and mismatched ones in all, over the six pairs in turn.
        seed: Root seed.
        engine: ``auto``, ``mjx`` or ``native``.

    Raises:
        RequestError: A value is not allowed, or the file holds another result.
    """
    outcome.require_trials(trials, 4)  # as many for each shape, and mismatched ones
    request = {"trials": trials}
    asked = outcome.Asked(out, "attempt", config, seed, request, engine)
    return outcome.once(asked, lambda: _attempt(asked, trials))


def _attempt(asked: outcome.Asked, trials: int) -> Result:
    config, out, seed, engine = asked.config, asked.out, asked.seed, asked.engine
    peg_type, hole_type = _attempt_pairs(trials)
    n = len(peg_type)
    batch = even_batch(n, ATTEMPT_BATCH)
    simulator = make_engine(engine, config)
    root = root_key(seed, "attempt")
    rows: list[dict[str, Any]] = []
    with Progress("attempts", n, 0, COMPILING if simulator.name == "mjx" else "") as progress:
        for start in range(0, n, batch):
            ids = np.arange(start, start + batch)
            hole_pos, estimate, wiggle, _ = draw_places(root, jnp.asarray(ids), config.detector)
            attempts = Attempt(
                peg_type=jnp.asarray(peg_type[ids % n]),
                hole_type=jnp.asarray(hole_type[ids % n]),
                hole_pos_world=hole_pos,
                estimate_world=estimate,
                policy=jnp.full(batch, SPIRAL),
                key=wiggle,
            )
            interactions = simulator.run(attempts, config.task.attempt_actions, ids < n)
            report(interactions, attempts, ids, config.task.attempt_actions, config, outcome.broken(out))
            rows += _attempt_rows(interactions, ids[ids < n], config.scene.names)
            progress(len(rows), f"{sum(row['inserted'] for row in rows)} inserted")
    return outcome.write(asked, results.summarise_attempt(rows), rows)


def assembly(
    config: Config, out: Path, run: Path | None, methods: str, trials: int, seed: int, engine: str
) -> Result:
    """Whole assemblies under several methods, which share every trial's holes, pegs, detections and wiggles.

    Args:
        config: The configuration.
        out: The result file.
        run: Folder of the trained sensor, for the methods that read traces.
        methods: Names, comma-separated.
        trials: Number of assemblies.
        seed: Root seed.
        engine: ``auto``, ``mjx`` or ``native``.

    Raises:
        RequestError: A value is not allowed, a method needs a sensor and there is none, or the file holds
            another result.
    """
    picked = chosen(methods, ASSEMBLY)
    outcome.require_trials(trials, len(picked))
    reading = [method.name for method in picked if method.needs_sensor]
    if reading and run is None:
        raise RequestError(f"--run: none is not allowed: {reading[0]} needs the folder of a training run")
    sensor, differs = None, []
    if reading and run is not None:
        sensor, trained = checkpoint.load_sensor(run)
        config = outcome.with_network_of(trained, config)
        differs = config_.differences(trained, config)
    request = {
        "methods": [method.name for method in picked],
        "trials": trials,
        "sensor": None if sensor is None else checkpoint.fingerprint_of(sensor),
        "differs_from_training": differs,
    }
    asked = outcome.Asked(out, "assembly", config, seed, request, engine)
    result = outcome.once(asked, lambda: _assembly(asked, picked, sensor, trials))
    parts.finish(out)
    return result


def _assembly(
    asked: outcome.Asked, picked: tuple[Method, ...], sensor: ContactSensor | None, trials: int
) -> Result:
    config, out, seed, engine = asked.config, asked.out, asked.seed, asked.engine
    simulator, learn = make_engine(engine, config), learner(config, sensor)
    pieces = parts.pieces(trials, len(picked), simulator.name)
    pegs_each = len(picked) * config.task.n_holes
    before = min(parts.kept(out) * len(pieces[0]), trials) * pegs_each
    with Progress(
        "assembly: pegs", trials * pegs_each, before, COMPILING if simulator.name == "mjx" else ""
    ) as progress:

        def work(ids: Int[np.ndarray, "n"]) -> parts.Rows:
            drawn = draw_trials(config, seed, ids)
            reporting = Reporting(simulator, config, outcome.broken(out) / f"trials-{ids[0]:06d}")

            def at_work(pegs: int, text: str) -> None:
                progress(min(before + pegs, trials * pegs_each), text)

            rows = assembly_.run(config, picked, drawn, seed, reporting, learn, at_work)
            return [row for row in rows if row["trial"] < trials]

        def told(rows: parts.Rows) -> None:
            nonlocal before
            before = max(before, len(rows) * config.task.n_holes)
            progress(before, _running(rows))

        rows = parts.in_parts(asked, pieces, work, told)
    result = outcome.write(asked, results.summarise_assembly(rows), rows)
    parts.finish(out)
    return result


def _running(rows: parts.Rows) -> str:
    """Mean attempts of each method so far."""
    return ", ".join(
        f"{method} {np.mean([sum(row['attempts']) for row in own]):.1f}"
        for method, own in results.by_method(rows).items()
    )


def _attempt_pairs(trials: int) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    matched = np.repeat(np.arange(N_TYPES), trials)
    others = MISMATCHED[np.arange(trials) % len(MISMATCHED)]
    return np.concatenate([matched, others[:, 0]]), np.concatenate([matched, others[:, 1]])


def _attempt_rows(
    interactions: Interaction, ids: Int[np.ndarray, "n"], names: tuple[str, ...]
) -> list[dict[str, Any]]:
    error = np.linalg.norm(interactions.estimate_world - interactions.hole_pos_world, axis=1)
    force = peak_force(interactions)
    return [
        {
            "trial": int(trial),
            "pair": [names[interactions.peg_type[i]], names[interactions.hole_type[i]]],
            "matched": bool(interactions.peg_type[i] == interactions.hole_type[i]),
            "inserted": bool(interactions.inserted[i]),
            "valid": bool(interactions.valid[i]),
            "length": int(interactions.length[i]),
            "peak_force_n": float(force[i]),
            "error_m": float(error[i]),
        }
        for i, trial in enumerate(ids)
    ]
