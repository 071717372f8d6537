"""Histogram filter for the type of a hole: Algorithm 3 of the paper, in log space.

All functions are pure and accept any number of leading batch axes; C is the number of types.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from mjx_fit.types import Array

_LEAST_ALPHA = 1e-9


def update(
    type_logp: Float[Array, "*batch C"], likelihood_logp: Float[Array, "*batch C"]
) -> Float[Array, "*batch C"]:
    """Apply Bayes' rule: ln ξ'_c = ln ξ_c + ln L_c - ln Σ_c' ξ_c' L_c'.

    Args:
        type_logp: Prior log probabilities ln ξ.
        likelihood_logp: Log-likelihood ln L_c of all observations under type c; for Algorithm 3 the sum of
            ``match_logp`` (H) and ``failure_logp`` (T).
    """
    return jax.nn.log_softmax(type_logp + likelihood_logp, axis=-1)


def match_logp(
    match_logits: Float[Array, "*batch 2"], match_model_logp: Float[Array, "*batch C 2"], *, hard: bool
) -> Float[Array, "*batch C"]:
    """Compute the log of the observation model, H(o_match | c, c_peg), for the virtual sensor's output.

    Args:
        match_logits: Output of h_match: logits of (mismatch, match).
        match_model_logp: Log of the observation model ln H(o | c, c_peg), columns o.
        hard: Evaluate H at o = arg max h_match, as in Algorithm 3; otherwise use the differentiable
            expectation Σ_o p(o) H(o | c, c_peg).
    """
    if hard:
        o_match = jnp.argmax(match_logits, axis=-1)[..., None, None]
        o_match = jnp.broadcast_to(o_match, (*match_model_logp.shape[:-1], 1))
        return jnp.take_along_axis(match_model_logp, o_match, axis=-1)[..., 0]
    o_logp = jax.nn.log_softmax(match_logits, axis=-1)[..., None, :]
    return jax.nn.logsumexp(o_logp + match_model_logp, axis=-1)


def failure_logp(
    peg_type: Int[Array, "*batch"], success_probability: Float[Array, "*#batch C C"]
) -> Float[Array, "*batch C"]:
    """Compute the log of the outcome model for a failed attempt, T(β = 0 | c, c_peg) = 1 - α[c_peg, c].

    Args:
        peg_type: Type of the peg c_peg.
        success_probability: Probability α[c_peg, c] in [0, 1) of inserting a peg into a hole of type c.
    """
    return jnp.log1p(-row_of_peg(peg_type, success_probability))


def insertion_logp(
    peg_type: Int[Array, "*batch"], success_probability: Float[Array, "*#batch C C"]
) -> Float[Array, "*batch C"]:
    """Compute the log of the outcome model for an insertion, T(β = 1 | c, c_peg) = α[c_peg, c].

    A type that the peg cannot enter keeps a negligible probability, so that a wrong α leaves a posterior.
    """
    return jnp.log(jnp.maximum(row_of_peg(peg_type, success_probability), _LEAST_ALPHA))


def row_of_peg(
    peg_type: Int[Array, "*batch"], matrix: Float[Array, "*#batch C C"]
) -> Float[Array, "*batch C"]:
    """Select the row matrix[c_peg]; exact, since entries are only multiplied by 0 or 1 and added to 0."""
    chosen = jax.nn.one_hot(peg_type, matrix.shape[-1], dtype=matrix.dtype)
    return (chosen[..., None] * matrix).sum(-2)
