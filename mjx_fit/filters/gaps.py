"""Gap between a peg's lower end and a plate with its hole, and the points of the peg that bear it.

With the plate's upper face as the plane z = 0, h(x, y) <= 0 the height of the socket there, and k(u) >= 0
that of the peg's lower end over its lower face, a peg whose face is the plane f can be lowered by the gap

    g = min over points (x, y) of f(x, y) + k(u(x, y)) - h(x, y).

Where f, h and k are planes, the least value is at an edge of one of them, or where edges of both cross, so
points along the edges and their crossings suffice.

A point below the plate is in the hole or inside of the plate's material, and there the way to the wall
counts: its distance in the hole, and the shorter one of both ways out of the material, as a negative gap.
So a peg in its hole has a gap of about zero, and one as deep beside the hole has a gap far below it.

Points are scanned, and poses lie side by side on trailing axes: a CPU works on many numbers at once only
where they are neighbours in memory, and XLA does not where it reduces over points.
"""

from collections.abc import Iterable, Sequence
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from mjx_fit.scene.sections import Section
from mjx_fit.scene.surfaces import Surfaces
from mjx_fit.types import Array

AWAY_M = 1.0
"""Gap of points with nothing above or below them."""
BEARS_M = 1e-4
"""Points whose gap is at most about this much above the smallest bear the peg: contact gives way a little."""
_Matrix = list[list[Array]]


class PegPose(NamedTuple):
    """Pose of the peg in the axes of the socket, entry by entry.

    Attributes:
        at: Position, m.
        turn: Rotation.
    """

    at: list[Array]
    turn: _Matrix


class Bearing(NamedTuple):
    """The smallest gap, and sums over all points, weighted by exp((smallest gap - gap) / ``BEARS_M``).

    Attributes:
        gap: Smallest gap, m.
        total: Sum of the weights.
        u, v: Sums of x and y in the axes of the peg, m.
        uu, uv, vv: Sums of their products, m².
    """

    gap: Float[Array, "*n"]
    total: Float[Array, "*n"]
    u: Float[Array, "*n"]
    v: Float[Array, "*n"]
    uu: Float[Array, "*n"]
    uv: Float[Array, "*n"]
    vv: Float[Array, "*n"]


class _Point(NamedTuple):
    """A point of an edge of the peg: x and y on it, its height over the plate, and its depth in the mouth."""

    u: Array
    v: Array
    z: Array
    depth: Array


def bearing_of(pose: PegPose, peg: Surfaces, hole: Surfaces) -> Bearing:
    """Return the gap between a peg and a socket, and where the peg is borne.

    Args:
        pose: Poses (*n,) of the peg.
        peg: Surfaces of the peg's part.
        hole: Surfaces of the hole's part, or of one for each pose, on trailing axes (..., *n).
    """
    none = jnp.zeros_like(pose.at[0] + hole.mouth.sides[0, 0, 0])
    begun = Bearing(none + AWAY_M, *[none] * 6)
    return _under_peg(_over_socket(begun, pose, peg, hole), pose, peg, hole)


def _over_socket(found: Bearing, pose: PegPose, peg: Surfaces, hole: Surfaces) -> Bearing:
    """Add the points of the peg, and those where its edges cross the rim of the mouth."""
    (a, b, c), (d, e, f), (p, q, r) = pose.turn

    def add(state: tuple[Bearing, _Point], point) -> tuple[tuple[Bearing, _Point], None]:
        found, last = state
        (u, v, w), joined = point
        x, y = pose.at[0] + a * u + b * v + c * w, pose.at[1] + d * u + e * v + f * w
        here = _Point(u, v, pose.at[2] + p * u + q * v + r * w, _depth(x, y, hole.mouth))
        over = _over(x, y, here, hole)
        return (_added(found, [(over, u, v), _crossing(last, here, joined)]), here), None

    zero = jnp.zeros(())
    nowhere = _Point(zero, zero, *[jnp.zeros_like(found.gap)] * 2)
    joined = jnp.roll(peg.peg_joins, 1)
    return jax.lax.scan(add, (found, nowhere), (peg.peg_points, joined))[0][0]


