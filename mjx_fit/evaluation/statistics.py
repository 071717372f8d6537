"""Intervals of what an experiment counted: Wilson for rates of independent trials, bootstrap for means."""

import dataclasses
import math
from collections.abc import Sequence
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
    """An estimate and its 95 % interval; ``low`` and ``high`` are NaN where the data cannot tell."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Row:
    """One line of a result's summary.

    Attributes:
        method: Which method was measured.
        metric: What was measured; the unit is in the name where there is one.
        group: Which part of the trials it was measured on.
        value: The estimate.
        low: Lower end of its 95 % interval, or None where one cluster alone cannot tell.
        high: Upper end.
        n: Number of things that were counted.
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
        """The row of an interval."""
        low, high = (None if math.isnan(end) else float(end) for end in (interval.low, interval.high))
        return Row(method, metric, group, float(interval.value), low, high, n)

    def to_json(self) -> dict[str, Any]:
        """The row as it stands in a result file."""
        return dataclasses.asdict(self)


def wilson(successes: int, n: int) -> Interval:
    """Rate of ``successes`` in ``n`` independent trials, n >= 1, with its Wilson interval."""
    ends = binomtest(successes, n).proportion_ci(LEVEL, method="wilson")
    return Interval(successes / n, float(ends.low), float(ends.high))


def bootstrap_mean(
    values: Float[np.ndarray, " n"] | Bool[np.ndarray, " n"], clusters: Sequence[int], seed: int = 0
) -> Interval:
    """Mean of ``values`` and the percentile interval of ``bootstrap_means``."""
    mean, low, high = bootstrap_means(np.asarray(values)[:, None], clusters, seed)
    return Interval(float(mean[0]), float(low[0]), float(high[0]))


def clustered_rate(happened: Bool[np.ndarray, " n"], clusters: Sequence[int]) -> Interval:
    """A share by bootstrap over clusters.

    Where all or none are in it a bootstrap knows no spread: then the interval is Wilson's for that many
    *clusters*, however what is in one depends on each other.
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
    """Column means with percentile intervals of a bootstrap that draws whole clusters.

    Observations of one cluster (the pegs of one trial) depend on each other; clusters do not. All columns see
    the same draws.

    Args:
        values: Observations, one row each.
        clusters: Which cluster each row belongs to.
        seed: Root of the draws.

    Returns:
        Mean, low and high; low and high are NaN when there is only one cluster.
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
    # Equal observations differ from their mean by rounding only.
    return mean, np.minimum(low, mean), np.maximum(high, mean)


def bootstrap_ratio(
    above: Float[np.ndarray, " n"], below: Float[np.ndarray, " n"], seed: int = 0
) -> Interval:
    """Ratio of the means of two methods on the same n trials, with the percentile interval of a bootstrap.

    Trials are drawn in pairs, so that what makes a trial hard for both does not widen the interval.

    Args:
        above: Of one method, trial by trial.
        below: Of the other, positive.
        seed: Root of the draws.
    """
    ratio = float(above.mean() / below.mean())
    if len(above) < 2:
        return Interval(ratio, math.nan, math.nan)
    times = _times_drawn(len(above), seed)
    low, high = np.quantile((times @ above) / (times @ below), _ENDS)
    return Interval(ratio, float(low), float(high))


def _times_drawn(n: int, seed: int) -> Int[np.ndarray, "resamples n"]:
    """How often each of n is drawn: all that a mean depends on, so that a product takes a gather's place."""
    return np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), RESAMPLES)


def sign_flip(
    differences: Float[np.ndarray, " n"], clusters: Sequence[int] | Int[np.ndarray, " n"], seed: int = 0
) -> float:
    """Two-sided p-value of paired differences under the hypothesis that they are symmetric around zero.

    Whole clusters change their sign. Of all sign patterns ``FLIPS`` are drawn, and the one that was seen
    counts as one of them (Phipson and Smyth, 2010), so that p is never zero.

    Args:
        differences: One method's value less the other's, pair by pair.
        clusters: Which cluster each pair belongs to.
        seed: Root of the draws.
    """
    _, index = np.unique(clusters, return_inverse=True)
    sums = np.bincount(index, weights=differences)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(FLIPS, len(sums)))
    as_far = np.abs(signs @ sums) >= np.abs(sums.sum()) * (1 - 1e-12)
    return float((as_far.sum() + 1) / (FLIPS + 1))


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's (1979) adjustment of m p-values: p_(i) (m - i + 1), made monotone, at most 1; order is kept."""
    order = np.argsort(p_values)
    scaled = np.asarray(p_values)[order] * np.arange(len(p_values), 0, -1)
    adjusted = np.empty(len(p_values))
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1)
    return adjusted.tolist()
