"""Intervals of an experiment's metrics: Wilson for rates of independent trials, bootstrap for means."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import binomtest

LEVEL = 0.95
FLIPS = 20_000
RESAMPLES = 2000
_ENDS = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)


class Interval(NamedTuple):
    """Estimate and its 95 % interval; ``low`` and ``high`` are NaN if the data do not determine them."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Row:
    """One line of a result's summary.

    Attributes:
        method: Name of the method.
        metric: Name of the metric, which includes the unit if there is one.
        group: Subset of the trials.
        value: Estimate.
        low: Lower end of its 95 % interval, or None for a single cluster.
        high: Upper end of its 95 % interval, or None.
        n: Number of observations.
    """

    method: str
    metric: str
    group: str
    value: float
    low: float | None
    high: float | None
    n: int

    @staticmethod
    def of(method: str, metric: str, group: str, interval: Interval, n: int) -> "Row":
        """Return the row of an interval."""
        low, high = (None if math.isnan(end) else float(end) for end in (interval.low, interval.high))
        return Row(method, metric, group, float(interval.value), low, high, n)

    def to_json(self) -> dict[str, Any]:
        """Return the row as stored in a result file."""
        return dataclasses.asdict(self)


def wilson(successes: int, n: int) -> Interval:
    """Compute the rate of ``successes`` in ``n`` >= 1 independent trials, with its Wilson interval."""
    ends = binomtest(successes, n).proportion_ci(LEVEL, method="wilson")
    return Interval(successes / n, float(ends.low), float(ends.high))


def bootstrap_mean(
    values: Float[np.ndarray, " n"] | Bool[np.ndarray, " n"], clusters: Sequence[int], seed: int = 0
) -> Interval:
    """Compute the mean of ``values`` and the percentile interval of ``bootstrap_means``."""
    mean, low, high = bootstrap_means(np.asarray(values)[:, None], clusters, seed)
    return Interval(float(mean[0]), float(low[0]), float(high[0]))


def bootstrap_median(
    values: Float[np.ndarray, " n"], clusters: Sequence[int] | Int[np.ndarray, " n"], seed: int = 0
) -> Interval:
    """Compute the median of ``values``, which may be infinite, and its percentile interval over clusters.

    The median is the lowest value with at least half of all observations at or below it.
    """
    names, index = np.unique(clusters, return_inverse=True)
    order = np.argsort(values, kind="stable")

    def median(times: Float[np.ndarray, "resamples clusters"]) -> Float[np.ndarray, " resamples"]:
        below = np.cumsum(times[:, index[order]], axis=1)
        return values[order][(2 * below >= below[:, -1:]).argmax(1)]

    value = float(median(np.ones((1, len(names))))[0])
    if len(names) < 2:
        return Interval(value, math.nan, math.nan)
    low, high = np.quantile(median(_times_drawn(len(names), seed)), _ENDS, method="nearest")
    return Interval(value, min(float(low), value), max(float(high), value))


def clustered_rate(happened: Bool[np.ndarray, " n"], clusters: Sequence[int]) -> Interval:
    """Compute a rate, with its interval by bootstrap over clusters.

    A rate of 0 or 1 has no spread under a bootstrap: its interval is Wilson's for that many *clusters*, which
    is valid under any dependence within a cluster.
    """
    if happened.all() or not happened.any():
        n = len(set(clusters))
        return wilson(n if happened.any() else 0, n)
    return bootstrap_mean(happened, clusters)


