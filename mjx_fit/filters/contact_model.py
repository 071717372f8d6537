"""Contact of a peg's lower end with a plate and its hole: how probable measured rows are for a pose.

With the plate's upper face as the plane z = 0, h(x, y) <= 0 the height of the socket there, and k(u) >= 0
that of the peg's lower end over its lower face, a peg whose face is the plane f can be lowered by the gap

    g = min over points (x, y) of f(x, y) + k(u(x, y)) - h(x, y).

Where f, h and k are planes, the least value is at an edge of one of them, or where edges of both cross, so
points along the edges and their crossings suffice.
A peg that presses has a gap of zero, up to the errors of measured poses; where it is smallest, the plate
bears it, and there is the centre of pressure. A peg that does not press has a gap above zero. Walls of the
hole are not modelled: rows that they explain are outliers.
"""

import math
from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.config.sections.particles import ParticlesConfig
from mjx_fit.scene.surfaces import Surfaces
from mjx_fit.types import Array, pytree

_AWAY_M = 1.0
"""Gap of points with nothing above or below them."""
_BEARS_M = 1e-4
"""Points whose gap is at most about this much above the smallest bear the peg: contact gives way a little."""
_OUTLIER_GAP_M, _OUTLIER_SIDE_M = 0.001, 0.04
"""Scale of the gaps of outliers, and side of the square that their centres of pressure lie in."""
_OUTLIER_PRESSURE, _OUTLIER_FREE = 0.3, 0.05
"""Chance that the centre of pressure is not that of the plate, and that the peg hangs on something else."""
_FAR_DOWN_M = 0.1
_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)
_Matrix = list[list[Array]]
_Points = tuple[Float[Array, "n"], Float[Array, "n"]]


@pytree
class Rows:
    """What an attempt tells about contact, action by action, in the frame of its estimate.

    Attributes:
        tip: Position of the TCP relative to the estimate, on the plate's upper face, m.
        turn: Rotation of the TCP from straight down.
        press: Force on the peg upwards, N.
        pressure: Centre of pressure on the peg's lower face relative to the TCP, x and y, m.
        weight: Exponent of the row's likelihood; 0: it is not read.
    """

    tip: Float[Array, "*L 3"]
    turn: Float[Array, "*L 3 3"]
    press: Float[Array, "*L"]
    pressure: Float[Array, "*L 2"]
    weight: Float[Array, "*L"]


class Pose(NamedTuple):
    """Pose of the hole relative to the tool, and of the peg in the hand.

    Attributes:
        place: Where the tool has to be for the peg to be in the hole, relative to the estimate, m.
        place_turn: Its rotation there.
        grasp: Shift of the peg in the hand, in the axes of a tool that points straight down, m.
        grasp_turn: Rotation of the peg in the hand.
        height_error: Error of all measured heights, m.
        noise: Factor of the spread of gaps in this attempt.
    """

    place: Float[Array, "3"]
    place_turn: Float[Array, "3 3"]
    grasp: Float[Array, "3"]
    grasp_turn: Float[Array, "3 3"]
    height_error: Float[Array, ""]
    noise: Float[Array, ""]


def row_logp(
    pose: Pose, row: Rows, peg: Surfaces, hole: Surfaces, config: ParticlesConfig
) -> Float[Array, ""]:
    """Return the log probability of one row, up to a constant, times its weight.

    Args:
        pose: The pose.
        row: One row.
        peg: Surfaces of the peg's part.
        hole: Surfaces of the hole's part.
        config: Errors and outliers.
    """
    gaps, points = gaps_of(pose, row, peg, hole)
    gap, std = gaps.min(), config.gap_std_m * pose.noise
    touches = _mixed(
        -0.5 * (gap / std) ** 2 - jnp.log(std) - _HALF_LOG_2PI,
        -jnp.abs(gap) / _OUTLIER_GAP_M - jnp.log(2 * _OUTLIER_GAP_M),
        config.outlier_chance,
    )
    presses = _mixed(
        _pressure_logp(pose, row, jax.nn.softmax((gap - gaps) / _BEARS_M), points, config.pressure_std_m),
        -2 * jnp.log(_OUTLIER_SIDE_M),
        _OUTLIER_PRESSURE,
    )
    free = jnp.log(_OUTLIER_FREE + (1 - _OUTLIER_FREE) * jax.scipy.special.ndtr(gap / std))
    in_air = jnp.where(row.press < config.free_n, free, 0.0)
    return row.weight * jnp.where(row.press > config.touch_n, touches + presses, in_air)


def _pressure_logp(
    pose: Pose, row: Rows, bears: Float[Array, "n"], points: _Points, std_m: float
) -> Float[Array, ""]:
    """Return the log density of the centre of pressure: that of the points, by how much each bears."""
    # Sums, not products of matrices: a CPU multiplies small ones one after the other.
    u, v = points
    mean_u, mean_v = (bears * u).sum(), (bears * v).sum()
    a = jnp.maximum((bears * u * u).sum() - mean_u**2, 0) + std_m**2
    c = jnp.maximum((bears * v * v).sum() - mean_v**2, 0) + std_m**2
    b = (bears * u * v).sum() - mean_u * mean_v
    (m, n, _), (o, p, _), _ = _entries(pose.grasp_turn)
    x = row.pressure[0] - pose.grasp[0] - m * mean_u - n * mean_v
    y = row.pressure[1] - pose.grasp[1] - o * mean_u - p * mean_v
    det = a * c - b * b
    return -0.5 * ((c * x * x - 2 * b * x * y + a * y * y) / det + jnp.log(det)) - 2 * _HALF_LOG_2PI


