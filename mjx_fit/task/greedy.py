"""The high-level task as a POMDP (section "Problem Formulation" of the paper) and its greedy policy.

The state of a hole is its type c, its position, and β, whether it is filled. An action selects a hole. The
reward of an attempt is 1 if the peg is inserted into a hole of its own type, which has probability
α[c_peg, c_peg] there. In the paper no peg enters another hole; where one does, it earns nothing.
The same model T gives the likelihood of a failure: ``mjx_fit.filters.histogram.failure_logp``.
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
    """Compute the success probability of an attempt at each of n holes: α[c_peg, c_peg] ξ[c_peg].

    Args:
        type_logp: Log type probabilities ln ξ of each hole.
        peg_type: Type of the peg in hand, c_peg.
        success_probability: Outcome model α of an attempt at each hole.
    """
    row = row_of_peg(peg_type[..., None], success_probability)
    own = jnp.arange(type_logp.shape[-1]) == peg_type[..., None, None]
    return jnp.sum(jnp.where(own, row * jnp.exp(type_logp), 0.0), -1)


def greedy(
    reward: Float[Array, "*batch n"], filled: Bool[Array, "*batch n"], tries: Int[Array, "*batch n"]
) -> Int[Array, "*batch"]:
    """Select the empty hole with the highest expected reward; ties: the least tried, then the first.

    Args:
        reward: Expected reward of an attempt at each hole.
        filled: Whether each hole is filled, β.
        tries: Number of attempts at each hole with the peg in hand.
    """
    open_reward = jnp.where(filled, -1.0, reward)
    best = open_reward >= open_reward.max(-1, keepdims=True) - _TIE
    return jnp.argmin(jnp.where(best, tries, jnp.iinfo(jnp.int32).max), -1)


def runner_up(
    reward: Float[Array, "*batch n"], filled: Bool[Array, "*batch n"], chosen: Int[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """Compute the highest expected reward among the other empty holes; NaN if the chosen one is the last.

    Args:
        reward: Expected reward of an attempt at each hole.
        filled: Whether each hole is filled, β.
        chosen: The hole that ``greedy`` selected.
    """
    others = ~filled & (jnp.arange(reward.shape[-1]) != chosen[..., None])
    return jnp.nanmax(jnp.where(others, reward, jnp.nan), -1)
