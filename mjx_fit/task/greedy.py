"""The high-level task as a POMDP (section "Problem Formulation" of the paper) and its greedy policy.

State of a hole: its type c, its position, and β, whether it is filled. An action is a hole; the reward of an
attempt is 1 when its peg goes in, which happens with probability α[c_peg, c]; in the paper never where the
types differ. The robot cannot tell an insertion into a hole of another type from a success. The same model T
gives the likelihood of a failure: ``mjx_fit.filters.histogram.failure_logp``.
"""

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from mjx_fit.filters.histogram import row_of_peg
from mjx_fit.types import Array

_TIE = 1e-6


def expected_reward(
    type_logp: Float[Array, "*batch n C"],
    peg_type: Int[Array, "*batch"],
    success_probability: Float[Array, "*#batch n C C"],
) -> Float[Array, "*batch n"]:
    """Probability that the peg goes in, of an attempt at each of n holes: Σ_c α[c_peg, c] ξ_c.

    Args:
        type_logp: ln ξ of each hole.
        peg_type: c_peg.
        success_probability: α of an attempt at each hole.
    """
    row = row_of_peg(peg_type[..., None], success_probability)
    return jnp.sum(row * jnp.exp(type_logp), -1)


def greedy(
    reward: Float[Array, "*batch n"], filled: Bool[Array, "*batch n"], tries: Int[Array, "*batch n"]
) -> Int[Array, "*batch"]:
    """The empty hole with the highest expected reward; among equals the least tried one, then the first.

    Args:
        reward: Expected reward of an attempt at each hole.
        filled: β of each hole.
        tries: Attempts made at each hole with the peg in hand.
    """
    open_reward = jnp.where(filled, -1.0, reward)
    best = open_reward >= open_reward.max(-1, keepdims=True) - _TIE
    return jnp.argmin(jnp.where(best, tries, jnp.iinfo(jnp.int32).max), -1)


def runner_up(
    reward: Float[Array, "*batch n"], filled: Bool[Array, "*batch n"], chosen: Int[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """The highest expected reward of the empty holes but for the chosen one; NaN where there is no other.

    Args:
        reward: Expected reward of an attempt at each hole.
        filled: β of each hole.
        chosen: As ``greedy`` gives it.
    """
    others = ~filled & (jnp.arange(reward.shape[-1]) != chosen[..., None])
    return jnp.nanmax(jnp.where(others, reward, jnp.nan), -1)
