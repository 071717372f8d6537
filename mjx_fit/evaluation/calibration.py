"""Calibration experiment: trained sensors on held-out attempts."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from mjx_fit.config.schema import Config
from mjx_fit.data import reader
from mjx_fit.data.episode import Episode
from mjx_fit.data.manifest import ROBOT, read_manifest, require_truth
from mjx_fit.evaluation import held_out, result_file, scores
from mjx_fit.evaluation.place_scores import rotation_errors
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row, bootstrap_mean, bootstrap_score
from mjx_fit.sensors.reading import without_errors
from mjx_fit.training.compatibility import require_new, require_world
from mjx_fit.training.sensor_loader import TrainedSensor, load_baseline, load_trained_sensor
from mjx_fit.training.split import require_sound
from mjx_fit.utils import provenance
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.progress import Progress

RESAMPLES = 500
"""Bootstrap resamples of scores that are not means."""

SHARES = (0.2, 0.4, 0.6, 0.8)
"""Shares of an attempt's actions that are scored, in addition to the whole attempt."""

_Trials = list[dict[str, Any]]


def calibrate(config: Config, out: Path, run: Path, data: Path, seed: int) -> Result:
    """Update once from each failed attempt of a data set, with a run's sensor and frame-by-frame baseline.

    Args:
        config: Configuration; ``task`` and ``wrist`` are used, ``sensor`` and ``train`` come from the run. No
            errors are added to what a robot measured.
        out: Result file.
        run: Folder of a training run.
        data: Folder of a data set that shares neither attempts nor holes with the training data.
        seed: Root seed of the sensor noise.

    Raises:
        RequestError: Run or data cannot be used, their scenes differ, the file holds another result, or no
            sensor is to read the traces.
    """
    if config.filter.reads == "geometry":
        raise RequestError(
            "config: filter.reads: geometry cannot be used: expected sensor, whose training is judged; "
            "evaluate position and evaluate robustness measure the geometry of contact"
        )
    sensor = load_trained_sensor(run)
    config = sensor.adapt(config)
    baseline = load_baseline(run)
    sensors = {"full": sensor} | ({"frame_by_frame": baseline} if baseline else {})
    asked_for = read_manifest(data).request
    require_truth(data, asked_for)
    require_world(asked_for, config)
    episodes = reader.load(data)
    actions = _actions_read(episodes, config)
    robots = asked_for["engine"] == ROBOT
    # A robot's attempts end when they end, and its measurements have their own errors.
    ids = held_out.failed_attempts(episodes, 1 if robots else actions)
    read_as = without_errors(config) if robots else config
    require_sound(episodes, np.isin(np.arange(len(episodes.episode)), ids), config.scene.n_types)
    request = {
        "methods": list(sensors),
        "data": provenance.fingerprint(episodes),
        "beliefs_of": asked_for.get("sensor", ""),
        "sensor": {name: one.fingerprint for name, one in sensors.items()},
        "differs_from_training": sensor.differences(config),
    }
    require_new(run, episodes, request["data"])
    here = result_file.header("calibration", config, seed, asked_for["engine"], request)

    def work() -> Result:
        trials = _trials_of(sensors, episodes, ids, read_as, seed)
        # Rows of partial attempts would make the file five times as large; the summary has their scores.
        whole = [trial for trial in trials if trial["actions"] == actions]
        return result_file.write(out, here, summarise(trials, actions, config.scene.names), whole)

    return result_file.once(out, here, work)


