"""Policy ``tilt``: the search of ``mjx_fit.control.search`` with a peg that leans, to find an edge.

The peg leans in the direction of its motion u, by the rotation vector φ (z × u), so that its leading edge is
the lowest. Over the hole that edge drops first. The peg is then set upright, and searches where it is.
"""

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.config.sections.seek import SeekConfig
from mjx_fit.control import search
from mjx_fit.control.policies import Policy, PolicyInput
from mjx_fit.control.search import Search
from mjx_fit.types import Array, pytree

_NEW = 0.3
"""Share of the latest motion in its smoothed direction: the peg turns no faster than its path."""
_STILL_M = 1e-4


@pytree
class Leaning:
    """State of the policy.

    Attributes:
        search: The search.
        along_world: Smoothed direction of motion, at most 1 long.
    """

    search: Search
    along_world: Float[Array, "2"]


def lean_search(config: SeekConfig) -> Policy:
    """Create the policy."""

    def act(state: Leaning, seen: PolicyInput) -> tuple[Leaning, Float[Array, "6"]]:
        now, command = search.step(state.search, seen, config)
        moved = now.goal_world - state.search.goal_world
        way = jnp.linalg.norm(moved)
        latest = jnp.where(way > _STILL_M, moved / jnp.maximum(way, _STILL_M), state.along_world)
        along = state.along_world + _NEW * (latest - state.along_world)
        leans = config.lean_rad * (now.touched & ~now.dropped)
        turn = leans * jnp.array([-along[1], along[0], 0.0])
        return replace(state, search=now, along_world=along), jnp.concatenate([command, turn])

    return Policy(
        lambda start, key: Leaning(search.begin(start.estimate_world), jnp.zeros(2)), act, "tilt", turns=True
    )
