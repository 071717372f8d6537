"""Steps of tempered sequential Monte Carlo that do not depend on what the particles are.

Reference: Del Moral, Doucet and Jasra, Sequential Monte Carlo samplers, 2006.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.types import Array

_SIZES = (0.15, 0.4, 0.8, 1.2)
"""Sizes of moves, over the best one for a Gaussian."""
_JITTER = 1e-3
"""Standard deviation of what is added to moves, in units of the values."""
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


def differences(values: Float[Array, "N d"], key: Key[Array, ""]) -> Float[Array, "N d"]:
    """Return steps of differential evolution: γ (a - b) + ε, with a and b two other particles."""
    (count, d), keys = values.shape, jax.random.split(key, 4)
    one, other = (jax.random.permutation(k, count) for k in keys[:2])
    size = jnp.asarray(_SIZES)[jax.random.randint(keys[2], (count, 1), 0, len(_SIZES))]
    jitter = _JITTER * jax.random.normal(keys[3], values.shape)
    return size * 2.38 / np.sqrt(2 * d) * (values[one] - values[other]) + jitter
