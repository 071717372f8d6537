"""Find the deepest contact points between the boxes of peg and socket, for all worlds at once.

MJX's own box collision handles arbitrary boxes, one pair at a time. This module exploits that all boxes of
the peg rotate together and those of the socket are axis-aligned: the axes of the separating axis test are the
same for all pairs of a world, and few pairs touch at a time. Contacts are those of MuJoCo's C engine: the
incident face clipped against the face of least overlap, or one point where two edges cross
(``mjx_fit.engines.mjx.edges``; experiments/physics/parity_step.py compares).

The peg must be within 45 degrees of upright and of the socket's axes, as in any valid attempt. The
worlds, ``b``, are the last axis of all arrays: see ``mjx_fit.utils.linalg``.
"""

from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.engines.mjx.edges import Crossing, crossing, outdo
from mjx_fit.types import Array
from mjx_fit.utils.linalg import largest, times, total

MOST_PAIRS, PAIRS_PER_BOX = 6, 3
"""Box pairs tested for contact, by largest overlap: 6, or 3 per box of the peg; up to 6 and 9 were seen."""


class Points(NamedTuple):
    """Contact points, the deepest first; unused ones have a positive distance.

    Attributes:
        dist: Distance, negative in contact, m.
        pos_plate: Position midway between the surfaces, relative to the socket's origin, m.
        frame: Contact axes as rows: the normal from the peg to the socket, and two tangents.
    """

    dist: Float[Array, "n b"]
    pos_plate: Float[Array, "n 3 b"]
    frame: Float[Array, "n 3 3 b"]


class _Overlap(NamedTuple):
    """Pairs of boxes in the frame of the face of least overlap, the reference; axis 0 is its normal.

    Attributes:
        depth: Least overlap of the two boxes, m; negative if they are apart.
        side: Side of the reference box, 1 or -1, on which the incident box lies.
        half: Half sizes of the reference box, m.
        face: Centre of the incident face, m.
        edges: Two half edges of the incident face, m.
        origin: Centre of the reference box, relative to the socket's origin, m.
        basis: Axes of the reference in the socket frame, as columns.
        normal: Normal from the peg to the socket, in the socket frame.
    """

    depth: Float[Array, "k b"]
    side: Float[Array, "k b"]
    half: Float[Array, "3 k b"]
    face: Float[Array, "3 k b"]
    edges: tuple[Float[Array, "3 k b"], Float[Array, "3 k b"]]
    origin: Float[Array, "3 k b"]
    basis: Float[Array, "3 3 k b"]
    normal: Float[Array, "3 k b"]


class Boxes(NamedTuple):
    """Boxes of a body.

    Attributes:
        centre: Centres in the body frame, m.
        half: Half sizes, m.
    """

    centre: Float[Array, "n 3 b"]
    half: Float[Array, "n 3 b"]


def deepest_points(
    peg: Boxes,
    plate: Boxes,
    peg_pos_plate: Float[Array, "3 b"],
    peg_frame_plate: Float[Array, "3 3 b"],
    count: int,
) -> Points:
    """Compute the deepest contact points of a peg and a socket.

    Args:
        peg: Boxes of the peg.
        plate: Boxes of the socket.
        peg_pos_plate: Origin of the peg frame in the socket frame, m.
        peg_frame_plate: Axes of the peg in the socket frame, as columns.
        count: Number of points.
    """
    centre = peg_pos_plate + total(peg_frame_plate * peg.centre[:, None], 2)
    shape = (len(peg.centre), *plate.centre.shape)

    def of_pairs(of_peg, of_plate):
        both = jnp.broadcast_to(of_peg[:, None], shape), jnp.broadcast_to(of_plate[None], shape)
        return [jnp.moveaxis(x.reshape(-1, *shape[2:]), 1, 0) for x in both]

    peg_at, plate_at = of_pairs(centre, plate.centre)
    peg_size, plate_size = of_pairs(peg.half, plate.half)
    along = _overlaps(peg_at - plate_at, peg_size, plate_size, peg_frame_plate)
    boxes = jnp.concatenate([peg_at, plate_at, peg_size, plate_size])
    nearest = largest(_least(along), boxes, max(MOST_PAIRS, PAIRS_PER_BOX * len(peg.centre)))
    peg_at, plate_at, peg_size, plate_size = jnp.split(jnp.moveaxis(nearest, 0, 1), 4)
    pairs = _reference(peg_at, plate_at, peg_size, plate_size, peg_frame_plate)
    edges = crossing(peg_at, plate_at, peg_size, plate_size, peg_frame_plate)
    return _deepest(*_or_edges(pairs, *_candidates(pairs), edges), count)


