"""Outlines of pegs and holes, and the place of points in relation to them, for all worlds at once.

The worlds, ``b``, are the last axis of all arrays: see ``mjx_fit.utils.linalg``. Loops over the sides of an
outline are scans, so that the size of the program does not depend on their number.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from mjx_fit.types import Array
from mjx_fit.utils.linalg import total

TINY = 1e-12
UNROLLED = 4
"""Sides that one turn of a loop handles."""
_FAR_M2 = 1e6
"""Added to the squared distance of spare sides, so that they are never the nearest."""
_SLANT = 0.4
"""Sine of the angle by which a side may lead on into a wall while its corner touches the wall: facets do."""
_FLAT = 0.7
"""Sine of the turn of a wall that counts as straight: that of a round hole's facets."""


class Outline(NamedTuple):
    """Sides of polygons: outer ones counter-clockwise, holes clockwise.

    A spare side without length, at its first corner, follows each ring, so that the start of the next side is
    the end of a side.

    Attributes:
        start: Start of each side, m.
        end: End of each side, m.
        before: Start of the side that ends where this one starts, m.
        after: End of the side that starts where this one ends, m.
    """

    start: Float[Array, "2 n b"]
    end: Float[Array, "2 n b"]
    before: Float[Array, "2 n b"]
    after: Float[Array, "2 n b"]


class Boundary(NamedTuple):
    """Points in relation to an outline.

    Attributes:
        inside: Whether a point is inside.
        distance: Distance from the boundary, m.
        outward: Unit vector out of the outline at the nearest point of the boundary.
        mitred: Distance from the nearest side; at a corner from the line of the further one of its two sides,
            so that lines of equal distance have corners, too, m.
        across: Unit vector out of the outline, across that side.
    """

    inside: Bool[Array, "m b"]
    distance: Float[Array, "m b"]
    outward: Float[Array, "2 m b"]
    mitred: Float[Array, "m b"]
    across: Float[Array, "2 m b"]


def boundary(outline: Outline, point: Float[Array, "2 m b"]) -> Boundary:
    """Relate points to an outline, by the nearest of its sides.

    A point is inside if it lies behind that side; at a corner, behind the sum of the normals of its two sides
    (Baerentzen and Aanaes, Signed distance computation using the angle weighted pseudonormal, 2005).
    """
    sides = jnp.concatenate(outline)
    nearest = jnp.take_along_axis(
        sides, _nearest_side(outline, point)[None], axis=1, mode="promise_in_bounds"
    )
    start, end, before, after = nearest.reshape(4, 2, *point.shape[1:])
    side = end - start
    t = total((point - start) * side) / jnp.maximum(total(side**2), TINY)
    at_start, at_corner = t <= 0, (t <= 0) | (t >= 1)
    away = point - (start + jnp.clip(t, 0, 1) * side)
    distance = jnp.sqrt(total(away**2))
    own = _normal(side)
    other = jnp.where(at_corner, _normal(jnp.where(at_start, start - before, after - end)), own)
    inside = total(away * (own + other)) < 0
    lines = tuple(abs(total(away * normal)) for normal in (own, other))
    # The way to a corner leads out from the inside, and in from the outside.
    from_corner = away * jnp.where(inside, -1.0, 1.0) / jnp.maximum(distance, TINY)
    return Boundary(
        inside,
        distance,
        outward=jnp.where(at_corner & (distance > TINY), from_corner, own),
        mitred=jnp.where(at_corner, jnp.maximum(*lines), distance),
        across=jnp.where(lines[1] > lines[0], other, own),
    )


def _nearest_side(outline: Outline, point: Float[Array, "2 m b"]) -> Int[Array, "m b"]:
    """Find the side at the smallest distance, to within a few parts in 10,000.

    One number per point is kept, as XLA would compute the distances anew for each further one.
    """
    step = outline.end - outline.start
    length_2 = total(step**2)
    per_length = step / jnp.maximum(length_2, TINY)
    spare = jnp.where(length_2 > 0, 0.0, _FAR_M2)
    n = len(length_2)
    room = (1 << (n - 1).bit_length()) - 1
    x, y = point

    def nearer(least, side):
        number, (x0, y0), (step_x, step_y), (per_x, per_y), further = side
        to_x, to_y = x - x0, y - y0
        t = jnp.clip(to_x * per_x + to_y * per_y, 0, 1)
        squared = (to_x - t * step_x) ** 2 + (to_y - t * step_y) ** 2 + further
        # Bits of positive floats sort like the floats, so the lowest bits can store the index.
        key = jax.lax.bitcast_convert_type(squared, jnp.int32) & ~room | number
        return jnp.minimum(least, key), None

    each = (jnp.moveaxis(vectors, 1, 0) for vectors in (outline.start, step, per_length))
    sides = (jnp.arange(n, dtype=jnp.int32), *each, spare)
    most = jnp.full(x.shape, jnp.iinfo(jnp.int32).max)
    least, _ = jax.lax.scan(nearer, most, sides, unroll=UNROLLED)
    return least & room


def _normal(side: Float[Array, "2 m b"]) -> Float[Array, "2 m b"]:
    """Return the unit vector out of an outline across a side; 0 for a side without length."""
    return jnp.stack([side[1], -side[0]]) * jax.lax.rsqrt(jnp.maximum(total(side**2), TINY))


def points_towards(outline: Outline, way: Float[Array, "2 n b"]) -> Bool[Array, "n b"]:
    """Check for which corners of an outline no neighbour is further in a direction."""
    sides = outline.end - outline.start, outline.before - outline.start
    slopes = (total(side * way) / jnp.sqrt(jnp.maximum(total(side**2), TINY)) for side in sides)
    there, back = (slope < _SLANT for slope in slopes)
    return there & back


def is_salient(outline: Outline) -> Bool[Array, "n b"]:
    """Check which corners of a hole are corners of the plate that stand out, or lie on a straight wall."""
    (x0, y0), (x1, y1) = outline.start - outline.before, outline.end - outline.start
    length = jnp.sqrt(jnp.maximum((x0**2 + y0**2) * (x1**2 + y1**2), TINY**2))
    return (x0 * y1 - y0 * x1) / length < _FLAT