def _trials_of(
    sensors: dict[str, TrainedSensor],
    episodes: Episode,
    ids: Int[np.ndarray, "n"],
    config: Config,
    seed: int,
) -> _Trials:
    """Return one row for each sensor, number of actions used, and attempt."""
    actions = _actions_read(episodes, config)
    counts = sorted({max(1, round(share * actions)) for share in (*SHARES, 1)})
    trials: _Trials = []
    with Progress("calibration: passes", len(sensors) * len(counts)) as progress:
        for name, one in sensors.items():
            for count in counts:
                seen = held_out.observe(one.network, episodes, ids, count, config, seed)
                after = held_out.posterior(seen, episodes, ids, config, with_prior=name == "full")
                trials += held_out.rows(name, count, after, episodes, ids, config)
                progress(len(trials) // len(ids), f"{name}, {count} actions")
    return trials


def _actions_read(episodes: Episode, config: Config) -> int:
    """Return the number of actions in a whole attempt: that of the task, at most that stored."""
    return min(
        config.task.attempt_actions, int(np.asarray(episodes.rollout.felt.trace.action_world).shape[1])
    )


def summarise(trials: _Trials, actions: int, names: tuple[str, ...]) -> list[Row]:
    """Score each method over whole and partial attempts; intervals by bootstrap over holes.

    Groups: ``all``, ``matched``, ``mismatched``, a peg's shape, ``attempt:K``, ``actions:N`` and, for match
    classification by h_match, ``peg:hole``: the peg's matching hole against that mismatched hole.

    Args:
        trials: Rows as in ``mjx_fit.evaluation.trial_rows.CalibrationTrial``.
        actions: Number of actions in a whole attempt.
        names: Names of the shapes.
    """
    rows = []
    whole = [trial for trial in trials if trial["actions"] == actions]
    for name, group in _groups([trial for trial in whole if trial["method"] == "full"], names).items():
        rows += _error_rows("prior", name, group, "prior_error_cm")
    for method in dict.fromkeys(trial["method"] for trial in trials):
        own = [trial for trial in whole if trial["method"] == method]
        for name, group in _groups(own, names).items():
            rows += _position_rows(method, name, group)
            if method == "full":
                rows += _type_rows(method, name, group, names)
        for count in sorted({trial["actions"] for trial in trials}):
            part = [t for t in trials if t["method"] == method and t["actions"] == count]
            rows += _error_rows(method, f"actions:{count}", part)
            if method == "full":
                # Rows of many pairs would fill the file.
                rows += _match_rows(method, part, f"actions:{count}:", names if len(names) <= 4 else ())
        if method == "full":
            rows += _match_rows(method, own, "", names)
    return rows


def _groups(trials: _Trials, names: tuple[str, ...]) -> dict[str, _Trials]:
    groups = {"all": trials, "matched": [], "mismatched": []}
    groups |= {name: [] for name in names}
    groups |= {f"attempt:{k}": [] for k in sorted({trial["attempt"] for trial in trials})}
    for trial in trials:
        peg, hole = trial["pair"]
        for name in ("matched" if peg == hole else "mismatched", peg, f"attempt:{trial['attempt']}"):
            groups[name].append(trial)
    return {name: group for name, group in groups.items() if group}


def _position_rows(method: str, name: str, group: _Trials) -> list[Row]:
    squared = np.array([trial["squared_mahalanobis"] for trial in group])
    degrees = np.array([trial.get("degrees", 2) for trial in group])
    columns = {
        "position_error_cm": np.array([trial["error_cm"] for trial in group]),
        "position_nll": np.array([trial["nll"] for trial in group]),
        "nees": squared / degrees,
        "coverage_50": scores.inside(squared, 0.5, degrees),
        "coverage_90": scores.inside(squared, 0.9, degrees),
    }
    columns |= rotation_errors(group)
    return _means(method, name, group, columns)


def _type_rows(method: str, name: str, group: _Trials, names: tuple[str, ...]) -> list[Row]:
    types = np.array([trial["type_probability"] for trial in group])
    truth = np.array([names.index(trial["pair"][1]) for trial in group])
    match = np.array([trial["match_probability"] for trial in group])
    matched = np.array([trial["pair"][0] == trial["pair"][1] for trial in group])
    columns = {
        "type_brier": scores.brier(types, truth),
        "match_brier": scores.brier(np.stack([1 - match, match], 1), matched.astype(int)),
        "type_accuracy": types.argmax(1) == truth,
    }
    return _means(method, name, group, columns)


def _error_rows(method: str, name: str, group: _Trials, key: str = "error_cm") -> list[Row]:
    return _means(method, name, group, {"position_error_cm": np.array([trial[key] for trial in group])})


def _means(method: str, name: str, group: _Trials, columns: dict[str, np.ndarray]) -> list[Row]:
    """Return a row for each column, of the values that are not NaN; intervals by bootstrap over holes."""
    holes, rows = np.array([trial["trial"] for trial in group]), []
    for metric, values in columns.items():
        kept = np.isfinite(values)
        interval = bootstrap_mean(values[kept], holes[kept].tolist())
        rows.append(Row.of(method, metric, name, interval, int(kept.sum())))
    return rows


def _match_rows(method: str, group: _Trials, prefix: str, names: tuple[str, ...]) -> list[Row]:
    """Score the match classification of h_match, over all pegs and for each pair."""
    peg, hole = (np.array([trial["pair"][side] for trial in group]) for side in range(2))
    probability = np.array([trial["match_probability"] for trial in group])
    holes = np.array([trial["trial"] for trial in group])
    keep = {f"{prefix}all": np.ones(len(group), bool)}
    keep |= {
        f"{prefix}{a}:{b}": (peg == a) & ((hole == a) | (hole == b)) for a in names for b in names if a != b
    }
    rows = []
    for name, chosen in keep.items():
        positive, score = (peg == hole)[chosen], probability[chosen]
        if positive.all() or not positive.any():
            continue
        n, clusters = int(chosen.sum()), holes[chosen]
        for metric, measure in (
            ("match_auroc", scores.auroc),
            ("match_balanced_accuracy", lambda p, y: scores.balanced_accuracy(p > 0.5, y)),
        ):
            rows.append(Row.of(method, metric, name, bootstrap_score(measure, score, positive, clusters), n))
    return rows
