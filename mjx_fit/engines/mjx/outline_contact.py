"""Contact points between a prismatic peg and a socket with a prismatic hole, for all worlds at once.

Peg and hole are extruded outlines: polygons with any number of sides, areas and holes. No convex pieces are
needed, so no seam between pieces can be touched. A point of one body inside the other leaves it by the
nearest face: a corner of the tip by the plate's top or a wall, a corner of the rim by the tip or a side.
Where the outlines cross, the tip rests on the rim. The peg must be within 45 degrees of upright.

The worlds, ``b``, are the last axis of all arrays: see ``mjx_fit.utils.linalg``. Loops over the sides of an
outline are scans, so that the size of the program does not depend on their number.
"""

import jax.numpy as jnp
from jaxtyping import Bool, Float

from mjx_fit.engines.mjx.boundary import (
    TINY,
    Boundary,
    Outline,
    boundary,
    points_towards,
)
from mjx_fit.engines.mjx.collision import Points, frames
from mjx_fit.engines.mjx.prisms import (
    ROOT_HALF,
    Peg,
    Pose,
    Socket,
    Touch,
    down,
    in_socket_frame,
    level,
    thinned,
)
from mjx_fit.engines.mjx.rim_contact import of_crossings, of_the_rim, overlap_of, rim_of
from mjx_fit.types import Array
from mjx_fit.utils.linalg import largest, times, total


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
    wall = edge = rim_of(peg, pose, socket.outline, -socket.chamfer)
    if socket.mouth is not None:
        edge = rim_of(peg, pose, socket.mouth, jnp.zeros_like(socket.chamfer))
    at_tip = boundary(socket.outline, tip[:2])
    overlap = overlap_of(peg, socket, at_tip, edge.at)
    reach = jnp.maximum(*(x.max(0) for x in overlap))
    of_peg = (
        *_of_corners(peg, socket, pose, (tip, at_tip, reach)),
        _of_the_floor(socket, tip),
        _of_sides(peg, socket, pose, tip),
    )
    found = [_of_real(peg.outline, touch) for touch in of_peg]
    upper, foot = of_the_rim(peg, socket, pose, wall, reach)
    found += [_of_real(socket.outline, upper), _of_real(socket.outline, foot)]
    if socket.mouth is not None:
        upper, _ = of_the_rim(peg, socket, pose, edge, reach)
        upper = upper._replace(depth=jnp.where(socket.chamfer > 0, upper.depth, 0.0))
        found.append(_of_real(socket.outline, upper))
    found += of_crossings(peg, socket, pose, tip, overlap)
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
    peg: Peg, socket: Socket, pose: Pose, of_tip: tuple[Float[Array, "3 n b"], Boundary, Float[Array, "b"]]
) -> list[Touch]:
    """Find corners of the peg in the plate: those of the tip, and above a chamfer those of the sides."""
    tip, at_tip, reach = of_tip
    pointing = _points_at_walls(peg.face, pose, at_tip)
    if peg.tip is None:
        return [_in_the_plate(socket, tip, at_tip, pointing, (reach, at_tip.distance))[0]]
    corner = in_socket_frame(pose, peg.outline.start, peg.length - peg.chamfer)
    # A wall is touched by the chamfer or the sides, which are further out than the tip.
    by_chamfer, _ = _by_chamfer(corner - tip, at_tip, -tip[2])
    touch, by_wall = _in_the_plate(socket, tip, at_tip, pointing, (reach, by_chamfer))
    upper = touch._replace(depth=jnp.where(by_wall, 0.0, touch.depth))
    at = boundary(socket.outline, corner[:2])
    pointing = _points_at_walls(peg.outline, pose, at)
    touch, by_wall = _in_the_plate(socket, corner, at, pointing, (reach, at.distance))
    return [upper, touch._replace(depth=jnp.where(by_wall, touch.depth, 0.0))]


