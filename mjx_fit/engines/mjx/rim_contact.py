"""Contact of the rim of a hole with a peg: its corners in the peg, and where the tip crosses it.

The worlds, ``b``, are the last axis of all arrays: see ``mjx_fit.utils.linalg``.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.engines.mjx.boundary import (
    TINY,
    UNROLLED,
    Boundary,
    Outline,
    boundary,
    is_salient,
    points_towards,
)
from mjx_fit.engines.mjx.prisms import (
    ROOT_HALF,
    Peg,
    Pose,
    Socket,
    Touch,
    down,
    height_of_tip,
    in_socket_frame,
    slope_of_tip,
)
from mjx_fit.types import Array
from mjx_fit.utils.linalg import times


def overlap_of(
    peg: Peg, socket: Socket, at_tip: Boundary, at_rim: Boundary
) -> tuple[Float[Array, "n b"], Float[Array, "n b"]]:
    """Return how far corners of the tip are beyond the rim, and those of the rim in the tip, from above."""
    beyond = jnp.where(at_tip.inside, 0.0, jnp.maximum(at_tip.distance - socket.chamfer, 0.0))
    within = jnp.where(at_rim.inside, jnp.maximum(at_rim.distance - peg.chamfer, 0.0), 0.0)
    return beyond, within


class Rim(NamedTuple):
    """Corners of an outline of the hole.

    Attributes:
        outline: The outline.
        corner: The corners, m.
        to_tip: Distance to the plane of the tip along the peg, m.
        along: Distance from the other end of the peg, m.
        at: The corners in relation to the peg's outline.
    """

    outline: Outline
    corner: Float[Array, "3 n b"]
    to_tip: Float[Array, "n b"]
    along: Float[Array, "n b"]
    at: Boundary


def rim_of(peg: Peg, pose: Pose, outline: Outline, height: Float[Array, "b"]) -> Rim:
    """Relate the corners of an outline of the hole, at a height in the socket frame, to the peg."""
    flat = outline.start
    corner = jnp.concatenate([flat, jnp.broadcast_to(height, flat[:1].shape)])
    in_peg = times(pose.frame.swapaxes(0, 1)[:, :, None], corner - pose.pos[:, None])
    return Rim(outline, corner, peg.length - in_peg[2], in_peg[2], boundary(peg.outline, in_peg[:2]))


def of_the_rim(
    peg: Peg, socket: Socket, pose: Pose, rim: Rim, reach: Float[Array, "b"]
) -> tuple[Touch, Touch]:
    """Find corners of an outline of the hole in the peg, and edges of the hole below at the end of its sides.

    A corner that does not point at a side carries the tip, if it is less deep in it than the outlines of tip
    and hole overlap. In a corner of the hole both walls are touched, and the tip may be far below.
    """
    (pos, frame), (outline, corner, to_tip, along, at) = pose, rim
    flat = outline.start
    slope = ROOT_HALF * (at.mitred + to_tip - peg.chamfer)
    side, across = (times(frame[:, :2, None], flat) for flat in (at.outward, at.across))
    inside = at.inside & (to_tip > 0) & (along > 0) & (slope > 0)
    pointing = points_towards(outline, -side[:2]) & is_salient(outline)
    inside &= pointing | (to_tip <= jnp.maximum(at.distance - peg.chamfer, reach))
    beside, slope = (jnp.where(pointing, way_out, jnp.inf) for way_out in (at.distance, slope))
    by_side = beside < jnp.minimum(to_tip, slope)
    axis = frame[:, 2][:, None]
    normal = jnp.where(by_side, side, jnp.where(slope < to_tip, ROOT_HALF * (across + axis), axis))
    depth = jnp.where(inside, jnp.minimum(jnp.minimum(to_tip, beside), slope), 0.0)
    upper = Touch(depth, corner + 0.5 * depth * normal, normal)

    low = jnp.maximum(height_of_tip(peg, pose, flat) + peg.chamfer, -socket.depth)
    foot = jnp.concatenate([flat, low[None]])
    at_foot = boundary(peg.outline, times(frame.swapaxes(0, 1)[:2, :, None], foot - pos[:, None]))
    depth = jnp.where(inside & by_side & at_foot.inside, at_foot.distance, 0.0)
    normal = times(frame[:, :2, None], at_foot.outward)
    return upper, Touch(depth, foot + 0.5 * depth * normal, normal)


def of_crossings(
    peg: Peg, socket: Socket, pose: Pose, tip, overlap: tuple[Float[Array, "n b"], Float[Array, "n b"]]
) -> tuple[Touch, Touch]:
    """Find where the outline of the tip crosses the rim, seen from above: the first and last of each side.

    There the tip rests on the rim, unless it is further below the rim than it is beyond the wall: then the
    wall holds it. Of a side of the tip, its end out of the hole counts for that, and of a side of the rim its
    end in the tip. A wall holds the sides of the peg, which are further out than the tip by its chamfer.
    """
    beyond, within = ((x, jnp.roll(x, -1, 0)) for x in overlap)
    rim, along = socket.rim.start, socket.rim.end - socket.rim.start
    step = (in_socket_frame(pose, peg.face.end, peg.length) - tip)[:2]

    # The tip's height along a side of the rim.
    height, slope = height_of_tip(peg, pose, rim), slope_of_tip(pose, along)

    def crossed(found, side):
        (x, y), (step_x, step_y), out = side
        scale = along[0] * step_y - along[1] * step_x
        scale = jnp.where(abs(scale) < TINY, TINY, scale)
        gap_x, gap_y = x - rim[0], y - rim[1]
        per_scale = 1 / scale
        t = (gap_x * step_y - gap_y * step_x) * per_scale
        s = (gap_x * along[1] - gap_y * along[0]) * per_scale
        there = (t > 0) & (t < 1) & (s > 0) & (s < 1)
        # The tip is to the right of its sides, as it hangs down; the hole is to the left of the rim's.
        most = jnp.where(scale > 0, jnp.maximum(out[0], within[1]), jnp.maximum(out[1], within[0]))
        there &= -(height + t * slope) < most + peg.chamfer
        first, last = (
            jnp.where(there, choose(end, t), end)
            for choose, end in zip((jnp.minimum, jnp.maximum), found, strict=True)
        )
        return (first, last), None

    none = jnp.full(rim.shape[1:], 2.0), jnp.full(rim.shape[1:], -1.0)
    sides = jnp.moveaxis(tip[:2], 1, 0), jnp.moveaxis(step, 1, 0), beyond
    (first, last), _ = jax.lax.scan(crossed, none, sides, unroll=UNROLLED)

    def at(t):
        above = height + t * slope
        depth = jnp.where((t > 0) & (t < 1) & (above < 0), -above, 0.0)
        place = jnp.concatenate([rim + t * along, 0.5 * above[None]])
        return Touch(depth, place, down(place))

    return at(first), at(jnp.where(last > first, last, -1.0))