def _overlaps(between, peg_half, plate_half, frame):
    """Compute the overlap of boxes along the axes of the socket and of the peg, (3, k, b) each, m.

    Args:
        between: Vector from the socket's box to the peg's box (3, k, b), m.
        peg_half: Half sizes of the peg's box (3, k, b), m.
        plate_half: Half sizes of the socket's box (3, k, b), m.
        frame: Axes of the peg as columns (3, 3, b).
    """
    frame = frame[:, :, None]
    across = abs(frame)
    along_plate = plate_half + total(across * peg_half, 1) - abs(between)
    along_peg = peg_half + total(across * plate_half[:, None]) - abs(total(frame * between[:, None]))
    return along_plate, along_peg


def _reference(peg_at, plate_at, peg_half, plate_half, frame) -> _Overlap:
    """Express pairs of boxes, (3, k, b) each, in the frame of the face of least overlap."""
    between = peg_at - plate_at
    along_plate, along_peg = _overlaps(between, peg_half, plate_half, frame)
    on_plate = reduce(jnp.minimum, along_plate) <= reduce(jnp.minimum, along_peg)
    axes = jnp.broadcast_to(frame[:, :, None], (3, 3, *between.shape[1:]))
    world = jnp.broadcast_to(jnp.eye(3).reshape(3, 3, *[1] * (axes.ndim - 2)), axes.shape)
    turn = _by_axis(jnp.where(on_plate, along_plate, along_peg))

    seen = jnp.where(on_plate, between, -total(axes * between[:, None]))
    half, other = (
        turn(jnp.where(on_plate, plate_half, peg_half)),
        turn(jnp.where(on_plate, peg_half, plate_half)),
    )
    other_axes = jnp.where(on_plate, axes, axes.swapaxes(0, 1))
    other_axes = turn(jnp.stack([turn(other_axes[:, j]) for j in range(3)], 0)).swapaxes(0, 1)
    basis = jnp.where(on_plate, world, axes)
    basis = turn(basis.swapaxes(0, 1)).swapaxes(0, 1)

    seen = turn(seen)
    side = jnp.where(seen[0] > 0, 1.0, -1.0)
    face = seen - side * jnp.sign(other_axes[0, 0]) * other[0] * other_axes[:, 0]
    return _Overlap(
        depth=_least((along_plate, along_peg)),
        side=side,
        half=half,
        face=face,
        edges=(other[1] * other_axes[:, 1], other[2] * other_axes[:, 2]),
        origin=jnp.where(on_plate, plate_at, peg_at),
        basis=basis,
        normal=jnp.where(on_plate, -side, side) * basis[:, 0],
    )


def _by_axis(overlap):
    """Return a function that permutes vectors (3, k, b) so that the axis of least overlap comes first."""
    first = (overlap[0] <= overlap[1]) & (overlap[0] <= overlap[2])
    second = ~first & (overlap[1] <= overlap[2])

    def turn(vector):
        x, y, z = vector
        rows = (x, y, z), (y, z, x), (z, x, y)
        return jnp.stack([jnp.where(first, a, jnp.where(second, b, c)) for a, b, c in rows])

    return turn


