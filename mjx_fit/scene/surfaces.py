"""Surfaces of pegs and sockets that can touch: points along their edges, and their sections as half-planes.

They describe what a robot knows of its parts from drawings, in fixed shapes for JAX. A convex piece is the
intersection of half-planes n · p <= d with unit normals n, so that min (d - n · p) is the distance of a point
inside to the nearest side; a section is the union of its pieces, and their largest value counts.
"""

from functools import lru_cache

import numpy as np
import shapely
from jaxtyping import Bool, Float
from shapely import MultiPolygon

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.scene.decomposition import convex_pieces
from mjx_fit.scene.outline import grown, hole_outline, inset, peg_outline, rings_of
from mjx_fit.types import Array, pytree

FACET_M = 5e-5
"""Largest distance of a section's sides from those of the simulated part: fewer facets are quicker."""
SPACING_M = 4e-3
"""Largest distance between neighbouring points of an edge."""
_EVERYWHERE, _NOWHERE = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
"""Half-planes that fill up pieces, and pieces that fill up sections."""


@pytree
class Surfaces:
    """Surfaces of C parts about the axis of the tool, as the inserted peg is seen from above, m.

    Attributes:
        peg_points: Points along the edges of the peg's lower end: x, y, and the height above its lower face.
        peg_joins: Whether an edge goes on from a point to the next one.
        hole_points: Points along the edges of the socket: x, y, and the height above its upper face.
        peg_sides: Half-planes (n_x, n_y, d) of the pieces of the peg's section.
        face_sides: The same of its lower face, inside of the chamfer; None: no peg has one.
        mouth_sides: The same of the socket's mouth, on its upper face.
        hole_sides: The same of the hole below its chamfer; None: no socket has one.
        peg_chamfer: Width and height of the peg's chamfer.
        hole_chamfer: Width and height of the socket's chamfer.
    """

    peg_points: Float[Array, "*C P 3"]
    peg_joins: Bool[Array, "*C P"]
    hole_points: Float[Array, "*C Q 3"]
    peg_sides: Float[Array, "*C k s 3"]
    face_sides: Float[Array, "*C k s 3"] | None
    mouth_sides: Float[Array, "*C l t 3"]
    hole_sides: Float[Array, "*C l t 3"] | None
    peg_chamfer: Float[Array, "*C"]
    hole_chamfer: Float[Array, "*C"]


@lru_cache(maxsize=16)
def surfaces_of(scene: SceneConfig) -> Surfaces:
    """Return the surfaces of all parts of a scene."""
    shapes = scene.shapes
    pegs = [_simple(peg_outline(shape, scene)) for shape in shapes]
    holes = [_simple(hole_outline(shape, scene)) for shape in shapes]
    on_peg, on_hole = (
        [one.chamfer_m for one in ends] for ends in (shapes, [shape.socket for shape in shapes])
    )
    faces = [inset(one, by) for one, by in zip(pegs, on_peg, strict=True)]
    mouths = [grown(one, by) for one, by in zip(holes, on_hole, strict=True)]
    level, below = [0.0] * len(shapes), [-by for by in on_hole]
    return Surfaces(
        *_points([(faces, level), (pegs, on_peg)] if any(on_peg) else [(faces, level)]),
        _points([(mouths, level), (holes, below)] if any(on_hole) else [(mouths, level)], np.inf)[0],
        _sides(pegs),
        _sides(faces) if any(on_peg) else None,
        _sides(mouths),
        _sides(holes) if any(on_hole) else None,
        np.array(on_peg, np.float32),
        np.array(on_hole, np.float32),
    )


def _simple(figure: MultiPolygon) -> MultiPolygon:
    parts = [part.simplify(FACET_M) for part in figure.geoms]
    return MultiPolygon([part for part in parts if isinstance(part, shapely.Polygon)])


def _points(
    edges: list[tuple[list[MultiPolygon], list[float]]], spacing_m: float = SPACING_M
) -> tuple[Float[np.ndarray, "C n 3"], Bool[np.ndarray, "C n"]]:
    """Return the points along the edges of all parts, and which are joined to the next one.

    Repeated points fill up shorter lists.

    Args:
        edges: Outlines and heights of each edge, part by part.
        spacing_m: Largest distance between neighbouring points.
    """
    rings = [
        [ring for edge in edges for ring in _along(edge[0][i], edge[1][i], spacing_m)]
        for i in range(len(edges[0][0]))
    ]
    most = max(sum(map(len, one)) for one in rings)
    points, joins = np.zeros((len(rings), most, 3), np.float32), np.zeros((len(rings), most), bool)
    for i, one in enumerate(rings):
        points[i] = np.resize(np.concatenate(one), (most, 3))
        ends = np.cumsum([len(ring) for ring in one])
        joins[i, : ends[-1]] = True
        joins[i, ends - 1] = False
    return points, joins


def _along(figure: MultiPolygon, height_m: float, spacing_m: float) -> list[Float[np.ndarray, "n 3"]]:
    """Return the corners of each ring, closed, and points between them, at most this far apart."""
    rings = [shapely.get_coordinates(shapely.segmentize(ring, spacing_m)) for ring in rings_of(figure)]
    return [np.column_stack([xy, np.full(len(xy), height_m)]) for xy in rings]


def _sides(figures: list[MultiPolygon]) -> Float[np.ndarray, "C k s 3"]:
    """Return the half-planes of the convex pieces of all parts."""
    parts = [[_half_planes(corners) for corners in convex_pieces(figure)] for figure in figures]
    most, sides = max(map(len, parts)), max(len(piece) for pieces in parts for piece in pieces)
    filled = np.full((len(parts), most, sides, 3), _EVERYWHERE, np.float32)
    filled[:, :, 0] = _NOWHERE
    for part, pieces in enumerate(parts):
        for i, piece in enumerate(pieces):
            filled[part, i, : len(piece)] = piece
    return filled


def _half_planes(corners: Float[np.ndarray, "s 2"]) -> Float[np.ndarray, "s 3"]:
    corners = shapely.get_coordinates(shapely.Polygon(corners).simplify(0))[:-1]
    along = np.roll(corners, -1, 0) - corners
    normal = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    return np.column_stack([normal, (normal * corners).sum(1)])