def _by_chamfer(
    edge: Float[Array, "3 n b"], at: Boundary, below: Float[Array, "n b"]
) -> tuple[Float[Array, "n b"], Float[Array, "3 n b"]]:
    """Return the way out of the plate past the edges of a chamfer, and the normal there.

    An edge that rises by e and leads out over the rim by o is held at right angles to itself and to the rim:
    a place on it that is d beyond the wall, seen from above, is d / √(1 + (o / e)²) deep.

    Args:
        edge: Vectors along the edges from the tip, m.
        at: Places of points of the edges in relation to the hole.
        below: How far these points are below the rim, m.
    """
    rise = edge[2]
    lean = total(edge[:2] * at.across) / jnp.where(rise > TINY, rise, 1.0)
    size = jnp.sqrt(1 + lean**2)
    leads_out = (rise > TINY) & (lean > 0)
    depth = jnp.where(leads_out, (at.mitred + below * lean) / size, jnp.inf)
    return depth, (level(at.across) + lean * down(edge)) / size


def _points_at_walls(outline: Outline, pose: Pose, at: Boundary) -> Bool[Array, "n b"]:
    """Check which corners of the peg point at the wall they are beyond.

    A corner whose sides lead on into the wall is a place where the peg lies on the plate, however close the
    wall is.
    """
    return points_towards(outline, times(pose.frame[:2, :2].swapaxes(0, 1)[:, :, None], at.outward))


def _in_the_plate(
    socket: Socket,
    corner: Float[Array, "3 n b"],
    at: Boundary,
    pointing: Bool[Array, "n b"],
    ways: tuple[Float[Array, "b"], Float[Array, "n b"]],
) -> tuple[Touch, Bool[Array, "n b"]]:
    """Find corners in the plate, which leave it by its top, a wall or the chamfer between them.

    The two ways are how far the outlines of tip and hole overlap, and how far each corner has to its wall.
    Only corners that are ``pointing`` at the wall leave by the wall or the chamfer. The others lie on the
    plate, if they are less deep than the outlines of tip and hole overlap; otherwise the tip is in the hole.
    """
    reach, by_way = ways
    below = -corner[2]
    on_plate = jnp.maximum(abs(corner[0]), abs(corner[1])) < socket.half_width
    slope = ROOT_HALF * (at.mitred + below - socket.chamfer)
    solid = on_plate & ~at.inside & (below > 0) & (slope > 0)
    solid &= pointing | (below <= jnp.maximum(at.distance - socket.chamfer, reach))
    beside = jnp.where(pointing, by_way, jnp.inf)
    slope = jnp.where(pointing, slope, jnp.inf)
    by_wall = beside < jnp.minimum(below, slope)
    depth = jnp.where(solid, jnp.minimum(jnp.minimum(below, beside), slope), 0.0)
    # A wall pushes the peg into the hole, against the way out of it.
    outward, downward = level(at.outward), down(corner)
    sloping = ROOT_HALF * (level(at.across) + downward)
    normal = jnp.where(by_wall, outward, jnp.where(slope < below, sloping, downward))
    return Touch(depth, corner - 0.5 * depth * normal, normal), by_wall


def _of_the_floor(socket: Socket, tip: Float[Array, "3 n b"]) -> Touch:
    """Find corners of the tip in the floor."""
    depth = jnp.maximum(-socket.depth - tip[2], 0.0)
    return Touch(depth, tip - 0.5 * depth * down(tip), down(tip))


def _of_sides(peg: Peg, socket: Socket, pose: Pose, tip: Float[Array, "3 n b"]) -> Touch:
    """Find edges along the peg, or of its chamfer, that are in a wall at its upper end."""
    axis, top = pose.frame[:, 2], -socket.chamfer
    corner = in_socket_frame(pose, peg.outline.start, peg.length - peg.chamfer)
    edge = corner - tip
    on_chamfer = (corner[2] > top) & (edge[2] > TINY)
    along = jnp.where(on_chamfer, edge[:2] / jnp.where(on_chamfer, edge[2], 1.0), axis[:2, None] / axis[2])
    there = corner[:2] - (corner[2] - top) * along
    at, below = boundary(socket.outline, there), top - tip[2]
    slope, sloping = _by_chamfer(edge, at, jnp.maximum(top - corner[2], 0.0))
    beside = jnp.where(on_chamfer, jnp.inf, at.distance)
    depth = jnp.minimum(beside, slope)
    pointing = _points_at_walls(peg.outline, pose, at)
    depth = jnp.where(~at.inside & pointing & (depth > 0) & (depth < below), depth, 0.0)
    outward = level(at.outward)
    normal = jnp.where(slope < beside, sloping, outward)
    wall = jnp.concatenate([there, jnp.broadcast_to(top, there[:1].shape)]) - at.distance * outward
    return Touch(depth, wall + 0.5 * depth * normal, normal)
