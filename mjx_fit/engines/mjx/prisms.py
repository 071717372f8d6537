"""Pegs and sockets with outlines, their relative pose, and candidates for contact points between them.

The worlds, ``b``, are the last axis of all arrays: see ``mjx_fit.utils.linalg``.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.engines.mjx.boundary import Outline
from mjx_fit.types import Array
from mjx_fit.utils.linalg import times, total

MOST_OF_A_KIND = 16
"""Candidates of one kind that are all kept: corners of the tip, of the rim, crossings and so on."""
ROOT_HALF = 0.5**0.5
"""Component of the normal of a chamfer."""
_GROUPS = range(MOST_OF_A_KIND, 21)
"""Numbers of candidates that are kept of more."""


class Peg(NamedTuple):
    """Peg in its own frame, whose z axis points to the tip.

    Attributes:
        outline: Outline in that frame.
        tip: Outline of the tip's face, with the same sides; None: no peg of the scene has a chamfer.
        length: Distance of the tip, m.
        chamfer: Width and height of the chamfer around the tip, at 45 degrees, m.
    """

    outline: Outline
    tip: Outline | None
    length: Float[Array, "b"]
    chamfer: Float[Array, "b"]

    @property
    def face(self) -> Outline:
        """Outline of the tip's face."""
        return self.outline if self.tip is None else self.tip


class Socket(NamedTuple):
    """Socket in the frame of its upper face.

    Attributes:
        outline: Outline of the hole.
        mouth: Outline of the hole in the upper face, with the same sides; None: no socket has a chamfer.
        depth: Depth of the hole, m.
        chamfer: Width and height of the chamfer around the mouth, at 45 degrees, m.
        half_width: Half the side of the plate, m.
    """

    outline: Outline
    mouth: Outline | None
    depth: Float[Array, "b"]
    chamfer: Float[Array, "b"]
    half_width: Float[Array, "b"]

    @property
    def rim(self) -> Outline:
        """Outline of the hole in the upper face."""
        return self.outline if self.mouth is None else self.mouth


class Pose(NamedTuple):
    """Pose of the peg in the frame of the socket.

    Attributes:
        pos: Origin of the peg's frame, m.
        frame: Axes of the peg, as columns.
    """

    pos: Float[Array, "3 b"]
    frame: Float[Array, "3 3 b"]


class Touch(NamedTuple):
    """Candidates for contact points.

    Attributes:
        depth: Penetration, m; not positive: no contact.
        pos: Position, m.
        normal: Unit vector from the peg to the socket.
    """

    depth: Float[Array, "m b"]
    pos: Float[Array, "3 m b"]
    normal: Float[Array, "3 m b"]


def in_socket_frame(pose: Pose, flat: Float[Array, "2 n b"], along: Float[Array, "b"]):
    """Convert points of the peg at a distance along its axis."""
    return pose.pos[:, None] + times(pose.frame[:, :2, None], flat) + (pose.frame[:, 2] * along)[:, None]


def height_of_tip(peg: Peg, pose: Pose, flat) -> Float[Array, "n b"]:
    """Return the height of the tip's plane at places in the plane of the plate."""
    axis = pose.frame[:, 2]
    centre = pose.pos + axis * peg.length
    return centre[2] - total(axis[:2, None] * (flat - centre[:2, None])) / axis[2]


def slope_of_tip(pose: Pose, step: Float[Array, "2 n b"]) -> Float[Array, "n b"]:
    """Return how much the tip's plane rises over steps in the plane of the plate."""
    axis = pose.frame[:, 2]
    return -total(axis[:2, None] * step) / axis[2]


def level(flat: Float[Array, "2 n b"]) -> Float[Array, "3 n b"]:
    """Return vectors in the plane of the plate's top."""
    return jnp.concatenate([flat, jnp.zeros_like(flat[:1])])


def down(like: Float[Array, "3 n b"]) -> Float[Array, "3 n b"]:
    """Return vectors that point down: from the peg to the plate below it."""
    return jnp.broadcast_to(jnp.array([0.0, 0.0, -1.0], like.dtype)[:, None, None], like.shape)


def grouped(n: int) -> tuple[int, int]:
    """Divide n candidates into groups of neighbours: number and size, with the fewest spare places."""
    if n <= MOST_OF_A_KIND:
        return n, 1
    groups = min(_GROUPS, key=lambda groups: -(-n // groups) * groups)
    return groups, -(-n // groups)


def thinned(touch: Touch) -> Touch:
    """Keep the deepest of each few neighbours if there are many: a face needs no more points to stand."""
    n = len(touch.depth)
    groups, size = grouped(n)
    if size == 1:
        return touch
    fields = jnp.concatenate([touch.depth[None], touch.pos, touch.normal])
    fields = jnp.pad(fields, ((0, 0), (0, groups * size - n), (0, 0)))
    rows = fields.reshape(len(fields), groups, size, fields.shape[-1])
    best = rows[:, :, 0]
    for i in range(1, size):
        best = jnp.where(rows[0, :, i] > best[0], rows[:, :, i], best)
    return Touch(best[0], best[1:4], best[4:])
