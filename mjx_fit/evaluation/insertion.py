"""Insertion experiment: number of attempts until a peg is inserted at a matching hole."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import draw_places
from mjx_fit.evaluation import result_file, single_hole_runner
from mjx_fit.evaluation.effort_summary import effort_columns, summarise_effort, totals
from mjx_fit.evaluation.parts import Rows
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.results import Result, by_method
from mjx_fit.evaluation.single_hole_runner import Ids, Outcomes, Study, holes_at
from mjx_fit.evaluation.statistics import Row, bootstrap_mean, clustered_rate, holm, sign_flip
from mjx_fit.task.holes import Holes
from mjx_fit.task.methods import INSERTION, chosen
from mjx_fit.utils.randomness import root_key

ATTEMPTS = 10
"""Maximum number of attempts per trial, as in the paper."""


def insertion(request: Request) -> Result:
    """Run up to ten attempts at a matching hole with several methods, which share the draws of each trial.

    Args:
        request: Request; its trials are draws of a hole and its detection, which cycle through the shapes,
            each repeated for its ``seeds``.

    Raises:
        RequestError: A value is invalid, a method lacks its sensor, or the file holds another result.
    """
    picked, trials, seeds = chosen(request.methods, INSERTION), request.trials, request.seeds
    result_file.require_trials(trials, len(picked), seeds)
    study = Study(
        "insertion",
        picked,
        {"trials": trials, "seeds": seeds},
        ATTEMPTS,
        trials * seeds,
        partial(draw_holes, seeds=seeds, seed=request.seed),
        partial(_rows, seeds=seeds, names=request.config.scene.names),
        summarise,
    )
    return single_hole_runner.run(study, request)


def summarise(trials: Rows) -> list[Row]:
    """Compute success within k attempts, mean attempts, and attempts saved by ``full`` over other methods.

    A failed trial counts one attempt more than the maximum. ``success_rate`` has a group for each k,
    ``attempts`` the group ``all``; seconds and newtons are those of ``summarise_effort``. ``attempts_saved``
    and ``p_value`` have a group for each other method; p comes from a sign-flip test on pairs of the same
    draw and seed, with Holm's adjustment. ``seconds_saved`` and ``seconds_p_value`` compare the seconds of
    all attempts in the same way. The seeds of a draw are dependent, so whole draws are resampled or flipped.
    """
    rows, needed, seconds, draws = [], {}, {}, []
    for method, unordered in by_method(trials).items():
        own = sorted(unordered, key=lambda trial: (trial["trial"], trial["seed"]))
        draws = [trial["trial"] for trial in own]
        attempts = np.array([t["attempts"] if t["success"] else ATTEMPTS + 1 for t in own])
        needed[method] = attempts
        for k in range(1, ATTEMPTS + 1):
            within = attempts <= k
            rows.append(Row.of(method, "success_rate", str(k), clustered_rate(within, draws), len(own)))
        rows.append(Row.of(method, "attempts", "all", bootstrap_mean(attempts, draws), len(own)))
        rows += summarise_effort(method, own, success=[trial["success"] for trial in own])
        if all("seconds" in trial for trial in own):
            seconds[method] = totals(own, "seconds")
    rows += _saved(needed, draws, ("attempts_saved", "p_value"))
    if len(seconds) == len(needed):
        rows += _saved(seconds, draws, ("seconds_saved", "seconds_p_value"))
    return rows


def _saved(
    spent: dict[str, Float[np.ndarray, " n"]], draws: list[int], metrics: tuple[str, str]
) -> list[Row]:
    """Compare what ``full`` spends with the other methods, trial by trial; each is a group."""
    others = [method for method in spent if method not in ("full", "oracle")]
    if "full" not in spent or not others:
        return []
    saved = {method: spent[method] - spent["full"] for method in others}
    p_values = holm([sign_flip(saved[method], draws) for method in others])
    rows = []
    for method, p_value in zip(others, p_values, strict=True):
        n = len(saved[method])
        rows.append(Row.of("full", metrics[0], method, bootstrap_mean(saved[method], draws), n))
        rows.append(Row("full", metrics[1], method, p_value, None, None, n))
    return rows


def draw_holes(config: Config, ids: Ids, seeds: int, seed: int) -> Holes:
    draw, number = np.divmod(ids, seeds)
    shape = draw % config.scene.n_types
    places = draw_places(root_key(seed, "insertion"), jnp.asarray(draw), config)
    own = jax.vmap(jax.random.fold_in)(places.key, jnp.asarray(number))
    return holes_at(shape, shape, replace(places, key=own))


def _rows(ids: Ids, world: Holes, outcomes: Outcomes, seeds: int, names: tuple[str, ...]) -> Rows:
    return [
        {
            "trial": int(trial) // seeds,
            "seed": int(trial) % seeds,
            "method": method,
            "shape": names[world.peg_type[i]],
            "attempts": int(done.attempts[i]),
            "success": bool(done.inserted_at[i] > 0),
            **effort_columns(done.effort, i, int(done.attempts[i])),
            "move_seconds": round(float(done.move_seconds[i]), 4),
        }
        for method, done in outcomes.items()
        for i, trial in enumerate(ids)
    ]
