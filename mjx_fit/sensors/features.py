"""Inputs of a token of the sensor other than its wrench window, in SI units."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.sensors.pose import rotation_from_down
from mjx_fit.types import Array, Reading

ROW_FEATURES = 3 + 4 + 3 + 3 + 1 + 3
CONTACT_FEATURES = 6 + 6 + 2 + 2
MEASURABLE = np.array(
    [1e-4] * 3 + [2.5e-4] * 3 + [2e-3] * 3 + [2e-3] * 3 + [1e-2] * 3 + [0.1] + [1e-4] * CONTACT_FEATURES,
    np.float32,
)
"""What a robot can tell apart, for inputs with a rotation vector: command, position (0.25 mm), rotation
(0.1°), velocities, contact, and features of the wrench; smaller standard deviations are not scaled up."""


def row_features(reading: Reading, *, as_vector: bool = False) -> Float[Array, "*batch L features"]:
    """Concatenate the inputs of a token other than its wrench window, in SI units.

    Args:
        reading: Reading with any batch axes.
        as_vector: Represent the orientation by its rotation vector from straight down.
    """
    quat = reading.tip_quat_world
    return jnp.concatenate(
        [
            reading.action_world,
            reading.tip_pos_estimate,
            rotation_from_down(quat) if as_vector else quat,
            reading.tip_linvel_world,
            reading.tip_angvel_world,
            reading.contact[..., None],
        ],
        axis=-1,
    )


def contact_position(reading: Reading) -> Float[Array, "*batch L 2"]:
    """Compute the centre of pressure of each action relative to the estimate, m."""
    return reading.tip_pos_estimate[..., :2] + reading.pressure_tip


def contact_features(reading: Reading) -> Float[Array, "*batch L features"]:
    """Compute mean and standard deviation of each action's wrench, and the centre of pressure, in SI units.

    The network could compute these itself, but it learns quotients of its inputs last.
    """
    wrench = reading.wrench_sensor
    return jnp.concatenate(
        [wrench.mean(-2), wrench.std(-2), reading.pressure_tip, contact_position(reading)], axis=-1
    )
