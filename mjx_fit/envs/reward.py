"""Rewards of the environments. They may use the truth; observations do not."""

from typing import Literal

import jax.numpy as jnp
from jaxtyping import Bool, Float

from mjx_fit.config.schema import Config
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import Array

Reward = Literal["dense", "sparse"]
"""``sparse``: 1 for an insertion, else 0. ``dense``: as ``dense`` computes it."""
REWARDS: tuple[Reward, ...] = ("dense", "sparse")

INSERTED, BROKEN, PER_ACTION, PER_NEWTON, FREE_N, MOST_N = 5.0, -2.0, -0.03, -0.02, 15.0, 50.0
CM_PER_M = 100


def dense(
    gain: Float[Array, "*n"],
    largest_n: Float[Array, "*n"],
    inserted: Bool[Array, "*n"],
    valid: Bool[Array, "*n"],
) -> Float[Array, "*n"]:
    """Compute the dense reward of an action.

    It is what the action gains of ``worth``, less a little for time and for each newton of its largest force
    beyond ``FREE_N``, and 5 for an insertion. A simulation that diverges costs 2.

    Args:
        gain: Differences of ``worth``.
        largest_n: Largest force of the action, N.
        inserted: Whether the peg is in.
        valid: Whether the simulation still holds.
    """
    force = PER_NEWTON * jnp.clip(largest_n - FREE_N, 0, MOST_N)
    return jnp.where(valid, gain + PER_ACTION + force + INSERTED * inserted, BROKEN)


def worth(
    tip_pos_world: Float[Array, "*n 3"], hole_pos_world: Float[Array, "*n 2"], config: Config
) -> Float[Array, "*n"]:
    """Return the potential of places: centimetres to the hole, negative, and into it.

    Without discounting, differences of a potential do not change which policy is best (Ng, Harada and
    Russell, "Policy invariance under reward transformations", 1999).
    """
    away = jnp.linalg.norm(tip_pos_world[..., :2] - hole_pos_world, axis=-1)
    below = plate_top_m(config.scene) - tip_pos_world[..., 2]
    return CM_PER_M * (jnp.clip(below, 0, config.task.insertion_depth_m) - away)
