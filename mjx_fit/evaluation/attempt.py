"""Attempt experiment: success rate of single attempts of Algorithm 4."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from mjx_fit.control.policies import NAMES
from mjx_fit.data.schedule import draw_places, mismatched_pairs
from mjx_fit.engines.failures import as_run, report
from mjx_fit.engines.interface import Engine
from mjx_fit.engines.threads import even_batch
from mjx_fit.evaluation import parts, result_file, results
from mjx_fit.evaluation.effort_summary import summarise_effort
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.filters.updates import detected_belief
from mjx_fit.jobs.pool import Tell
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.task.effort import COLUMNS, effort_of
from mjx_fit.types import Rollout
from mjx_fit.utils.progress import COMPILING, Progress
from mjx_fit.utils.randomness import root_key

ATTEMPT_BATCH = 256


def attempt(request: Request) -> Result:
    """Run single attempts of Algorithm 4 from the detector's estimate.

    Args:
        request: Request; its trials are the matched attempts of each shape, and also the total of mismatched
            attempts, which cycle through the pairs.

    Raises:
        RequestError: A value is invalid, or the file holds another result.
    """
    n_types = request.config.scene.n_types
    result_file.require_trials(request.trials, n_types + (n_types > 1))  # each shape, and mismatched
    asked = {"trials": request.trials, **request.asked_policy(), **request.asked_parts()}
    here = result_file.header("attempt", request.config, request.seed, request.engine.name, asked)
    result = result_file.once(request.out, here, lambda: _attempt(request, here))
    parts.finish(request.out)
    return result


def _attempt(request: Request, here: result_file.Header) -> Result:
    config, engine, actions = request.config, request.engine, request.config.task.attempt_actions
    peg_type, hole_type = _attempt_pairs(request.trials, config.scene.n_types)
    n = len(peg_type)
    batch = even_batch(n, request.rows_of_parts or ATTEMPT_BATCH)
    root, dumps = root_key(request.seed, "attempt"), result_file.broken(request.out)

    def work(ids: Int[np.ndarray, "m"], _: Tell) -> parts.Rows:
        there = draw_places(root, jnp.asarray(ids), config)
        attempts = spirals_at(
            peg_type[ids % n],
            hole_type[ids % n],
            there.hole_pos_world,
            detected_belief(there.estimate_world, config).mean_world,
            there.key,
            there.physics,
        )
        rollouts = engine.run(attempts, actions, ids < n)
        report(rollouts, as_run(attempts, engine), ids, actions, config, dumps)
        return _attempt_rows(rollouts, ids[ids < n], config.scene.names)

    finished = min(parts.kept(request.out) * batch, n)
    with Progress("attempts", n, finished, COMPILING if engine.name == "mjx" else "") as progress:

        def told(rows: parts.Rows, _: int, text: str) -> None:
            progress(len(rows), text or f"{sum(row['inserted'] for row in rows)} inserted")

        pieces = [np.arange(start, start + batch) for start in range(0, n, batch)]
        rows = parts.in_parts(request.out, here, pieces, work, told, request.pool)
    return result_file.write(request.out, here, summarise(rows, _method(engine)), rows)


def summarise(trials: parts.Rows, method: str = results.ATTEMPT_METHOD) -> list[Row]:
    """Compute the rates of ``summarise_attempt``, and seconds and newtons of matched and other attempts."""
    rows = results.summarise_attempt(trials, method) + results.summarise_sensed(trials, method)
    valid = [trial for trial in trials if trial["valid"]]
    matched = [trial for trial in valid if trial["matched"]]
    others = [trial for trial in valid if not trial["matched"]]
    rows += summarise_effort(method, matched, "matched", [trial["inserted"] for trial in matched])
    return rows + summarise_effort(method, others, "mismatched")


def _method(engine: Engine) -> str:
    """The method in the rows of the summary: the policy's name, without the digest of its file."""
    name = engine.policy_name or results.ATTEMPT_METHOD
    short = name.partition("@")[0]
    return name if short in NAMES else short


def _attempt_pairs(trials: int, n_types: int) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    matched, others = np.repeat(np.arange(n_types), trials), mismatched_pairs(n_types)
    others = others[np.arange(trials) % len(others)] if len(others) else others
    return np.concatenate([matched, others[:, 0]]), np.concatenate([matched, others[:, 1]])


def _attempt_rows(
    rollouts: Rollout, ids: Int[np.ndarray, "n"], names: tuple[str, ...]
) -> list[dict[str, Any]]:
    estimate = np.asarray(rollouts.felt.estimate_world)[:, :2]
    error = np.linalg.norm(estimate - rollouts.truth.hole_pos_world, axis=1)
    effort, wrongly, sensed = effort_of(rollouts.felt), rollouts.inserted_wrongly, rollouts.sensed
    columns = {name: getattr(effort, name)[:, None] for name in COLUMNS}
    return [
        {
            "trial": int(trial),
            "pair": [names[rollouts.felt.peg_type[i]], names[rollouts.truth.hole_type[i]]],
            "matched": bool(rollouts.felt.peg_type[i] == rollouts.truth.hole_type[i]),
            "inserted": bool(rollouts.succeeded[i]),
            "valid": bool(rollouts.truth.valid[i]),
            "length": int(rollouts.felt.length[i]),
            **{name: result_file.rounded(values[i]) for name, values in columns.items()},
            "move_seconds": 0.0,
            "error_m": float(error[i]),
            **({"inserted_wrongly": True} if wrongly[i] else {}),
            **({"sensed": bool(sensed[i])} if sensed is not None else {}),
        }
        for i, trial in enumerate(ids)
    ]
