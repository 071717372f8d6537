"""Steps of tempered sequential Monte Carlo that do not depend on what the particles are.

References: Del Moral, Doucet and Jasra, Sequential Monte Carlo samplers, 2006; Cotter, Roberts, Stuart and
White, MCMC methods for functions, 2013; ter Braak, A Markov chain Monte Carlo version of the genetic
algorithm differential evolution, 2006.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.types import Array

_SIZES = (0.15, 0.4, 0.8, 1.2)
"""Sizes of differences, over the best one for a Gaussian."""
_JITTER = 1e-3
"""Standard deviation of what is added to differences, in units of the values."""
_NEW = (0.25, 0.5, 0.8, 1.0)
"""Shares of a proposal that are drawn anew: β of Crank and Nicolson."""
_BY_DIFFERENCES = 0.2
"""Share of the proposals that are differences."""
_LEAST_VARIANCE = 1e-5
"""Variance that is added to the particles', which may all be the same."""
_HALVINGS = 18


def largest_step(logp: Float[Array, "N"], most: Float[Array, ""], least_share: float) -> Float[Array, ""]:
    """Return the largest step of the exponent that leaves this effective share of the particles."""

    def leaves(step: Float[Array, ""]) -> Bool[Array, ""]:
        weight = jax.nn.softmax(step * logp)
        return 1 / (weight * weight).sum() > least_share * len(logp)

    def halve(ends, _):
        low, high = ends
        middle = (low + high) / 2
        enough = leaves(middle)
        return (jnp.where(enough, middle, low), jnp.where(enough, high, middle)), None

    (low, _), _ = jax.lax.scan(halve, (jnp.zeros_like(most), most), None, length=_HALVINGS)
    return jnp.where(leaves(most), most, jnp.maximum(low, most * 2.0**-_HALVINGS))


def resampled(weight: Float[Array, "N"], key: Key[Array, ""]) -> Int[Array, "N"]:
    """Return the indices of systematic resampling."""
    count = len(weight)
    at = (jax.random.uniform(key) + jnp.arange(count)) / count
    return jnp.minimum(jnp.searchsorted(jnp.cumsum(weight), at), count - 1)


class Reference(NamedTuple):
    """Gaussian that is like the particles.

    Attributes:
        mean: Mean.
        factor: Cholesky factor L of its covariance.
    """

    mean: Float[Array, "d"]
    factor: Float[Array, "d d"]


def reference_of(values: Float[Array, "N d"]) -> Reference:
    """Return the Gaussian with the mean and the covariance of particles."""
    mean = values.mean(0)
    away = values - mean
    cov = away.T @ away / len(values) + _LEAST_VARIANCE * jnp.eye(len(mean))
    return Reference(mean, jnp.linalg.cholesky(cov))


def proposed(
    values: Float[Array, "N d"], reference: Reference, key: Key[Array, ""]
) -> tuple[Float[Array, "N d"], Float[Array, "N"]]:
    """Propose new values: most by Crank and Nicolson, some by differential evolution.

    The first are v' = m + √(1 - β²) (v - m) + β L ξ, which a Gaussian N(m, L Lᵀ) takes with certainty, in any
    number of dimensions; the second are v' = v + γ (a - b) + ε, with a and b two other particles, which pass
    between modes.

    Returns:
        v', and log q(v) - log q(v'), the correction of Metropolis and Hastings: q is N(m, L Lᵀ) for the
        first, and constant for the second.
    """
    of_choice, of_noise, of_share, of_differences = jax.random.split(key, 4)
    count, away = len(values), values - reference.mean
    share = jnp.asarray(_NEW)[jax.random.randint(of_share, (count, 1), 0, len(_NEW))]
    drawn = jax.random.normal(of_noise, values.shape) @ reference.factor.T
    moved = jnp.sqrt(1 - share * share) * away + share * drawn
    ratio = _half_square(moved, reference) - _half_square(away, reference)
    differs = jax.random.bernoulli(of_choice, _BY_DIFFERENCES, (count,))
    other = values + differences(values, of_differences)
    return jnp.where(differs[:, None], other, reference.mean + moved), jnp.where(differs, 0.0, ratio)


def _half_square(away: Float[Array, "N d"], reference: Reference) -> Float[Array, "N"]:
    return 0.5 * jnp.square(solve_triangular(reference.factor, away.T, lower=True)).sum(0)


def differences(values: Float[Array, "N d"], key: Key[Array, ""]) -> Float[Array, "N d"]:
    """Return steps of differential evolution: γ (a - b) + ε, with a and b two other particles."""
    (count, d), keys = values.shape, jax.random.split(key, 4)
    one, other = (jax.random.permutation(k, count) for k in keys[:2])
    size = jnp.asarray(_SIZES)[jax.random.randint(keys[2], (count, 1), 0, len(_SIZES))]
    jitter = _JITTER * jax.random.normal(keys[3], values.shape)
    return size * 2.38 / np.sqrt(2 * d) * (values[one] - values[other]) + jitter
