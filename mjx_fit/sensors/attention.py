"""Attention over the real rows of a trace, with a custom gradient.

The compiled derivative of the softmax takes longer than all matrix products together; with P stored in the
forward pass, the backward pass is four products and one pass over P.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.types import Array

_Head = Float[Array, "batch heads L d"]
MASKED = -1e9
"""Bias of masked scores: far below any score, yet finite for entirely masked traces."""


def attend(
    query: _Head, key: _Head, value: _Head, mask: Bool[Array, "batch L"], *, causal: bool = False
) -> Float[jax.Array, "batch heads L d"]:
    """Compute softmax(Q Kᵀ / √d) V of every head over the unmasked rows (Vaswani et al., 2017).

    Args:
        query: Queries Q.
        key: Keys K.
        value: Values V.
        mask: True for real rows. A trace without real rows attends to all rows equally.
        causal: If True, each row attends only to itself and to earlier rows.
    """
    length = query.shape[-2]
    bias = jnp.where(mask, 0.0, MASKED)[:, None, None, :]
    if causal:
        bias = bias + np.where(np.tri(length, dtype=bool), 0.0, MASKED)
    scaled = query / np.sqrt(query.shape[-1])
    return _attend(scaled, key, value, bias.astype(query.dtype))


@jax.custom_vjp
def _attend(query, key, value, bias):
    return _forward(query, key, value, bias)[0]


def _forward(query, key, value, bias):
    scores = jnp.einsum("bhld,bhmd->bhlm", query, key) + bias
    weights = jnp.exp(scores - scores.max(-1, keepdims=True))
    weights = weights / weights.sum(-1, keepdims=True)
    result = jnp.einsum("bhlm,bhmd->bhld", weights, value)
    return result, (query, key, value, weights, result)


def _backward(kept, grad):
    """Compute dS = P ∘ (dO Vᵀ - rowsum(dO ∘ O)), where the sum over d equals that of P ∘ dP over m.

    See Dao et al. (2022).
    """
    query, key, value, weights, result = kept
    of_value = jnp.einsum("bhlm,bhld->bhmd", weights, grad)
    of_weights = jnp.einsum("bhld,bhmd->bhlm", grad, value)
    of_scores = weights * (of_weights - (grad * result).sum(-1, keepdims=True))
    of_query = jnp.einsum("bhlm,bhmd->bhld", of_scores, key)
    of_key = jnp.einsum("bhlm,bhld->bhmd", of_scores, query)
    return of_query, of_key, of_value, None


_attend.defvjp(_forward, _backward)