def _crossing(last: _Point, here: _Point, joined: Bool[Array, ""]) -> tuple[Array, Array, Array]:
    """Return gap, x and y of the point where an edge of the peg crosses the rim of the mouth."""
    # Both are straight between neighbouring points.
    crosses = joined & ((last.depth > 0) != (here.depth > 0))
    share = jnp.where(crosses, last.depth / jnp.where(crosses, last.depth - here.depth, 1.0), 0.0)
    u, v, z = (old + share * (new - old) for old, new in zip(last[:3], here[:3], strict=True))
    gap = jnp.maximum(z, jnp.minimum(last.depth, here.depth))
    return jnp.where(crosses, gap, AWAY_M), u, v


def _under_peg(found: Bearing, pose: PegPose, peg: Surfaces, hole: Surfaces) -> Bearing:
    """Add the points of the socket that are below the peg: its coordinates to first order in the tilt."""
    (a, b, _), (d, e, _), (p, q, _) = pose.turn
    scale = 1 / (a * e - b * d)

    def add(found: Bearing, point: Float[Array, "3 *n"]) -> tuple[Bearing, None]:
        dx, dy = point[0] - pose.at[0], point[1] - pose.at[1]
        u, v = (e * dx - b * dy) * scale, (a * dy - d * dx) * scale
        rise, outline = _peg_height(u, v, peg)
        gap = jnp.maximum(pose.at[2] + p * u + q * v + rise - point[2], -jnp.maximum(outline, 0))
        return _added(found, [(gap, u, v)]), None

    return jax.lax.scan(add, found, hole.hole_points)[0]


def _added(found: Bearing, points: Sequence[tuple[Array, Array, Array]]) -> Bearing:
    """Return the sums with points (gap, u, v), relative to the smallest gap so far."""
    least = reduce(jnp.minimum, [gap for gap, _, _ in points], found.gap)
    fades = jnp.exp((least - found.gap) / BEARS_M)
    sums = [one * fades for one in found[1:]]
    for gap, u, v in points:
        weight = jnp.exp((least - gap) / BEARS_M)
        at_u, at_v = weight * u, weight * v
        new = weight, at_u, at_v, at_u * u, at_u * v, at_v * v
        sums = [old + more for old, more in zip(sums, new, strict=True)]
    return Bearing(least, *sums)


def _over(x: Array, y: Array, point: _Point, hole: Surfaces) -> Array:
    """Return the gap of a point of the peg."""
    if hole.hole is None:
        inside, over = point.depth, point.z
    else:
        inside = _depth(x, y, hole.hole)
        over = point.z + jnp.clip(point.depth, 0, hole.hole_chamfer)
    in_hole = jnp.where(point.z < 0, inside, AWAY_M)
    return jnp.where(inside > 0, in_hole, jnp.maximum(over, inside))


def _peg_height(u: Array, v: Array, peg: Surfaces) -> tuple[Array, Array]:
    """Return the height of the peg's lower end over its lower face, far up beside it, and how far inside."""
    outline = _depth(u, v, peg.peg)
    on_face = outline if peg.face is None else _depth(u, v, peg.face)
    chamfer = jnp.clip(peg.peg_chamfer - outline, 0, peg.peg_chamfer)
    return jnp.where(on_face > 0, 0.0, jnp.where(outline > 0, chamfer, AWAY_M)), outline


def _depth(x: Array, y: Array, section: Section) -> Array:
    """Return how far inside a section points are, m; below zero outside (``mjx_fit.scene.sections``)."""
    nearest = [_least(side[2] - side[0] * x - side[1] * y for side in piece) for piece in section.sides]
    if section.discs is not None:
        from_arcs = [r - jnp.sqrt((x - a) ** 2 + (y - b) ** 2) for a, b, r in section.discs]
        nearest = map(jnp.minimum, nearest, from_arcs)
    return reduce(jnp.maximum, nearest)


def _least(values: Iterable[Array]) -> Array:
    return reduce(jnp.minimum, values)
