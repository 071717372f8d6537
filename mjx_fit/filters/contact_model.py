"""Contact of a peg's lower end with a plate and its hole: how probable measured rows are for a pose.

A peg that presses has a gap of zero (``mjx_fit.filters.gaps``), up to the errors of measured poses; where it
is smallest, the plate bears it, and there is the centre of pressure. A peg that does not press has a gap
above zero. Forces of the hole's walls are not modelled: what they do to the centre of pressure is an outlier.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from mjx_fit.config.sections.particles import ParticlesConfig
from mjx_fit.filters.gaps import Bearing, PegPose, bearing_of
from mjx_fit.scene.surfaces import Surfaces
from mjx_fit.types import Array, Rows

_OUTLIER_GAP_M, _OUTLIER_SIDE_M = 0.001, 0.04
"""Scale of the gaps of outliers, and side of the square that their centres of pressure lie in."""
_OUTLIER_PRESSURE, _OUTLIER_FREE = 0.3, 0.05
"""Chance that the centre of pressure is not that of the plate, and that the peg hangs on something else."""
_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)
_Matrix = list[list[Array]]


class Pose(NamedTuple):
    """Poses (*n,) of the hole relative to the tool, and of the peg in the hand; the axes *n come last.

    Attributes:
        place: Where the tool has to be for the peg to be in the hole, relative to the estimate, m.
        place_turn: Its rotation there.
        grasp: Shift of the peg in the hand, in the axes of a tool that points straight down, m.
        grasp_turn: Rotation of the peg in the hand.
        height_error: Error of all measured heights, m: in this attempt, then in those that are remembered.
        noise: Factor of the spread of gaps in this attempt.
    """

    place: Float[Array, "3 *n"]
    place_turn: Float[Array, "3 3 *n"]
    grasp: Float[Array, "3 *n"]
    grasp_turn: Float[Array, "3 3 *n"]
    height_error: Float[Array, "A *n"]
    noise: Float[Array, "*n"]


def row_logp(
    pose: Pose, row: Rows, peg: Surfaces, hole: Surfaces, config: ParticlesConfig
) -> Float[Array, "*n"]:
    """Return the log probability of one row, up to a constant, times its weight.

    Args:
        pose: The poses.
        row: One row, or several: their axes come before those of the poses.
        peg: Surfaces of the peg's part.
        hole: Surfaces of the hole's part, or of one for each pose, on trailing axes (..., *n).
        config: Errors and outliers.
    """
    found = bearing_of(peg_pose(pose, row), peg, hole)
    gap, std = found.gap, config.gap_std_m * jnp.where(row.noise > 0, row.noise, pose.noise)
    touches = _mixed(
        -0.5 * (gap / std) ** 2 - jnp.log(std) - _HALF_LOG_2PI,
        -jnp.abs(gap) / _OUTLIER_GAP_M - jnp.log(2 * _OUTLIER_GAP_M),
        config.outlier_chance,
    )
    presses = _mixed(
        _pressure_logp(pose, row, found, config.pressure_std_m),
        -2 * jnp.log(_OUTLIER_SIDE_M),
        _OUTLIER_PRESSURE,
    )
    free = jnp.log(_OUTLIER_FREE + (1 - _OUTLIER_FREE) * jax.scipy.special.ndtr(gap / std))
    in_air = jnp.where(row.press < config.free_n, free, 0.0)
    return row.weight * jnp.where(row.press > config.touch_n, touches + presses, in_air)


def peg_pose(pose: Pose, row: Rows) -> PegPose:
    """Return the pose of the peg relative to the socket: the tool's times the grasp, seen from the socket."""
    # The socket is the place times the grasp: there the peg fits. Entry by entry: a CPU multiplies small
    # matrices one after the other.
    tool, grasp, place = map(_entries, (row.turn, pose.grasp_turn, pose.place_turn))
    shift, back = pose.grasp, _transposed(_times(place, grasp))
    away = [row.tip[i] - pose.place[i] + _along(tool[i], shift) - _along(place[i], shift) for i in range(3)]
    away[2] = away[2] + _error_of(row.attempt, pose.height_error)
    return PegPose([_along(axis, away) for axis in back], _times(back, _times(tool, grasp)))


def _error_of(attempt: Int[Array, "*#n"], errors: Float[Array, "A *n"]) -> Float[Array, "*n"]:
    """Return the height error of a row's attempt."""
    # A sum, not an index: a CPU gathers one number after the other.
    found = errors[0] * (attempt == 0)
    for k in range(1, len(errors)):
        found = found + errors[k] * (attempt == k)
    return found


def _pressure_logp(pose: Pose, row: Rows, found: Bearing, std_m: float) -> Float[Array, "*n"]:
    """Return the log density of the centre of pressure: that of the points, by how much each bears."""
    # Sums, not products of matrices: a CPU multiplies small ones one after the other.
    mean_u, mean_v = found.u / found.total, found.v / found.total
    a = jnp.maximum(found.uu / found.total - mean_u**2, 0) + std_m**2
    c = jnp.maximum(found.vv / found.total - mean_v**2, 0) + std_m**2
    b = found.uv / found.total - mean_u * mean_v
    (m, n, _), (o, p, _), _ = _entries(pose.grasp_turn)
    x = row.pressure[0] - pose.grasp[0] - m * mean_u - n * mean_v
    y = row.pressure[1] - pose.grasp[1] - o * mean_u - p * mean_v
    det = a * c - b * b
    return -0.5 * ((c * x * x - 2 * b * x * y + a * y * y) / det + jnp.log(det)) - 2 * _HALF_LOG_2PI


def _entries(matrix: Float[Array, "3 3 *n"]) -> _Matrix:
    return [[matrix[i, j] for j in range(3)] for i in range(3)]


def _transposed(matrix: _Matrix) -> _Matrix:
    return [list(column) for column in zip(*matrix, strict=True)]


def _times(left: _Matrix, right: _Matrix) -> _Matrix:
    return [[_along(row, column) for column in _transposed(right)] for row in left]


def _along(one: Sequence[Array], other: Sequence[Array] | Array) -> Array:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _mixed(logp: Array, outlier_logp: Array, outlier_chance: float) -> Float[Array, "*n"]:
    """Return the log density of a mixture with outliers."""
    return jnp.logaddexp(math.log1p(-outlier_chance) + logp, math.log(outlier_chance) + outlier_logp)
