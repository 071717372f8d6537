"""The robot's plane of symmetry: what an attempt looks like in the world mirrored at y = 0.

Arm, pegs, holes and policies have no left and right, but for small asymmetries of the links' inertias, so the
mirror image of an interaction is one that could nearly have happened. Vectors change the sign of y; axial
vectors (torques, angular velocities) change that of x and z. There is no such plane across x: the arm stands
on one side of the table.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from mjx_fit.types import Array, Belief, Reading

_VECTOR = np.array([1.0, -1.0, 1.0])
_AXIAL = -_VECTOR
# The mirrored rotation is (w, -x, y, -z); its negative, the same one, stays near the tool's (0, 1, 0, 0).
_QUATERNION = np.array([-1.0, 1.0, -1.0, 1.0])


def mirror_reading(reading: Reading) -> Reading:
    """A reading of the mirrored attempt; the sensor's axes lie in the plane or across it."""
    return replace(
        reading,
        wrench_sensor=reading.wrench_sensor * np.concatenate([_VECTOR, _AXIAL]),
        pressure_tip=mirror_place(reading.pressure_tip),
        tip_pos_estimate=reading.tip_pos_estimate * _VECTOR,
        tip_quat_world=reading.tip_quat_world * _QUATERNION,
        tip_linvel_world=reading.tip_linvel_world * _VECTOR,
        tip_angvel_world=reading.tip_angvel_world * _AXIAL,
        action_world=reading.action_world * _VECTOR,
    )


def mirror_belief(belief: Belief) -> Belief:
    """The same belief about the mirrored hole."""
    sign = _VECTOR[:2]
    return replace(
        belief,
        pos_mean_world=mirror_place(belief.pos_mean_world),
        pos_cov=belief.pos_cov * sign[:, None] * sign,
    )


def mirror_place(place_world: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
    """A place on the table, m."""
    return place_world * _VECTOR[:2]