def _candidates(pairs: _Overlap) -> tuple[Float[Array, "m k b"], Float[Array, "m 2 k b"]]:
    """Compute depth (not positive: no contact) and position on the reference face of all candidate points.

    Candidates are the corners of the incident and the reference face, and the crossings of their edges.
    """
    (_, a, b), (edge, other), face = pairs.half, pairs.edges, pairs.face
    points = []
    for u in (-1, 1):
        for v in (-1, 1):
            corner = face + u * edge + v * other
            points.append((corner, (abs(corner[1]) <= a) & (abs(corner[2]) <= b)))
            points.append(_under_corner(u * a, v * b, face, edge, other))
    for along, start in ((edge, other), (other, edge)):
        for v in (-1, 1):
            begin = face + v * start
            for axis, limit, across, bound in ((1, a, 2, b), (2, b, 1, a)):
                for u in (-1, 1):
                    t = (u * limit - begin[axis]) / along[axis]
                    point = begin + t * along
                    points.append((point, (abs(t) <= 1) & (abs(point[across]) <= bound)))
    at, there = jnp.stack([point for point, _ in points]), jnp.stack([here for _, here in points])
    depth = jnp.where(there, pairs.half[0] - pairs.side * at[:, 0], 0.0)
    return depth, jnp.where(there[:, None], at[:, 1:], 0.0)


def _under_corner(a, b, face, edge, other):
    """Compute the incident face's point over a corner (a, b) of the reference face, and whether it exists."""
    y, z = a - face[1], b - face[2]
    scale = 1 / (edge[1] * other[2] - edge[2] * other[1])
    u, v = (y * other[2] - z * other[1]) * scale, (z * edge[1] - y * edge[2]) * scale
    return jnp.stack([face[0] + u * edge[0] + v * other[0], a, b]), (abs(u) <= 1) & (abs(v) <= 1)


def _or_edges(pairs: _Overlap, depth, place, edges: Crossing):
    """Replace the candidates of pairs that overlap least along two edges by the point where these cross."""
    crossed = outdo(edges, pairs.depth, pairs.normal)
    only = jnp.where(jnp.arange(len(depth))[:, None, None] == 0, edges.depth, 0.0)
    half = jnp.stack([edges.depth / 2, *pairs.half[1:]])  # the point is in the middle of the overlap
    pairs = pairs._replace(
        depth=jnp.minimum(pairs.depth, edges.depth),
        half=jnp.where(crossed, half, pairs.half),
        origin=jnp.where(crossed, edges.pos, pairs.origin),
        normal=jnp.where(crossed, edges.normal, pairs.normal),
    )
    return pairs, jnp.where(crossed, only, depth), jnp.where(crossed, 0.0, place)


def _deepest(pairs: _Overlap, depth, place, count: int) -> Points:
    """Select the deepest candidates, in the socket frame."""
    number = jnp.broadcast_to(jnp.arange(depth.shape[1], dtype=depth.dtype)[:, None], depth.shape)
    depth = jnp.where(pairs.depth > 0, depth, 0.0)
    fields = jnp.stack([depth, place[:, 0], place[:, 1], number]).reshape(4, -1, depth.shape[-1])
    deep, y, z, number = jnp.moveaxis(largest(fields[0], fields, count), 0, 1)

    def of_pair(field):
        rows = (jnp.where(number == i, field[..., i, None, :], 0.0) for i in range(depth.shape[1]))
        return reduce(jnp.add, rows)

    height = of_pair(pairs.side) * (of_pair(pairs.half[0]) - deep / 2)
    pos = of_pair(pairs.origin) + times(of_pair(pairs.basis), jnp.stack([height, y, z]))
    dist = jnp.where(deep > 0, -deep, 1.0)
    return Points(dist, pos.swapaxes(0, 1), jnp.moveaxis(frames(of_pair(pairs.normal)), 2, 0))


def frames(normal: Float[Array, "3 n b"]) -> Float[Array, "3 3 n b"]:
    """Complete normals to frames with two tangents, without a division by zero (Duff et al., JCGT 2017)."""
    x, y, z = normal
    sign = jnp.where(z < 0, -1.0, 1.0)
    scale = -1 / (sign + z)
    tangent = jnp.stack([1 + sign * x**2 * scale, sign * x * y * scale, -sign * x])
    return jnp.stack([normal, tangent, jnp.stack([x * y * scale, sign + y**2 * scale, -y])])


def _least(along):
    """Compute the least overlap of each pair of boxes."""
    return jnp.minimum(*(reduce(jnp.minimum, axes) for axes in along))
