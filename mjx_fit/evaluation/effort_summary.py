"""Effort in result files: seconds and newtons of each trial, and their summary."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from mjx_fit.evaluation.result_file import rounded
from mjx_fit.evaluation.results import pegs_inserted_wrongly
from mjx_fit.evaluation.statistics import Row, bootstrap_mean, bootstrap_median, clustered_rate
from mjx_fit.task.effort import COLUMNS, Effort

BY_S = (5, 10, 30)
"""Seconds of search within which insertions are counted, s."""
SHORT_S = 0.1
"""Time above 20 N that does not count as pressing hard, s: an impact."""


def effort_columns(effort: Effort, trial: int, attempts: int) -> dict[str, list[float | None]]:
    """Return the columns of one trial's row: one number per attempt made, null if its simulation diverged.

    Args:
        effort: Effort of the trials, (T, K).
        trial: Index of the trial.
        attempts: Number of its attempts.
    """
    return {name: rounded(getattr(effort, name)[trial][:attempts]) for name in COLUMNS}


def summarise_effort(
    method: str, trials: Sequence[dict[str, Any]], group: str = "all", success: Sequence[bool] | None = None
) -> list[Row]:
    """Compute seconds and newtons of a method's trials, as far as the file has these columns.

    ``seconds`` is the mean time of all attempts of a trial, with the group ``median`` its median, where a
    trial without success counts as longer than any other; the median is omitted if it is such a trial.
    ``move_seconds`` is the mean time of the moves. ``in_by_5s`` and so on are the shares of trials with
    success within that time of attempts. ``peak_force_n`` is the mean of the largest force of a trial, with
    the group ``median`` its median, ``mean_force_n`` the mean of the force over a trial's contact,
    ``impulse_ns`` the mean impulse of a trial, and ``over_20n_share`` the share of trials with more than
    0.1 s above 20 N. Numbers of diverged simulations are unknown and count as zero force.

    Args:
        method: Name of the method.
        trials: Its rows of the result file.
        group: Group of the rows; ``GROUP median`` for medians if it is not ``all``.
        success: Whether each trial succeeded; None: success is not defined, and its shares are omitted.
    """
    if not trials or not all("peak_force_n" in trial for trial in trials):
        return []
    draws, n = [trial["trial"] for trial in trials], len(trials)
    median, peak = f"{group} median".removeprefix("all "), largest_forces(trials)
    rows = [
        Row.of(method, "peak_force_n", group, bootstrap_mean(peak, draws), n),
        Row.of(method, "peak_force_n", median, bootstrap_median(peak, draws), n),
    ]
    names = (*COLUMNS, "move_seconds")
    if not all(name in trial for trial in trials for name in names):
        return rows
    total = {name: totals(trials, name) for name in names}
    means = {name: total[name] for name in ("seconds", "move_seconds", "impulse_ns")}
    means["mean_force_n"] = total["impulse_ns"] / np.maximum(total["contact_s"], 1e-9)
    rows += [Row.of(method, name, group, bootstrap_mean(own, draws), n) for name, own in means.items()]
    hard = total["over_20n_s"] > SHORT_S
    rows.append(Row.of(method, "over_20n_share", group, clustered_rate(hard, draws), n))
    if success is not None:
        needed = np.where(success, total["seconds"], np.inf)
        rows += shares_in_time(method, needed, draws, group)
        rows += _median_seconds(method, needed, draws, median)
    return rows


def _median_seconds(
    method: str, needed_s: Float[np.ndarray, " n"], draws: Sequence[int], group: str
) -> list[Row]:
    """Return the median of seconds until the success; no row if it, or its upper end, is no success."""
    middle = bootstrap_median(needed_s, draws)
    known = np.isfinite(middle.value) and not np.isinf(middle.high)
    return [Row.of(method, "seconds", group, middle, len(draws))] if known else []


def shares_in_time(
    method: str, needed_s: Float[np.ndarray, " n"], draws: Sequence[int], group: str
) -> list[Row]:
    """Return the shares that succeeded within each of ``BY_S``.

    Args:
        method: Name of the method.
        needed_s: Seconds until the success, infinite without.
        draws: Cluster of each.
        group: Group of the rows.
    """
    return [
        Row.of(method, f"in_by_{limit}s", group, clustered_rate(needed_s <= limit + 1e-6, draws), len(draws))
        for limit in BY_S
    ]


def largest_forces(trials: Sequence[dict[str, Any]]) -> Float[np.ndarray, " n"]:
    """Return the largest force of each trial, N; null counts as zero."""
    return np.array([max(_numbers(trial["peak_force_n"]), default=0.0) for trial in trials], float)


def seconds_of_pegs(trials: Sequence[dict[str, Any]]) -> Float[np.ndarray, " pegs"]:
    """Return the seconds until each peg of assemblies is in, trial by trial; infinite without success.

    A peg that a human inserted is not in, nor is one in a hole of another type.
    """
    seconds = np.array([sum(peg) for trial in trials for peg in trial["seconds"]])
    helped = np.array([human for trial in trials for human in trial["human"]])
    return np.where(helped | pegs_inserted_wrongly([*trials]).ravel(), np.inf, seconds)


def totals(trials: Sequence[dict[str, Any]], column: str) -> Float[np.ndarray, " n"]:
    """Sum a column over the attempts of each trial; null counts as zero."""
    return np.array([sum(_numbers(trial[column])) for trial in trials], float)


def _numbers(values: Any) -> Iterator[float]:
    """Iterate over the numbers of one trial: one per attempt, or one list per peg; null is skipped."""
    for value in values if isinstance(values, list) else [values]:
        if isinstance(value, list):
            yield from _numbers(value)
        elif value is not None:
            yield value
