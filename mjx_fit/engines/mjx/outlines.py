"""Outlines of pegs and holes as arrays of one shape for all pairs of a scene."""

import math
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from shapely import MultiPolygon

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.engines.mjx.boundary import Outline
from mjx_fit.engines.mjx.prisms import Peg, Socket, grouped
from mjx_fit.scene.outline import hole_outline, inset_corners, peg_outline
from mjx_fit.scene.pieces import peg_pieces, socket_pieces

_BOTTOMLESS_M = 1.0


class Outlines(NamedTuple):
    """Peg and socket of a world, or of many.

    Attributes:
        peg: The peg.
        socket: The socket.
    """

    peg: Peg
    socket: Socket


def outlines_of(scene: SceneConfig) -> Outlines | None:
    """Return the outlines of all pairs of peg and hole, or None if all parts consist of boxes.

    Leaves have a leading axis of pairs, in the order of ``mjx_fit.scene.build.pair_index``.
    """
    shapes = scene.shapes
    pieces = (
        piece for shape in shapes for make in (peg_pieces, socket_pieces) for piece in make(shape, scene)
    )
    if all(piece.box is not None for piece in pieces):
        return None
    pegs, sockets = ([make(shape, scene) for shape in shapes] for make in (peg_of, socket_of))
    if not any(shape.chamfer_m for shape in shapes):
        pegs = [peg._replace(tip=None) for peg in pegs]
    if not any(shape.socket.chamfer_m for shape in shapes):
        sockets = [socket._replace(mouth=None) for socket in sockets]
    each = [Outlines(*pair) for pair in product(_padded(pegs), _padded(sockets))]
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves), jnp.float32), *each)


def peg_of(shape: Shape, scene: SceneConfig) -> Peg:
    """Return a peg in its own frame, which hangs down; NumPy leaves."""
    figure = peg_outline(shape, scene)
    outline, tip = (_sides(figure, inset, hanging=True) for inset in (0.0, shape.chamfer_m))
    return Peg(outline, tip, np.asarray(scene.peg_length_m), np.asarray(shape.chamfer_m))


def socket_of(shape: Shape, scene: SceneConfig) -> Socket:
    """Return the socket of a part; NumPy leaves."""
    figure, chamfer = hole_outline(shape, scene), shape.socket.chamfer_m
    outline, mouth = (_sides(figure, -growth, hanging=False) for growth in (0.0, chamfer))
    depth = _BOTTOMLESS_M if shape.socket.through else scene.hole_depth_m
    return Socket(outline, mouth, *map(np.asarray, (depth, chamfer, scene.plate_half_width_m)))


def _sides(figure: MultiPolygon, inset_m: float, *, hanging: bool) -> Outline:
    """Return the sides of polygons, moved inwards; a spare side follows each ring."""
    starts, ends, before, after = [], [], [], []
    for polygon in figure.geoms:
        for ring in (polygon.exterior, *polygon.interiors):
            corners = inset_corners(np.asarray(ring.coords)[:-1], inset_m)
            corners = corners[::-1] * [1, -1] if hanging else corners
            first = corners[:1]
            starts += [corners, first]
            ends += [corners[1:], first, first]
            before += [corners[-1:], corners]
            after += [corners[2:], corners[:2], corners[1:2]]
    return Outline(*(np.concatenate(each).T for each in (starts, ends, before, after)))


def _padded(parts: list[Any]) -> list[Any]:
    """Give all outlines the same number of sides, by spare sides spread evenly after the real ones.

    Spread, they leave the real corners of a simple part in groups of their own: see ``prisms.thinned``.
    """
    n = math.prod(grouped(max(part.outline.start.shape[1] for part in parts)))

    def spread(leaf):
        return _spread(leaf, n) if isinstance(leaf, Outline) else leaf

    return [jax.tree.map(spread, part, is_leaf=lambda leaf: isinstance(leaf, Outline)) for part in parts]


def _spread(outline: Outline, n: int) -> Outline:
    """Insert spare sides at the ends of sides, n sides in all."""
    which = np.arange(n) * outline.start.shape[1] // n
    spare = np.diff(which, prepend=-1) == 0
    start, end, before, after = (leaf[:, which] for leaf in outline)
    return Outline(np.where(spare, end, start), end, np.where(spare, start, before), after)
