"""Robustness experiment: a sensor, or the geometry of contact, in perturbed worlds, on the same holes."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.engines.failures import Reporting
from mjx_fit.engines.interface import Engine
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation import parts, result_file
from mjx_fit.evaluation.effort_summary import effort_columns, summarise_effort
from mjx_fit.evaluation.parts import Rows
from mjx_fit.evaluation.perturbations import Perturbation, chosen_perturbations
from mjx_fit.evaluation.place_scores import place_columns, rotation_errors, score_places
from mjx_fit.evaluation.position import draw_holes
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.scores import auroc, inside
from mjx_fit.evaluation.statistics import Row, bootstrap_mean, bootstrap_score, clustered_rate
from mjx_fit.jobs.pool import Here, Tell
from mjx_fit.task import single_hole
from mjx_fit.task.estimator import Update, filter_update
from mjx_fit.task.holes import Holes, Outcome
from mjx_fit.task.methods import POSITION
from mjx_fit.training.sensor_loader import TrainedSensor
from mjx_fit.types import Belief, Felt
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.progress import Progress
from mjx_fit.utils.randomness import root_key

ATTEMPTS, SHOWN = 5, (1, 2, 5)
"""Attempts at one hole, and those after which the belief is scored."""
METHOD = "full"
MM_PER_CM = 10.0
AWAY_CM, AWAY_SQUARED = 1.0, 50.0
"""A belief has run away if it is worse than both after two attempts in a row: error, Mahalanobis distance."""
LEAST_OF_EACH = 10
"""Fewest failed attempts at matching and at other holes for an AUROC."""


@dataclass(frozen=True)
class _Part:
    """Trials under one perturbation."""

    name: str
    ids: Int[np.ndarray, "n"]


def robustness(request: Request, names: str) -> Result:
    """Run five attempts at one hole with the full method under each perturbation.

    Args:
        request: Request; its trials are the number of mismatched holes; half as many matching ones follow,
            for the match classification.
        names: Names of the perturbations, comma-separated.

    Raises:
        RequestError: A value is invalid, the sensor is missing, or the file holds another result.
    """
    asked = chosen_perturbations(names)
    if request.config.filter.reads == "geometry":
        request = replace(request, sensor=None)
    elif request.sensor is None:
        raise RequestError(f"--run is required: method {METHOD!r} needs a trained sensor")
    result_file.require_trials(request.trials, 2 * len(asked))
    sensor, config = request.sensor, request.config
    if sensor is not None:
        config = sensor.adapt(config)
    for name, perturbation in asked.items():  # refuse before any work
        try:
            perturbation.applied_to(config)
        except RequestError as error:
            raise RequestError(f"--perturbations: {name} cannot be used: {error}") from None
    entries = {
        "methods": [METHOD],
        "trials": request.trials,
        **request.asked_parts(),
        "perturbations": list(asked),
        "sensor": {METHOD: sensor.fingerprint} if sensor else {},
        "differs_from_training": sensor.differences(config) if sensor else [],
    }
    here = result_file.header("robustness", config, request.seed, request.engine.name, entries)
    result = result_file.once(request.out, here, lambda: _worked_out(request, config, asked, here))
    parts.finish(request.out)
    return result


def _worked_out(
    request: Request, config: Config, asked: dict[str, Perturbation], here: result_file.Header
) -> Result:
    out, n = request.out, request.trials + request.trials // 2
    ids = parts.pieces(n, 1, request.engine.name, config, request.rows_of_parts)
    pieces = [_Part(name, own) for name in asked for own in ids]
    work = partial(_trials, replace(request, pool=Here()), config, asked, n)
    with Progress("robustness: parts", len(pieces), parts.kept(out)) as progress:

        def told(_: Rows, __: int, text: str) -> None:
            progress(parts.kept(out), text)

        rows = parts.in_parts(out, here, pieces, work, told, request.pool)
    result = result_file.write(out, here, summarise(rows), rows)
    parts.finish(out)
    return result


def _trials(
    request: Request, config: Config, asked: dict[str, Perturbation], n: int, part: _Part, tell: Tell
) -> Rows:
    tell(0, part.name)
    perturbation = asked[part.name]
    changed = perturbation.applied_to(config)
    engine = _engine(request, changed, perturbation)
    root = root_key(request.seed, "robustness")
    world = draw_holes(changed, part.ids, request.trials, root)  # each quantity has a draw of its own
    update = _update(changed, request.sensor, perturbation)
    methods = tuple(method for method in POSITION if method.name == METHOD)
    table = single_hole.HoleTable(changed, methods, world, ATTEMPTS)
    broken = result_file.broken(request.out) / f"{part.name}-{part.ids[0]:06d}"
    reporting = Reporting(engine, changed, broken)
    for _ in single_hole.rounds(table, reporting, update):
        pass
    rows = _rows(part, world, table.outcomes()[METHOD], changed)
    return [row for row in rows if row["trial"] < n]


def _engine(request: Request, config: Config, perturbation: Perturbation) -> Engine:
    name = request.engine.name
    if perturbation.other_engine:
        name = "mjx" if name == "native" else "native"
    return make_engine(name, config)


def _update(config: Config, sensor: TrainedSensor | None, perturbation: Perturbation) -> Update:
    learn, change = filter_update(config, sensor.network if sensor else None), perturbation.felt
    if change is None:
        return learn

    def update(beliefs: Belief, felt: Felt, keys) -> Belief:
        return learn(beliefs, change(felt, config), keys)

    return update


def _rows(part: _Part, world: Holes, done: Outcome, config: Config) -> Rows:
    scores, names = (
        score_places(done.mean_world, done.cov, done.place_world, world.hole_type, config),
        config.scene.names,
    )
    return [
        {
            "trial": int(trial),
            "method": METHOD,
            "perturbation": part.name,
            "pair": [names[world.peg_type[i]], names[world.hole_type[i]]],
            **place_columns(scores, i),
            "match_probability": result_file.rounded(done.match_probability[i]),
            "inserted_at": int(done.inserted_at[i]) or None,
            **effort_columns(done.effort, i, ATTEMPTS),
            "move_seconds": round(float(done.move_seconds[i]), 4),
        }
        for i, trial in enumerate(part.ids)
    ]


def run_away(error_cm: Float[np.ndarray, "n K"], squared: Float[np.ndarray, "n K"]) -> Bool[np.ndarray, "n"]:
    """Tell which beliefs are far from the hole and sure of themselves after two attempts in a row.

    Args:
        error_cm: Position errors after each attempt.
        squared: Squared Mahalanobis distances of the holes.
    """
    away = np.logical_and(error_cm > AWAY_CM, squared > AWAY_SQUARED)
    return np.any(away[:, 1:] & away[:, :-1], axis=1)


def summarise(trials: Rows) -> list[Row]:
    """Compute error, coverage and match classification by perturbation and number of attempts.

    Groups are ``NAME:K``: perturbation and attempts made. ``position_error_mm`` uses the mismatched holes,
    whose belief stays as it is after an insertion; ``coverage_90`` and ``nees`` the same; ``match_auroc`` the
    trials of both kinds whose first K attempts failed. ``runaway`` and ``inserted_wrongly``, with the group
    ``NAME``, are shares of the mismatched holes; the second is given if it is above 0. Seconds and newtons
    (``summarise_effort``), with the group ``NAME``, are those of the mismatched holes. Intervals by bootstrap
    over trials, Wilson's for rates of 0 and 1.
    """
    rows = []
    for name in dict.fromkeys(trial["perturbation"] for trial in trials):
        own = [trial for trial in trials if trial["perturbation"] == name]
        ids = np.array([trial["trial"] for trial in own])
        error = np.array([trial["error_cm"] for trial in own])
        squared = np.array([trial["squared_mahalanobis"] for trial in own])
        turns = rotation_errors(own)
        degrees = np.array([trial.get("degrees", 2) for trial in own])
        chance = np.array([trial["match_probability"] for trial in own])
        matched = np.array([trial["pair"][0] == trial["pair"][1] for trial in own])
        inserted_at = np.array([trial["inserted_at"] or np.inf for trial in own])
        kept = np.asarray(~matched if (~matched).any() else matched)
        twice = run_away(error[:, 1:], squared[:, 1:])
        wrongly = ~matched & np.isfinite(inserted_at)
        columns = {"runaway": (twice, name)} | (
            {"inserted_wrongly": (wrongly, name)} if wrongly.any() else {}
        )
        for k in SHOWN:
            group = f"{name}:{k}"
            columns |= {
                f"position_error_mm {k}": (MM_PER_CM * error[:, k], group),
                f"coverage_90 {k}": (inside(squared[:, k], 0.9, degrees), group),
                f"nees {k}": (squared[:, k] / degrees, group),
            }
            columns |= {f"{metric} {k}": (values[:, k], group) for metric, values in turns.items()}
        for metric, (values, group) in columns.items():
            rate = (
                bootstrap_mean if metric.startswith(("position", "turn", "yaw", "nees")) else clustered_rate
            )
            known = kept & np.isfinite(values)
            if not known.any():
                continue
            interval = rate(values[known], ids[known].tolist())
            rows.append(Row.of(METHOD, metric.partition(" ")[0], group, interval, int(known.sum())))
        rows += summarise_effort(METHOD, [trial for trial, keep in zip(own, kept, strict=True) if keep], name)
        for k in SHOWN:
            failed = inserted_at > k
            if min(int((failed & matched).sum()), int((failed & ~matched).sum())) >= LEAST_OF_EACH:
                value = bootstrap_score(auroc, chance[failed, k], matched[failed], ids[failed])
                rows.append(Row.of(METHOD, "match_auroc", f"{name}:{k}", value, int(failed.sum())))
    return rows
