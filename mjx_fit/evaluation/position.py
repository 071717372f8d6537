"""Position experiment: position error over five attempts at one hole."""

from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Key

from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import draw_places, mismatched_pairs
from mjx_fit.evaluation import result_file, single_hole_runner
from mjx_fit.evaluation.effort_summary import effort_columns, summarise_effort
from mjx_fit.evaluation.parts import Rows
from mjx_fit.evaluation.place_scores import place_columns, rotation_errors, score_places
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.results import Result, by_method
from mjx_fit.evaluation.scores import inside
from mjx_fit.evaluation.single_hole_runner import Ids, Outcomes, Study, holes_at
from mjx_fit.evaluation.statistics import Row, bootstrap_mean
from mjx_fit.task.holes import Holes
from mjx_fit.task.methods import POSITION, chosen
from mjx_fit.types import Array
from mjx_fit.utils.randomness import root_key

ATTEMPTS = 5
"""Number of attempts per trial, as in the paper."""


def position(request: Request) -> Result:
    """Run five attempts at one hole with several methods, which share the draws of each trial.

    Args:
        request: Request; its trials are the number of mismatched holes, which cycle through the pairs (none
            if the scene has one shape), and the number of matching ones.

    Raises:
        RequestError: A value is invalid, a method lacks its sensor, or the file holds another result.
    """
    picked, trials = chosen(request.methods, POSITION), request.trials
    kinds = 2 if request.config.scene.n_types > 1 else 1
    result_file.require_trials(trials, kinds * len(picked))
    study = Study(
        "position",
        picked,
        {"trials": trials},
        ATTEMPTS,
        kinds * trials,
        partial(draw_holes, trials=trials, root=root_key(request.seed, "position")),
        partial(_rows, config=request.config),
        summarise,
    )
    return single_hole_runner.run(study, request)


def summarise(trials: Rows) -> list[Row]:
    """Compute errors and coverage before the first attempt and after each; rotations if they are believed.

    Groups: ``k`` after k attempts at mismatched holes, where every trial has all attempts; ``matched:k`` at
    matching holes, where the belief is constant after the insertion; ``left:k`` at matching holes with the
    peg not inserted after k attempts. Coverage and NEES use the trials of both kinds with the peg not yet
    inserted. Seconds and newtons (``summarise_effort``) have the groups ``mismatched`` and ``matched``.
    ``inserted_wrongly`` is the share of mismatched holes that the peg went into, given if it is above 0.
    Intervals by bootstrap over trials.
    """
    rows = []
    for method, own in by_method(trials).items():
        ids = np.array([trial["trial"] for trial in own])
        error = np.array([trial["error_cm"] for trial in own])
        squared = np.array([trial["squared_mahalanobis"] for trial in own])
        errors = {"position_error_cm": error} | rotation_errors(own)
        degrees = np.array([trial.get("degrees", 2) for trial in own])
        matched = np.array([trial["pair"][0] == trial["pair"][1] for trial in own])
        inserted_at = np.array([trial["inserted_at"] or np.inf for trial in own])
        for k in range(error.shape[1]):
            left = inserted_at > k
            groups = {f"{k}": ~matched, f"matched:{k}": matched, f"left:{k}": matched & left}
            for group, keep in groups.items():
                after = {metric: values[:, k] for metric, values in errors.items()}
                rows += _means(method, after, group, ids, keep)
            scores = {
                "coverage_50": inside(squared[:, k], 0.5, degrees),
                "coverage_90": inside(squared[:, k], 0.9, degrees),
                "nees": squared[:, k] / degrees,
            }
            rows += _means(method, scores, f"{k}", ids, left) if method != "oracle" else []
        wrongly = np.array([trial.get("inserted_wrongly", False) for trial in own])
        for group, keep in {"mismatched": ~matched, "matched": matched}.items():
            kept = [trial for trial, wanted in zip(own, keep, strict=True) if wanted]
            success = None if group == "mismatched" else np.isfinite(inserted_at[keep]).tolist()
            rows += summarise_effort(method, kept, group, success)
        if wrongly.any():
            rows += _means(method, {"inserted_wrongly": wrongly}, "mismatched", ids, ~matched)
    return rows


def _means(
    method: str,
    columns: dict[str, np.ndarray],
    group: str,
    ids: Float[np.ndarray, " n"],
    keep: Bool[np.ndarray, " n"],
) -> list[Row]:
    rows = []
    for metric, values in columns.items():
        kept = keep & np.isfinite(values)
        if kept.any():
            interval = bootstrap_mean(values[kept], ids[kept].tolist())
            rows.append(Row.of(method, metric, group, interval, int(kept.sum())))
    return rows


def draw_holes(config: Config, ids: Ids, trials: int, root: Key[Array, ""]) -> Holes:
    """Draw holes: ids below ``trials`` are mismatched and cycle through the pairs, the others match."""
    n_types = config.scene.n_types
    peg = other = ids % n_types
    pairs = mismatched_pairs(n_types)
    if len(pairs):
        pair, mismatched = pairs[ids % len(pairs)], ids < trials
        peg = np.where(mismatched, pair[:, 0], peg)
        other = np.where(mismatched, pair[:, 1], peg)
    return holes_at(peg, other, draw_places(root, jnp.asarray(ids), config))


def _rows(ids: Ids, world: Holes, outcomes: Outcomes, config: Config) -> Rows:
    rows, wrong, names = [], world.peg_type != world.hole_type, config.scene.names
    for method, done in outcomes.items():
        scores = score_places(done.mean_world, done.cov, done.place_world, world.hole_type, config)
        rows += [
            {
                "trial": int(trial),
                "method": method,
                "pair": [names[world.peg_type[i]], names[world.hole_type[i]]],
                **place_columns(scores, i),
                "inserted_at": int(done.inserted_at[i]) or None,
                **effort_columns(done.effort, i, ATTEMPTS),
                "move_seconds": round(float(done.move_seconds[i]), 4),
                **({"inserted_wrongly": True} if done.inserted_at[i] and wrong[i] else {}),
            }
            for i, trial in enumerate(ids)
        ]
    return rows
