"""Rows of an attempt for the filter that knows the parts' geometry (``mjx_fit.filters.contact_model``)."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxlie import SO3

from mjx_fit.config.schema import Config
from mjx_fit.sensors.force_torque import centre_of_pressure
from mjx_fit.sensors.pose import rotation_from_down
from mjx_fit.types import Reading, Rows
from mjx_fit.utils.rates import SUBSTEPS

SINCE = SUBSTEPS // 2
"""First sample of an action whose wrench counts: poses are those at its end."""


def with_world_poses(config: Config) -> Config:
    """Return a configuration whose readings have heights and rotations that are not relative to the start."""
    return replace(config, sensor=replace(config.sensor, pose="world"))


def rows_of(reading: Reading, config: Config) -> Rows:
    """Return the rows of a reading.

    Args:
        reading: Reading with any batch axes, whose poses are ``with_world_poses``.
        config: Defines the filter and the length of the peg.
    """
    wrench = reading.wrench_sensor[..., SINCE:, :].mean(-2)
    return Rows(
        tip=reading.tip_pos_estimate,
        turn=SO3.exp(rotation_from_down(reading.tip_quat_world)).as_matrix(),
        press=wrench[..., 2],
        pressure=centre_of_pressure(wrench, config.scene.peg_length_m),
        weight=config.particles.row_weight * reading.mask,
        noise=jnp.zeros_like(wrench[..., 2]),
        attempt=jnp.zeros(wrench.shape[:-1], jnp.int32),
    )


def every(rows: Rows, config: Config) -> Rows:
    """Return, of the rows of whole attempts (*n, L, ...), the first of every ``particles.every``."""
    first = config.particles.every - 1
    return jax.tree.map(lambda leaf: leaf[first :: config.particles.every], rows)


def no_rows(n: int) -> Rows:
    """Return n rows that do not count."""
    tip, turn, none = jnp.zeros((n, 3)), jnp.zeros((n, 3, 3)), jnp.zeros(n)
    return Rows(tip, turn, none, jnp.zeros((n, 2)), none, none, jnp.zeros(n, jnp.int32))
