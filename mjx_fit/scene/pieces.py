"""Convex pieces of pegs and sockets, as horizontal polygons at two or three heights.

Pegs are given in the frame of the body ``peg``, sockets in the frame of their upper face; see
``mjx_fit.scene.parts``. Chamfers narrow a peg towards its tip and widen a hole towards its mouth.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float
from shapely import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.scene.decomposition import convex_lofts, convex_pieces, corners_of
from mjx_fit.scene.outline import PLATE_RIM_M, hole_outline, inset, peg_outline, rings_of
from mjx_fit.scene.parts import FLOOR_THICKNESS_M, Boxes, hole_boxes, peg_boxes

RING = 0.5
"""Width of the ring of pieces around a hole, as a share of the hole's larger extent; boxes lie beyond it."""
_ON_AXIS_M = 1e-9
_SPARE_HALF_M, _SPARE_IN_PRISM_M = 0.001, 0.00001


class Ring(NamedTuple):
    """Horizontal convex polygon.

    Attributes:
        corners: Corners, counter-clockwise, m.
        height_m: Height, m.
    """

    corners: Float[np.ndarray, "V 2"]
    height_m: float


@dataclass(frozen=True)
class Piece:
    """Convex hull of horizontal polygons: two make a prism, three a prism with a chamfered end.

    Attributes:
        rings: The polygons, from the lowest to the highest.
    """

    rings: tuple[Ring, ...]

    @property
    def corners(self) -> Float[np.ndarray, "n 3"]:
        """Corners of all polygons, m."""
        heights = np.repeat(
            [ring.height_m for ring in self.rings], [len(ring.corners) for ring in self.rings]
        )
        return np.column_stack([np.concatenate([ring.corners for ring in self.rings]), heights])

    @property
    def box(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]] | None:
        """Centre and half sizes, m, if the piece is a box along the axes."""
        first, *others = (ring.corners for ring in self.rings)
        if len(first) != 4 or not all(np.array_equal(first, other) for other in others):
            return None
        low, high = self.corners.min(0), self.corners.max(0)
        if (np.minimum(abs(first - low[:2]), abs(first - high[:2])) > _ON_AXIS_M).any():
            return None
        return (low + high) / 2, (high - low) / 2


MakePieces = Callable[[Shape, SceneConfig, float], list[Piece]]


def peg_pieces(shape: Shape, scene: SceneConfig, scale: float = 1.0) -> list[Piece]:
    """Divide a peg into convex pieces.

    Args:
        shape: The part.
        scene: Defines length and clearance.
        scale: Factor of the cross-section.
    """
    length, chamfer = scene.peg_length_m, shape.chamfer_m
    if shape.section is None and chamfer == 0:
        return _of_boxes(peg_boxes(shape, scene, scale))
    figure = peg_outline(shape, scene, scale)
    tip = inset(figure, chamfer)
    if not chamfer:
        found = _prisms(figure, 0.0, length)
    elif figure.convex_hull.equals(figure):
        rings = (corners_of(figure.geoms[0]), corners_of(tip.geoms[0]))
        found = [Piece((Ring(rings[0], 0.0), Ring(rings[0], length - chamfer), Ring(rings[1], length)))]
    else:
        start = length - chamfer
        narrowed = _lofts(figure, tip, start, length)
        found = _prisms(figure, 0.0, start)
        found += narrowed or [*_prisms(tip, start, length), *_wedges(figure, tip, start, length)]
    return [Piece(tuple(Ring(_hanging(ring.corners), ring.height_m) for ring in one.rings)) for one in found]


