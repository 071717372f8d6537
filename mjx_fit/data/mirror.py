"""Data augmentation by reflection in the robot's plane of symmetry, y = 0.

Arm, pegs, holes and policies are mirror-symmetric except for small asymmetries of the link inertias, so the
mirror image of an interaction is nearly a valid interaction. Reflection flips the sign of y in vectors and
the signs of x and z in axial vectors (torques, angular velocities). The x axis allows no such reflection: the
arm stands on one side of the table.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from mjx_fit.config.sections.filter import PLANAR
from mjx_fit.filters.chart import AXIS
from mjx_fit.types import Array, Belief, Reading

_VECTOR = np.array([1.0, -1.0, 1.0])
_AXIAL = -_VECTOR
# The mirrored rotation is (w, -x, y, -z). Its negative represents the same rotation and stays near the
# tool's (0, 1, 0, 0).
_QUATERNION = np.array([-1.0, 1.0, -1.0, 1.0])


def mirror_reading(reading: Reading) -> Reading:
    """Mirror a reading; each sensor axis lies in the plane of symmetry or is normal to it."""
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


def mirror_belief(belief: Belief, coordinates: Sequence[str] = PLANAR) -> Belief:
    """Mirror a belief about a hole."""
    sign = _signs(coordinates)
    return replace(
        belief,
        mean_world=mirror_place(belief.mean_world, coordinates),
        cov=belief.cov * sign[:, None] * sign,
    )


def mirror_place(
    place_world: Float[Array, "*batch D"], coordinates: Sequence[str] = PLANAR
) -> Float[Array, "*batch D"]:
    """Mirror a place, by default a position on the table, m and rad."""
    return place_world * _signs(coordinates)


def _signs(coordinates: Sequence[str]) -> Float[np.ndarray, "D"]:
    """Return the signs by which coordinates change: rotation vectors are axial."""
    vector = dict(zip("xyz", _VECTOR, strict=True))
    axial = {name: _AXIAL[axis] for name, axis in AXIS.items()}
    return np.array([(vector | axial)[name] for name in coordinates])