def gaps_of(pose: Pose, row: Rows, peg: Surfaces, hole: Surfaces) -> tuple[Float[Array, "n"], _Points]:
    """Return the gaps at points along all edges, m, and x and y of the points in the axes of the peg, m."""
    # Peg relative to socket: the tool's pose times the grasp, seen from the place times the grasp. Entry by
    # entry: a CPU multiplies small matrices one after the other.
    tool, grasp, place = map(_entries, (row.turn, pose.grasp_turn, pose.place_turn))
    shift = pose.grasp
    of_peg, back = _times(tool, grasp), _transposed(_times(place, grasp))
    away = [row.tip[i] - pose.place[i] + _along(tool[i], shift) - _along(place[i], shift) for i in range(3)]
    away[2] = away[2] + pose.height_error
    at = [_along(axis, away) for axis in back]
    (a, b, c), (d, e, f), (p, q, r) = _times(back, of_peg)
    on_peg = peg.peg_points
    u, v, w = on_peg[:, 0], on_peg[:, 1], on_peg[:, 2]
    x, y, z = (at[i] + k * u + m * v + n * w for i, (k, m, n) in enumerate(((a, b, c), (d, e, f), (p, q, r))))
    depth = _depth(x, y, hole.mouth_sides)
    over_socket = z - _socket_height(x, y, depth, hole)
    # Where the peg's edge crosses that of the mouth: both are straight between neighbouring points.
    nearer, further = depth, jnp.roll(depth, -1)
    crosses = peg.peg_joins & ((nearer > 0) != (further > 0))
    share = jnp.where(crosses, nearer / jnp.where(crosses, nearer - further, 1.0), 0.0)
    crossing = jnp.where(crosses, z + share * (jnp.roll(z, -1) - z), _AWAY_M)
    crossing_u, crossing_v = (one + share * (jnp.roll(one, -1) - one) for one in (u, v))
    # Points of the socket, below the peg's face: its coordinates (u, v), to first order in the tilt.
    on_hole = hole.hole_points
    dx, dy, det = on_hole[:, 0] - at[0], on_hole[:, 1] - at[1], a * e - b * d
    s, t = (e * dx - b * dy) / det, (a * dy - d * dx) / det
    under_peg = at[2] + p * s + q * t + _peg_height(s, t, peg) - on_hole[:, 2]
    at_u, at_v = jnp.concatenate([u, crossing_u, s]), jnp.concatenate([v, crossing_v, t])
    return jnp.concatenate([over_socket, crossing, under_peg]), (at_u, at_v)


def _socket_height(
    x: Float[Array, "n"], y: Float[Array, "n"], mouth: Float[Array, "n"], hole: Surfaces
) -> Float[Array, "n"]:
    """Return the height of the socket's surface, m, given how far inside its mouth: far down in the hole."""
    if hole.hole_sides is None:
        return jnp.where(mouth > 0, -_FAR_DOWN_M, 0.0)
    inside = _depth(x, y, hole.hole_sides) > 0
    return jnp.where(inside, -_FAR_DOWN_M, -jnp.clip(mouth, 0, hole.hole_chamfer))


def _peg_height(u: Float[Array, "n"], v: Float[Array, "n"], peg: Surfaces) -> Float[Array, "n"]:
    """Return the height of the peg's lower end over its lower face, m: far up beside it."""
    outline = _depth(u, v, peg.peg_sides)
    on_face = outline if peg.face_sides is None else _depth(u, v, peg.face_sides)
    chamfer = jnp.clip(peg.peg_chamfer - outline, 0, peg.peg_chamfer)
    return jnp.where(on_face > 0, 0.0, jnp.where(outline > 0, chamfer, _AWAY_M))


def _depth(x: Float[Array, "n"], y: Float[Array, "n"], sides: Float[Array, "k s 3"]) -> Float[Array, "n"]:
    """Return how far inside a section points are, m; below zero outside (``mjx_fit.scene.surfaces``)."""
    # Term by term: XLA reduces a short axis one number at a time on a CPU.
    nearest = [reduce(jnp.minimum, [d - m * x - n * y for m, n, d in piece]) for piece in sides]
    return reduce(jnp.maximum, nearest)


def _entries(matrix: Float[Array, "3 3"]) -> _Matrix:
    return [[matrix[i, j] for j in range(3)] for i in range(3)]


def _transposed(matrix: _Matrix) -> _Matrix:
    return [list(column) for column in zip(*matrix, strict=True)]


def _times(left: _Matrix, right: _Matrix) -> _Matrix:
    return [[_along(row, column) for column in _transposed(right)] for row in left]


def _along(one: Sequence[Array], other: Sequence[Array] | Array) -> Array:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _mixed(logp: Array, outlier_logp: Array, outlier_chance: float) -> Float[Array, ""]:
    """Return the log density of a mixture with outliers."""
    return jnp.logaddexp(math.log1p(-outlier_chance) + logp, math.log(outlier_chance) + outlier_logp)
