"""Contact between two edges of boxes, for all worlds at once: one point where they cross.

Where a box tilts over the rim of another, the least overlap is not along the axis of a face but along the
common normal of two edges. MuJoCo's C engine then reports a single point.

The worlds, ``b``, are the last axis of all arrays: see ``mjx_fit.utils.linalg``.
"""

from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.types import Array
from mjx_fit.utils.linalg import cross, total

NEARLY_PARALLEL = 3e-4
"""Sine of the angle between two edges below which their common normal is lost in single precision."""
_ALIGNED, _SHARE = 0.99, 0.95
"""Where the normals of edges and faces agree to this cosine, edges need an overlap below this share."""


class Crossing(NamedTuple):
    """Two edges of least overlap of each pair of boxes.

    Attributes:
        depth: Overlap along the common normal of the edges, m; negative if the boxes are apart.
        pos: Position midway between the edges, relative to the socket's origin, m.
        normal: Common normal from the peg to the socket, in the socket frame.
    """

    depth: Float[Array, "k b"]
    pos: Float[Array, "3 k b"]
    normal: Float[Array, "3 k b"]


def crossing(
    peg_at: Float[Array, "3 k b"],
    plate_at: Float[Array, "3 k b"],
    peg_half: Float[Array, "3 k b"],
    plate_half: Float[Array, "3 k b"],
    frame: Float[Array, "3 3 b"],
) -> Crossing:
    """Find the edges of least overlap of pairs of boxes.

    Edges that are nearly parallel are left out.

    Args:
        peg_at: Centres of the peg's boxes, relative to the socket's origin, m.
        plate_at: Centres of the socket's boxes, m.
        peg_half: Half sizes of the peg's boxes, m.
        plate_half: Half sizes of the socket's boxes, m.
        frame: Axes of the peg as columns, in the socket frame.
    """
    between = peg_at - plate_at
    frame = frame[:, :, None]

    def shallower(found, axes):
        least, number = found
        i, on_peg, on_plate = axes
        normal, sine = _common_normal(on_plate[:, None, None], total(frame * on_peg[:, None, None], 1))
        depth = _reach(normal, frame, peg_half, plate_half) - abs(total(normal * between))
        better = (sine > NEARLY_PARALLEL) & (depth < least)
        return (jnp.where(better, depth, least), jnp.where(better, i, number)), None

    # One number is chosen, once, as the result of a scan. Computed in several kernels, a choice between equal
    # depths may be rounded differently, and the axes of two choices may be those of parallel edges.
    peg_axis, plate_axis = np.array(_AXES).T
    axes = jnp.arange(9.0), jnp.eye(3)[peg_axis], jnp.eye(3)[plate_axis]
    none = jnp.full(between.shape[1:], jnp.inf), jnp.zeros(between.shape[1:])
    (least, number), _ = jax.lax.scan(shallower, none, axes)
    on_peg, on_plate = (
        jnp.stack([sum(jnp.where(number == i, 1.0, 0.0) for i in range(9) if axis[i] == k) for k in range(3)])
        for axis in (peg_axis, plate_axis)
    )
    along_peg = total(frame * on_peg, 1)
    normal, _ = _common_normal(on_plate, along_peg)
    apart = total(normal * between)
    normal = jnp.where(apart > 0, -1.0, 1.0) * normal
    facing = total(frame * normal[:, None])
    # Where a corner lies along its own edge does not matter: the edges are taken as lines.
    peg_edge = peg_at + total(frame * (jnp.sign(facing) * peg_half), 1)
    plate_edge = plate_at - jnp.sign(normal) * plate_half
    pos = _midway(peg_edge, along_peg, plate_edge, on_plate)
    return Crossing(least, pos, normal)


_AXES = tuple(product(range(3), repeat=2))
"""Axes of peg and socket along which two edges can lie."""


def _common_normal(one: Float[Array, "3 *n"], other: Float[Array, "3 *m"]):
    """Return the unit normal of two unit vectors, and the sine of their angle; any vector if it is tiny."""
    normal = cross(*jnp.broadcast_arrays(one, other))
    sine = jnp.sqrt(total(normal**2))
    return normal / jnp.maximum(sine, NEARLY_PARALLEL), sine


def _reach(normal, frame, peg_half, plate_half) -> Float[Array, "k b"]:
    """Return the sum of the half extents of both boxes along a unit vector."""
    facing = total(frame * normal[:, None])
    return total(abs(normal) * plate_half) + total(abs(facing) * peg_half)


def outdo(edges: Crossing, depth: Float[Array, "k b"], normal: Float[Array, "3 k b"]) -> Bool[Array, "k b"]:
    """Check whether edges touch instead of faces, by the rule of MuJoCo's C engine.

    The smaller overlap counts; where the normals nearly agree, faces are preferred.

    Args:
        edges: Edges of least overlap.
        depth: Least overlap along the axes of faces, m.
        normal: Normal of that face.
    """
    aligned = abs(total(edges.normal * normal)) > _ALIGNED
    return edges.depth < jnp.where(aligned, _SHARE, 1.0) * depth


def _midway(start, along, other_start, other_along) -> Float[Array, "3 k b"]:
    """Return the point midway between the closest points of two lines with unit directions."""
    gap, cos = start - other_start, total(along * other_along)
    one, other = total(along * gap), total(other_along * gap)
    square = total(cross(along, other_along) ** 2)
    place = start + (cos * other - one) / square * along
    return 0.5 * (place + other_start + (other - cos * one) / square * other_along)