def bootstrap_means(
    values: Float[np.ndarray, "n k"] | Bool[np.ndarray, "n k"],
    clusters: Sequence[int] | Int[np.ndarray, " n"],
    seed: int = 0,
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Compute column means, with percentile intervals of a bootstrap over whole clusters.

    Observations of one cluster (the pegs of one trial) are dependent; clusters are independent. All columns
    share the same draws.

    Args:
        values: Observations, one per row.
        clusters: Cluster of each row.
        seed: Seed of the draws.

    Returns:
        Mean, low and high; low and high are NaN for a single cluster.
    """
    names, index = np.unique(clusters, return_inverse=True)
    sums = np.zeros((len(names), values.shape[1]))
    np.add.at(sums, index, values)
    sizes = np.bincount(index)
    mean = sums.sum(0) / sizes.sum()
    if len(names) < 2:
        return mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan)
    times = _times_drawn(len(names), seed)
    means = (times @ sums) / (times @ sizes)[:, None]
    low, high = np.quantile(means, _ENDS, axis=0)
    # Equal observations can differ from their mean by rounding.
    return mean, np.minimum(low, mean), np.maximum(high, mean)


def bootstrap_ratio(
    above: Float[np.ndarray, " n"], below: Float[np.ndarray, " n"], seed: int = 0
) -> Interval:
    """Compute the ratio of the means of two methods on the same n trials, with its bootstrap interval.

    Trials are drawn in pairs, so that difficulty shared by both methods does not widen the interval.

    Args:
        above: Values of one method, by trial.
        below: Values of the other method, positive.
        seed: Seed of the draws.
    """
    ratio = float(above.mean() / below.mean())
    if len(above) < 2:
        return Interval(ratio, math.nan, math.nan)
    times = _times_drawn(len(above), seed)
    low, high = np.quantile((times @ above) / (times @ below), _ENDS)
    return Interval(ratio, float(low), float(high))


def bootstrap_score(
    measure: Callable[[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]], float],
    score: Float[np.ndarray, " n"],
    positive: Bool[np.ndarray, " n"],
    clusters: Sequence[int] | Int[np.ndarray, " n"],
) -> Interval:
    """Compute a measure of a classification with its percentile interval by a bootstrap over clusters.

    Args:
        measure: Function of scores and classes, such as ``scores.auroc``; NaN where it is undefined.
        score: Score of each row.
        positive: Class of each row.
        clusters: Cluster of each row.
    """
    names, index = np.unique(clusters, return_inverse=True)
    members = np.split(np.argsort(index, kind="stable"), np.cumsum(np.bincount(index))[:-1])
    rng = np.random.default_rng(0)
    values = []
    for _ in range(RESAMPLES):
        drawn = np.concatenate([members[k] for k in rng.integers(len(names), size=len(names))])
        values.append(measure(score[drawn], positive[drawn]))
    low, high = np.nanquantile(values, _ENDS)
    return Interval(measure(score, positive), float(low), float(high))


def _times_drawn(n: int, seed: int) -> Int[np.ndarray, "resamples n"]:
    """Draw how often each of n is resampled: means then are matrix products instead of gathers."""
    return np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), RESAMPLES)


def sign_flip(
    differences: Float[np.ndarray, " n"], clusters: Sequence[int] | Int[np.ndarray, " n"], seed: int = 0
) -> float:
    """Compute the two-sided p-value of paired differences under the hypothesis of symmetry around zero.

    Whole clusters change sign. The test draws ``FLIPS`` of all sign patterns and counts the observed one
    among them (Phipson and Smyth, 2010), so that p is never zero.

    Args:
        differences: Difference between the methods, by pair.
        clusters: Cluster of each pair.
        seed: Seed of the draws.
    """
    _, index = np.unique(clusters, return_inverse=True)
    sums = np.bincount(index, weights=differences)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(FLIPS, len(sums)))
    as_far = np.abs(signs @ sums) >= np.abs(sums.sum()) * (1 - 1e-12)
    return float((as_far.sum() + 1) / (FLIPS + 1))


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust m p-values by Holm (1979): p_(i) (m - i + 1), monotone, at most 1, in input order."""
    order = np.argsort(p_values)
    scaled = np.asarray(p_values)[order] * np.arange(len(p_values), 0, -1)
    adjusted = np.empty(len(p_values))
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1)
    return adjusted.tolist()
