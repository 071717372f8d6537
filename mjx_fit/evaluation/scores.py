"""How good, and how honest, a belief is: scores of what was predicted against what was true."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2, rankdata


def squared_mahalanobis(
    error: Float[np.ndarray, "n 2"], cov: Float[np.ndarray, "n 2 2"]
) -> Float[np.ndarray, " n"]:
    """(p - μ)ᵀ Σ⁻¹ (p - μ) of each row: chi-squared with two degrees of freedom where Σ is honest.

    Its mean over 2 is the normalised estimation error squared (NEES) per dimension, 1 where Σ is honest.
    """
    return np.einsum("ni,ni->n", error, np.linalg.solve(cov.astype(float), error[..., None])[..., 0])


def inside(squared: Float[np.ndarray, " n"], level: float) -> Bool[np.ndarray, " n"]:
    """Whether the truth lies in the ellipse of that probability: within 1.386 for 50 %, 4.605 for 90 %."""
    return squared <= chi2.ppf(level, 2)


def auroc(score: Float[np.ndarray, " n"], positive: Bool[np.ndarray, " n"]) -> float:
    """Area under the ROC curve: the chance that a positive scores higher than a negative (Mann-Whitney).

    Equal scores count half; NaN where one of the classes is missing.
    """
    n_positive = int(positive.sum())
    n_negative = len(positive) - n_positive
    if not n_positive or not n_negative:
        return float("nan")
    rank_sum = rankdata(score)[positive].sum()
    return float((rank_sum - n_positive * (n_positive + 1) / 2) / (n_positive * n_negative))


def balanced_accuracy(predicted: Bool[np.ndarray, " n"], positive: Bool[np.ndarray, " n"]) -> float:
    """Mean of the shares of positives and of negatives that are told right; NaN where one is missing."""
    if positive.all() or not positive.any():
        return float("nan")
    return float((predicted[positive].mean() + (~predicted[~positive]).mean()) / 2)


def brier(probability: Float[np.ndarray, "n C"], truth: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Σ_c (p_c - 1[c = truth])² of each row: 0 is certain and right, 2 certain and wrong."""
    return np.square(probability - np.eye(probability.shape[1])[truth]).sum(1)


def reliability(
    probability: Float[np.ndarray, " n"], happened: Bool[np.ndarray, " n"], bins: int = 10
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, " b"], Int[np.ndarray, " b"]]:
    """How often that happened which was given a probability, by the probability.

    Args:
        probability: Predicted, in [0, 1].
        happened: Whether it came so.
        bins: Equal parts of [0, 1].

    Returns:
        Of each bin that is not empty: the mean prediction, the observed frequency, and how many there were.
    """
    which = np.minimum((probability * bins).astype(int), bins - 1)
    n = np.bincount(which, minlength=bins)
    kept = n > 0
    mean = np.bincount(which, probability, bins)[kept] / n[kept]
    frequency = np.bincount(which, happened.astype(float), bins)[kept] / n[kept]
    return mean, frequency, n[kept]
