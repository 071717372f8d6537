"""Simulated hole detector: a stand-in for vision-based estimates of hole positions."""

import jax
import jax.numpy as jnp
from jaxtyping import Float, Key

from mjx_fit.config.sections.world import DetectorConfig
from mjx_fit.types import Array


def detect(
    key: Key[Array, ""], hole_pos_world: Float[Array, "2"], config: DetectorConfig
) -> Float[Array, "2"]:
    """Draw a noisy estimate of a hole's position.

    Args:
        key: Random key of the error.
        hole_pos_world: True centre of the hole, m.
        config: Error distribution. ``square``: uniform on [-w, w]² (the paper's text); ``disc``: uniform
            direction, and length uniform on [0, w] (as the paper's figures suggest).

    Returns:
        Estimated centre of the hole, m.
    """
    if config.kind == "square":
        unit = jax.random.uniform(key, (2,), minval=-1.0)
    else:
        radius, angle = jax.random.uniform(key, (2,), maxval=jnp.array([1.0, 2 * jnp.pi]))
        unit = radius * jnp.array([jnp.cos(angle), jnp.sin(angle)])
    return hole_pos_world + config.half_width_m * unit
