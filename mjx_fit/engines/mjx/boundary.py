"""Outlines of pegs and holes, and the place of points in relation to them, for all worlds at once.

The worlds, ``b``, are the last axis of all arrays: see ``mjx_fit.utils.linalg``. Loops over the sides of an
outline are scans, so that the size of the program does not depend on their number.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from mjx_fit.types import Array
from mjx_fit.utils.linalg import total

TINY = 1e-12
_SAME = 1e-5
"""Share of a squared distance by which two sides that meet at the nearest corner may differ, by rounding."""
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
    """

    start: Float[Array, "2 n b"]
    end: Float[Array, "2 n b"]
    before: Float[Array, "2 n b"]


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
    """Relate points to an outline: inside by counting crossings, and the nearest point of the boundary."""
    x, y = point

    def nearer(found, side):
        odd, squared, at_corner, line, way, across = found
        (x0, y0), (x1, y1) = side
        step_x, step_y = x1 - x0, y1 - y0
        straddles = (y0 > y) != (y1 > y)
        left = x < x0 + step_x * (y - y0) / jnp.where(step_y == 0, 1.0, step_y)
        odd = odd ^ (straddles & left)
        length_2 = jnp.maximum(step_x**2 + step_y**2, TINY)
        t = jnp.clip(((x - x0) * step_x + (y - y0) * step_y) / length_2, 0, 1)
        to_x, to_y = x0 + t * step_x - x, y0 + t * step_y - y
        new = to_x**2 + to_y**2
        on_side = (t > 0) & (t < 1)
        scale = jax.lax.rsqrt(length_2)
        normal = step_y * scale, -step_x * scale
        its_line = abs((x - x0) * normal[0] + (y - y0) * normal[1])
        closer = new < squared
        same_corner = at_corner & ~on_side & (abs(new - squared) < _SAME * squared)
        its = jnp.where(same_corner, its_line > line, closer)
        return (
            odd,
            jnp.where(closer, new, squared),
            jnp.where(closer, ~on_side, at_corner),
            jnp.where(its, its_line, line),
            _chosen(closer, (to_x, to_y), way),
            _chosen(its, normal, across),
        ), None

    none, zero = jnp.zeros_like(x, bool), jnp.zeros_like(x)
    nothing = (none, jnp.full_like(x, jnp.inf), none, zero, (zero, zero), (zero, zero))
    sides = (jnp.moveaxis(outline.start, 1, 0), jnp.moveaxis(outline.end, 1, 0))
    (inside, squared, at_corner, line, way, across), _ = jax.lax.scan(nearer, nothing, sides)
    # The way to a corner leads out from the inside, and in from the outside.
    distance, across = jnp.sqrt(squared), jnp.stack(across)
    to_corner = jnp.stack(way) * jnp.where(inside, 1.0, -1.0) / jnp.maximum(distance, TINY)
    outward = jnp.where(at_corner & (distance > TINY), to_corner, across)
    return Boundary(inside, distance, outward, jnp.where(at_corner, line, distance), across)


def _chosen(where, new, old):
    return tuple(jnp.where(where, one, other) for one, other in zip(new, old, strict=True))


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
