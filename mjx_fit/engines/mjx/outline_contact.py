"""Contact points between a prismatic peg and a socket with a prismatic hole, for all worlds at once.

Peg and hole are extruded outlines: polygons with any number of sides, areas and holes. No convex pieces are
needed, so no seam between pieces can be touched. A point of one body inside the other leaves it by the
nearest face: a corner of the tip by the plate's top or a wall, a corner of the rim by the tip or a side.
Where the outlines cross, the tip rests on the rim. The peg must be within 45 degrees of upright.

The worlds, ``b``, are the last axis of all arrays: see ``mjx_fit.utils.linalg``. Loops over the sides of an
outline are scans, so that the size of the program does not depend on their number.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from mjx_fit.engines.mjx.boundary import (
    TINY,
    UNROLLED,
    Boundary,
    Outline,
    boundary,
    is_salient,
    points_towards,
)
from mjx_fit.engines.mjx.collision import Points, frames
from mjx_fit.engines.mjx.prisms import (
    Peg,
    Pose,
    Socket,
    Touch,
    down,
    height_of_tip,
    in_socket_frame,
    level,
    slope_of_tip,
    thinned,
)
from mjx_fit.types import Array
from mjx_fit.utils.linalg import largest, times, total

_ROOT_HALF = 0.5**0.5


def touching_points(
    peg: Peg,
    socket: Socket,
    peg_pos_plate: Float[Array, "3 b"],
    peg_frame_plate: Float[Array, "3 3 b"],
    count: int,
) -> Points:
    """Compute the deepest contact points of a peg and a socket.

    Args:
        peg: The peg.
        socket: The socket.
        peg_pos_plate: Origin of the peg frame in the socket frame, m.
        peg_frame_plate: Axes of the peg in the socket frame, as columns.
        count: Number of points.
    """
    pose = Pose(peg_pos_plate, peg_frame_plate)
    tip = in_socket_frame(pose, peg.face.start, peg.length)
    at_tip = boundary(socket.outline, tip[:2])
    of_peg = (
        *_of_corners(peg, socket, pose, tip, at_tip),
        _of_the_floor(socket, tip),
        _of_sides(peg, socket, pose, tip),
    )
    found = [_of_real(peg.outline, touch) for touch in of_peg]
    upper, foot, at_rim = _of_the_rim(peg, socket, pose, socket.outline, -socket.chamfer)
    found += [_of_real(socket.outline, upper), _of_real(socket.outline, foot)]
    if socket.mouth is not None:
        chamfered = socket.chamfer > 0
        upper, _, at_rim = _of_the_rim(peg, socket, pose, socket.mouth, jnp.zeros_like(socket.chamfer))
        upper = upper._replace(depth=jnp.where(chamfered, upper.depth, 0.0))
        found.append(_of_real(socket.outline, upper))
    found += _of_crossings(peg, socket, pose, tip, (at_tip, at_rim))
    depth, pos, normal = (jnp.concatenate(parts, axis=-2) for parts in zip(*map(thinned, found), strict=True))
    fields = jnp.concatenate([depth[None], pos, normal])
    deep, *rest = jnp.moveaxis(largest(depth, fields, count), 0, 1)
    pos, normal = jnp.stack(rest[:3]), jnp.stack(rest[3:])
    normal = jnp.where(deep > 0, normal, jnp.array([0.0, 0.0, -1.0])[:, None, None])
    dist = jnp.where(deep > 0, -deep, 1.0)
    return Points(dist, pos.swapaxes(0, 1), jnp.moveaxis(frames(normal), 2, 0))


def _of_real(outline: Outline, touch: Touch) -> Touch:
    """Leave out the corners of spare sides."""
    real = total((outline.end - outline.start) ** 2) > 0
    return touch._replace(depth=jnp.where(real, touch.depth, 0.0))


def _of_corners(
    peg: Peg, socket: Socket, pose: Pose, tip: Float[Array, "3 n b"], at_tip: Boundary
) -> list[Touch]:
    """Find corners of the peg in the plate: those of the tip, and above a chamfer those of the sides."""
    touch, by_wall = _in_the_plate(socket, tip, at_tip, _points_at_walls(peg.face, pose, at_tip))
    if peg.tip is None:
        return [touch]
    # A wall is touched by the sides, which are further out than the tip.
    upper = touch._replace(depth=jnp.where(by_wall, 0.0, touch.depth))
    corner = in_socket_frame(pose, peg.outline.start, peg.length - peg.chamfer)
    at = boundary(socket.outline, corner[:2])
    touch, by_wall = _in_the_plate(socket, corner, at, _points_at_walls(peg.outline, pose, at))
    return [upper, touch._replace(depth=jnp.where(by_wall, touch.depth, 0.0))]


def _points_at_walls(outline: Outline, pose: Pose, at: Boundary) -> Bool[Array, "n b"]:
    """Check which corners of the peg point at the wall they are beyond.

    A corner whose sides lead on into the wall is a place where the peg lies on the plate, however close the
    wall is.
    """
    return points_towards(outline, times(pose.frame[:2, :2].swapaxes(0, 1)[:, :, None], at.outward))


def _in_the_plate(
    socket: Socket, corner: Float[Array, "3 n b"], at: Boundary, pointing: Bool[Array, "n b"]
) -> tuple[Touch, Bool[Array, "n b"]]:
    """Find corners in the plate, which leave it by its top, a wall or the chamfer between them.

    Only corners that are ``pointing`` at the wall leave by the wall or the chamfer.
    """
    below = -corner[2]
    on_plate = jnp.maximum(abs(corner[0]), abs(corner[1])) < socket.half_width
    slope = _ROOT_HALF * (at.mitred + below - socket.chamfer)
    solid = on_plate & ~at.inside & (below > 0) & (slope > 0)
    beside = jnp.where(pointing, at.distance, jnp.inf)
    slope = jnp.where(pointing, slope, jnp.inf)
    by_wall = beside < jnp.minimum(below, slope)
    depth = jnp.where(solid, jnp.minimum(jnp.minimum(below, beside), slope), 0.0)
    # A wall pushes the peg into the hole, against the way out of it.
    outward, downward = level(at.outward), down(corner)
    sloping = _ROOT_HALF * (level(at.across) + downward)
    normal = jnp.where(by_wall, outward, jnp.where(slope < below, sloping, downward))
    return Touch(depth, corner - 0.5 * depth * normal, normal), by_wall


def _of_the_floor(socket: Socket, tip: Float[Array, "3 n b"]) -> Touch:
    """Find corners of the tip in the floor."""
    depth = jnp.maximum(-socket.depth - tip[2], 0.0)
    return Touch(depth, tip - 0.5 * depth * down(tip), down(tip))


def _of_sides(peg: Peg, socket: Socket, pose: Pose, tip: Float[Array, "3 n b"]) -> Touch:
    """Find edges along the peg, or its chamfer, that are in a wall at its upper end."""
    axis, top = pose.frame[:, 2], -socket.chamfer
    corner = in_socket_frame(pose, peg.outline.start, peg.length - peg.chamfer)
    there = corner[:2] - (corner[2] - top) / axis[2] * axis[:2, None]
    at, below = boundary(socket.outline, there), top - tip[2]
    slope = _ROOT_HALF * (at.mitred + below - peg.chamfer)
    depth = jnp.minimum(at.distance, slope)
    pointing = _points_at_walls(peg.outline, pose, at)
    depth = jnp.where(~at.inside & pointing & (depth > 0) & (depth < below), depth, 0.0)
    outward = level(at.outward)
    sloping = _ROOT_HALF * (level(at.across) + axis[:, None])
    normal = jnp.where(slope < at.distance, sloping, outward)
    wall = jnp.concatenate([there, jnp.broadcast_to(top, there[:1].shape)]) - at.distance * outward
    return Touch(depth, wall + 0.5 * depth * normal, normal)


def _of_the_rim(
    peg: Peg, socket: Socket, pose: Pose, outline: Outline, height: Float[Array, "b"]
) -> tuple[Touch, Touch, Boundary]:
    """Find corners of an outline of the hole in the peg, and edges of the hole below at the end of its sides.

    Returns:
        Contacts of either kind, and the place of the corners in relation to the peg.
    """
    pos, frame = pose
    flat = outline.start
    rim = jnp.concatenate([flat, jnp.broadcast_to(height, flat[:1].shape)])
    in_peg = times(frame.swapaxes(0, 1)[:, :, None], rim - pos[:, None])
    at, to_tip = boundary(peg.outline, in_peg[:2]), peg.length - in_peg[2]
    slope = _ROOT_HALF * (at.mitred + to_tip - peg.chamfer)
    side, across = (times(frame[:, :2, None], flat) for flat in (at.outward, at.across))
    inside = at.inside & (to_tip > 0) & (in_peg[2] > 0) & (slope > 0)
    pointing = points_towards(outline, -side[:2]) & is_salient(outline)
    beside, slope = (jnp.where(pointing, way_out, jnp.inf) for way_out in (at.distance, slope))
    by_side = beside < jnp.minimum(to_tip, slope)
    axis = frame[:, 2][:, None]
    normal = jnp.where(by_side, side, jnp.where(slope < to_tip, _ROOT_HALF * (across + axis), axis))
    depth = jnp.where(inside, jnp.minimum(jnp.minimum(to_tip, beside), slope), 0.0)
    upper = Touch(depth, rim + 0.5 * depth * normal, normal)

    low = jnp.maximum(height_of_tip(peg, pose, flat) + peg.chamfer, -socket.depth)
    foot = jnp.concatenate([flat, low[None]])
    at_foot = boundary(peg.outline, times(frame.swapaxes(0, 1)[:2, :, None], foot - pos[:, None]))
    depth = jnp.where(inside & by_side & at_foot.inside, at_foot.distance, 0.0)
    normal = times(frame[:, :2, None], at_foot.outward)
    return upper, Touch(depth, foot + 0.5 * depth * normal, normal), at


def _of_crossings(
    peg: Peg, socket: Socket, pose: Pose, tip, corners: tuple[Boundary, Boundary]
) -> tuple[Touch, Touch]:
    """Find where the outline of the tip crosses the rim, seen from above: the first and last of each side.

    There the tip rests on the rim, unless it is further below the rim than it is beyond the wall: then the
    wall holds it.
    """
    at_tip, at_rim = corners
    beyond = jnp.where(at_tip.inside, 0.0, jnp.maximum(at_tip.distance - socket.chamfer, 0.0))
    within = jnp.where(at_rim.inside, at_rim.distance, 0.0)
    beyond, within = (jnp.maximum(x, jnp.roll(x, -1, 0)) for x in (beyond, within))
    rim, along = socket.rim.start, socket.rim.end - socket.rim.start
    step = (in_socket_frame(pose, peg.face.end, peg.length) - tip)[:2]

    # The tip's height along a side of the rim.
    height, slope = height_of_tip(peg, pose, rim), slope_of_tip(pose, along)

    def crossed(ends, side):
        (x, y), (step_x, step_y), overlap = side
        scale = along[0] * step_y - along[1] * step_x
        scale = jnp.where(abs(scale) < TINY, TINY, scale)
        gap_x, gap_y = x - rim[0], y - rim[1]
        t = (gap_x * step_y - gap_y * step_x) / scale
        s = (gap_x * along[1] - gap_y * along[0]) / scale
        there = (t > 0) & (t < 1) & (s > 0) & (s < 1)
        there &= -(height + t * slope) < jnp.maximum(overlap, within)
        first, last = (
            jnp.where(there, choose(end, t), end)
            for choose, end in zip((jnp.minimum, jnp.maximum), ends, strict=True)
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
