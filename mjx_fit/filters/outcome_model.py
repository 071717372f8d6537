"""Success probability α of the outcome model for each pair of peg and hole types.

The paper uses one number per shape, for holes that match the peg, and zero for mismatches: its pegs fit no
other hole. A peg that does, by geometry, counts as going in as often as into its own. The true success rate
depends on the error of the estimate: a spiral that starts 1 mm off hardly ever fails, one that starts
2 cm off always does. The second model averages the success rate by distance over the position belief.
"""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.config.schema import Config
from mjx_fit.filters.kalman import scale_tril
from mjx_fit.scene.fits import fitting
from mjx_fit.types import Array

RINGS, ANGLES = 24, 8
"""Quadrature points: radii at equal probability steps, angles over half a turn (by symmetry)."""


def success_probability(config: Config, pos_cov: Float[Array, "*batch 2 2"]) -> Float[Array, "*batch C C"]:
    """Compute α[c_peg, c] of an attempt from the mean of a belief, for each type of peg and hole.

    Model ``constant`` returns ``task.success_probability``. Model ``covariance`` returns, for matching types,
    ∫ s_c(|e|) N(e; 0, Σ) de, where s_c is ``task.success_by_error``, linear between its knots and constant
    beyond them. Positions not updated since the detector keep the constant, which was measured for the
    detector's non-Gaussian error. Mismatched pairs keep the constant in both models.

    Args:
        config: Configuration; ``task`` contains the model and its values, ``detector`` Σ0.
        pos_cov: Covariance Σ of the belief, m².
    """
    task, variance = config.task, config.detector.prior_std_m**2
    matrix = jnp.asarray(constant_matrix(config))
    constant = jnp.broadcast_to(matrix, (*pos_cov.shape[:-2], *matrix.shape))
    if task.outcome_model == "constant":
        return constant
    untouched = jnp.all(jnp.abs(pos_cov - variance * jnp.eye(2)) < 1e-3 * variance, axis=(-2, -1))
    offsets = jnp.einsum("...ij,kj->...ki", scale_tril(pos_cov), half_normal())
    distance = jnp.linalg.norm(offsets, axis=-1)
    knots = jnp.asarray(task.error_knots_m)
    by_error = task.success_by_error or ()
    rates = [jnp.interp(distance, knots, jnp.asarray(rate)).mean(-1) for rate in by_error]
    keeps = untouched[..., None, None] | ~jnp.eye(len(by_error), dtype=bool)
    return jnp.where(keeps, constant, jnp.stack(rates, axis=-1)[..., None, :])


def constant_matrix(config: Config) -> Float[np.ndarray, "C C"]:
    """Convert ``task.success_probability`` to a matrix α[c_peg, c].

    One number per shape holds for every hole that the peg fits.
    """
    alphas = np.asarray(config.task.success_probability, np.float32)
    return alphas if alphas.ndim == 2 else alphas[:, None] * fitting(config.scene)


def enters_others(config: Config) -> Bool[np.ndarray, "C"]:
    """Tell for each peg whether it may enter holes of other types."""
    alpha = constant_matrix(config)
    return np.asarray((alpha * ~np.eye(len(alpha), dtype=bool)).any(1))


def half_normal() -> Float[np.ndarray, "k 2"]:
    """Return points of equal weight that represent N(0, I) together with their negatives.

    P(r < R) = 1 - exp(-R² / 2). They suffice for the mean of a function with f(x) = f(-x).
    """
    share = (np.arange(RINGS) + 0.5) / RINGS
    radius = np.sqrt(-2 * np.log1p(-share))
    angle = math.pi * (np.arange(ANGLES) + 0.5) / ANGLES
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return (radius[:, None, None] * directions).reshape(-1, 2).astype(np.float32)
