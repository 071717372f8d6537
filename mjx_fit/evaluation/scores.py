"""Scores of beliefs against the truth: accuracy and calibration."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2, rankdata


def squared_mahalanobis(
    error: Float[np.ndarray, "n D"], cov: Float[np.ndarray, "n D D"]
) -> Float[np.ndarray, " n"]:
    """Compute (p - μ)ᵀ Σ⁻¹ (p - μ) of each row: chi-squared with D degrees of freedom if Σ is calibrated.

    Its mean over D is the normalised estimation error squared (NEES) per dimension, 1 if Σ is calibrated.
    """
    return np.einsum("ni,ni->n", error, np.linalg.solve(cov.astype(float), error[..., None])[..., 0])


def inside(
    squared: Float[np.ndarray, " n"], level: float, degrees: Int[np.ndarray, " n"] | int = 2
) -> Bool[np.ndarray, " n"]:
    """Return whether the truth is inside the ellipse of a level.

    With two degrees of freedom it is within 1.386 for 50 %, and 4.605 for 90 %.
    """
    return squared <= chi2.ppf(level, degrees)


def auroc(score: Float[np.ndarray, " n"], positive: Bool[np.ndarray, " n"]) -> float:
    """Compute the area under the ROC curve: P(a positive scores higher than a negative), Mann-Whitney.

    Equal scores count half; the result is NaN if a class is missing.
    """
    n_positive = int(positive.sum())
    n_negative = len(positive) - n_positive
    if not n_positive or not n_negative:
        return float("nan")
    rank_sum = rankdata(score)[positive].sum()
    return float((rank_sum - n_positive * (n_positive + 1) / 2) / (n_positive * n_negative))


def balanced_accuracy(predicted: Bool[np.ndarray, " n"], positive: Bool[np.ndarray, " n"]) -> float:
    """Compute the mean of true positive and true negative rate; NaN if a class is missing."""
    if positive.all() or not positive.any():
        return float("nan")
    return float((predicted[positive].mean() + (~predicted[~positive]).mean()) / 2)


def brier(probability: Float[np.ndarray, "n C"], truth: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Compute Σ_c (p_c - 1[c = truth])² of each row: 0 is certain and correct, 2 certain and wrong."""
    return np.square(probability - np.eye(probability.shape[1])[truth]).sum(1)


def reliability(
    probability: Float[np.ndarray, " n"], happened: Bool[np.ndarray, " n"], bins: int = 10
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, " b"], Int[np.ndarray, " b"]]:
    """Compute a reliability diagram: observed frequency per bin of predicted probability.

    Args:
        probability: Predicted probability, in [0, 1].
        happened: Whether the event occurred.
        bins: Number of equal bins over [0, 1].

    Returns:
        Mean prediction, observed frequency and count of each non-empty bin.
    """
    which = np.minimum((probability * bins).astype(int), bins - 1)
    n = np.bincount(which, minlength=bins)
    kept = n > 0
    mean = np.bincount(which, probability, bins)[kept] / n[kept]
    frequency = np.bincount(which, happened.astype(float), bins)[kept] / n[kept]
    return mean, frequency, n[kept]