def socket_pieces(shape: Shape, scene: SceneConfig, scale: float = 1.0) -> list[Piece]:
    """Divide a socket into convex pieces: a floor, boxes far from the hole, and a ring around it.

    Args:
        shape: The part.
        scene: Defines clearance, depth and size of the socket.
        scale: Factor of the cross-section.
    """
    socket = shape.socket
    if shape.section is None and socket.section is None and not (socket.chamfer_m or socket.through):
        return _of_boxes(hole_boxes(shape, scene, scale))
    hole = hole_outline(shape, scene, scale)
    x0, y0, x1, y1 = hole.bounds
    width, depth = scene.plate_half_width_m, scene.hole_depth_m
    margin, most = RING * max(x1 - x0, y1 - y0) + socket.chamfer_m, width - PLATE_RIM_M / 2
    left, front = max(x0 - margin, -most), max(y0 - margin, -most)
    right, back = min(x1 + margin, most), min(y1 + margin, most)
    found = [
        _block(*ends, -depth, 0.0)
        for ends in (
            (-width, -width, left, width),
            (right, -width, width, width),
            (left, -width, right, front),
            (left, back, right, width),
        )
    ]
    if not socket.through:
        found.insert(0, _block(-width, -width, width, width, -depth - FLOOR_THICKNESS_M, -depth))
    around, top = shapely.box(left, front, right, back), -socket.chamfer_m
    found += _prisms(around.difference(hole), -depth, top)
    if socket.chamfer_m:
        mouth = inset(hole, -socket.chamfer_m)
        widened = _lofts(_outside(hole, around), _outside(mouth, around), top, 0.0)
        found += widened or [*_prisms(around.difference(mouth), top, 0.0), *_wedges(hole, mouth, top, 0.0)]
    return found


def padded(make: MakePieces, config: SceneConfig, scale: float = 1.0) -> list[list[Piece]]:
    """Divide all pegs, or all sockets, into the same number of pieces, by tiny spare boxes inside of others.

    Args:
        make: ``peg_pieces`` or ``socket_pieces``.
        config: Configuration of the scene.
        scale: Factor of the cross-sections.
    """
    parts = [make(shape, config, scale) for shape in config.shapes]
    n = max(len(pieces) for pieces in parts)
    return [[*pieces, *[_spare(pieces[-1])] * (n - len(pieces))] for pieces in parts]


def _spare(piece: Piece) -> Piece:
    """Return a tiny box in the middle of a piece, where nothing can touch it."""
    if piece.box is None:
        centre, half = piece.corners.mean(0), np.full(3, _SPARE_IN_PRISM_M)
    else:
        centre, half = piece.box
        half = np.minimum(half, _SPARE_HALF_M)
    return _of_boxes(Boxes((centre - half)[None], (centre + half)[None]))[0]


def _of_boxes(boxes: Boxes) -> list[Piece]:
    return [
        _block(low[0], low[1], high[0], high[1], low[2], high[2])
        for low, high in zip(boxes.low, boxes.high, strict=True)
    ]


def _prisms(figure: BaseGeometry, low_m: float, high_m: float) -> list[Piece]:
    return [Piece((Ring(corners, low_m), Ring(corners, high_m))) for corners in convex_pieces(figure)]


def _lofts(figure: MultiPolygon, moved: MultiPolygon, low_m: float, high_m: float) -> list[Piece] | None:
    """Return the material between polygons and their moved selves; None: it has no convex pieces of both."""
    pairs = convex_lofts(figure, moved)
    return [Piece((Ring(low, low_m), Ring(high, high_m))) for low, high in pairs] if pairs else None


def _outside(hole: MultiPolygon, around: Polygon) -> MultiPolygon:
    """Return the material around a hole, with its corners in the order of the hole's."""
    pins = [Polygon(ring) for part in hole.geoms for ring in part.interiors]
    return MultiPolygon([Polygon(around.exterior, [part.exterior for part in hole.geoms]), *pins])


def _wedges(figure: MultiPolygon, moved: MultiPolygon, low_m: float, high_m: float) -> list[Piece]:
    """Return the material under a chamfer: one wedge for each side of an outline and its moved self."""
    return [
        Piece((Ring(np.array([a, b, d, c]), low_m), Ring(np.array([c, d]), high_m)))
        for ring, other in zip(rings_of(figure), rings_of(moved), strict=True)
        for (a, b), (c, d) in zip(pairwise(ring.coords), pairwise(other.coords), strict=True)
    ]


def _block(x0: float, y0: float, x1: float, y1: float, low_m: float, high_m: float) -> Piece:
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)
    return Piece((Ring(corners, low_m), Ring(corners, high_m)))


def _hanging(corners: Float[np.ndarray, "V 2"]) -> Float[np.ndarray, "V 2"]:
    """Mirror corners into the frame of the peg, which hangs down, and keep them counter-clockwise."""
    return corners[::-1] * [1, -1]
