"""Pooling of the rows of a trace: maximum of the codes, and weighted means of places.

Both are sums in a semigroup, so a trace that grows is pooled row by row:

    max(a, b),   softmax means: (m, z, s) + (m', z', s') = (M, z e^(m - M) + z' e^(m' - M), s e^(m - M) + ...)

with M = max(m, m'), as in online softmax (Milakov and Gimelshein, 2018).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from mjx_fit.sensors.attention import MASKED
from mjx_fit.types import Array
from mjx_fit.utils.pytrees import pytree


@pytree
class Pooled:
    """Pooled rows.

    Attributes:
        best: Maximum of the codes.
        top: Largest score of each mean, m.
        mass: Sum of the weights of each mean, relative to the largest, z.
        sums: Weighted sums of the places, s.
    """

    best: Float[Array, "*batch width"]
    top: Float[Array, "*batch means"]
    mass: Float[Array, "*batch means"]
    sums: Float[Array, "*batch means 4"]


def of_rows(
    codes: Float[Array, "*batch width"],
    scores: Float[Array, "*batch means"],
    places: Float[Array, "*batch 4"],
    mask: Bool[Array, "*batch"],
) -> Pooled:
    """Return rows ready for pooling; masked ones count for nothing."""
    real = mask[..., None]
    weight = jnp.broadcast_to(real, scores.shape).astype(codes.dtype)
    return Pooled(
        best=jnp.where(real, codes, MASKED),
        top=jnp.where(real, scores, MASKED),
        mass=weight,
        sums=weight[..., None] * places[..., None, :],
    )


def join(a: Pooled, b: Pooled) -> Pooled:
    """Pool two parts of a trace."""
    top = jnp.maximum(a.top, b.top)
    of_a, of_b = jnp.exp(a.top - top), jnp.exp(b.top - top)
    return Pooled(
        best=jnp.maximum(a.best, b.best),
        top=top,
        mass=of_a * a.mass + of_b * b.mass,
        sums=of_a[..., None] * a.sums + of_b[..., None] * b.sums,
    )


def after_each_row(rows: Pooled) -> Pooled:
    """Pool the rows up to and including each; the time axis is the second to last of the codes."""
    return jax.lax.associative_scan(join, rows, axis=rows.best.ndim - 2)


def code_of(pooled: Pooled) -> Float[jax.Array, "*batch features"]:
    """Return the code of a trace; that of a trace without real rows is zero."""
    seen = pooled.best > MASKED / 2
    means = pooled.sums / jnp.maximum(pooled.mass, 1e-30)[..., None]
    flat = means.reshape(*means.shape[:-2], -1)
    return jnp.concatenate([jnp.where(seen, pooled.best, 0), flat], axis=-1)
