"""Surfaces of pegs and sockets that can touch: points along their edges, and their sections.

They describe what a robot knows of its parts from drawings, in fixed shapes for JAX.
"""

from functools import lru_cache

import numpy as np
import shapely
from jaxtyping import Bool, Float
from shapely import MultiPolygon

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.scene.outline import grown, hole_outline, inset, peg_outline, rings_of
from mjx_fit.scene.sections import Section, sections_of, simple
from mjx_fit.types import Array, pytree

SPACING_M = 4e-3
"""Largest distance between neighbouring points of an edge."""


@pytree
class Surfaces:
    """Surfaces of C parts about the axis of the tool, as the inserted peg is seen from above, m.

    Attributes:
        peg_points: Points along the edges of the peg's lower end: x, y, and the height above its lower face.
        peg_joins: Whether an edge goes on from a point to the next one.
        hole_points: Points along the edges of the socket: x, y, and the height above its upper face.
        peg: The peg's section.
        face: That of its lower face, inside of the chamfer; None: no peg has one.
        mouth: That of the socket's mouth, on its upper face.
        hole: That of the hole below its chamfer; None: no socket has one.
        peg_chamfer: Width and height of the peg's chamfer.
        hole_chamfer: Width and height of the socket's chamfer.
    """

    peg_points: Float[Array, "*C P 3"]
    peg_joins: Bool[Array, "*C P"]
    hole_points: Float[Array, "*C Q 3"]
    peg: Section
    face: Section | None
    mouth: Section
    hole: Section | None
    peg_chamfer: Float[Array, "*C"]
    hole_chamfer: Float[Array, "*C"]


@lru_cache(maxsize=16)
def surfaces_of(scene: SceneConfig) -> Surfaces:
    """Return the surfaces of all parts of a scene."""
    shapes = scene.shapes
    pegs = [peg_outline(shape, scene) for shape in shapes]
    holes = [hole_outline(shape, scene) for shape in shapes]
    on_peg, on_hole = (
        [one.chamfer_m for one in ends] for ends in (shapes, [shape.socket for shape in shapes])
    )
    faces = [inset(one, by) for one, by in zip(pegs, on_peg, strict=True)]
    mouths = [grown(one, by) for one, by in zip(holes, on_hole, strict=True)]
    level, below = [0.0] * len(shapes), [-by for by in on_hole]
    return Surfaces(
        *_points([(faces, level), (pegs, on_peg)] if any(on_peg) else [(faces, level)]),
        _points([(mouths, level), (holes, below)] if any(on_hole) else [(mouths, level)], np.inf)[0],
        sections_of(pegs),
        sections_of(faces) if any(on_peg) else None,
        sections_of(mouths),
        sections_of(holes) if any(on_hole) else None,
        np.array(on_peg, np.float32),
        np.array(on_hole, np.float32),
    )


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
    rings = [
        shapely.get_coordinates(shapely.segmentize(ring, spacing_m)) for ring in rings_of(simple(figure))
    ]
    return [np.column_stack([xy, np.full(len(xy), height_m)]) for xy in rings]
