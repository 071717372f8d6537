"""Convex pieces of polygons: the triangles of a library's triangulation, merged while they stay convex.

Reference: Hertel and Mehlhorn, Fast triangulation of simple polygons, 1983: at most four times as many pieces
as necessary.
"""

from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Float
from shapely import MultiPolygon
from shapely.geometry.base import BaseGeometry

from mjx_fit.scene.outline import rings_of

FLAT = 1e-9
"""Largest sine of an angle at which a merged piece may turn inwards, by rounding."""
_Piece = list[int]


def convex_pieces(figure: BaseGeometry) -> list[Float[np.ndarray, "V 2"]]:
    """Divide polygons into convex pieces without overlap.

    Args:
        figure: Polygon or polygons, with or without holes, m.

    Returns:
        Corners of each piece, counter-clockwise.
    """
    corners, triangles = _triangles(figure)
    return [corners[piece] for piece in _merged(triangles, [corners])]


def convex_lofts(
    figure: MultiPolygon, moved: MultiPolygon
) -> list[tuple[Float[np.ndarray, "V 2"], Float[np.ndarray, "V 2"]]] | None:
    """Divide polygons and a copy with moved corners alike, so that both pieces of a pair are convex.

    Args:
        figure: Valid polygons, m.
        moved: The same polygons with every corner moved, m.

    Returns:
        Corresponding corners of each pair of pieces; None: polygons are not valid, share a corner, or have a
        triangle that the move turns over.
    """
    own, others = (
        np.concatenate([np.asarray(ring.coords)[:-1] for ring in rings_of(one)]) for one in (figure, moved)
    )
    if not (figure.is_valid and moved.is_valid):
        return None
    place = {tuple(corner): i for i, corner in enumerate(own)}
    corners, triangles = _triangles(figure)
    if len(place) < len(own) or len(corners) < len(own):
        return None
    there = others[[place[tuple(corner)] for corner in corners]]
    if not all(_is_convex(there[one]) for one in triangles):
        return None
    return [(corners[piece], there[piece]) for piece in _merged(triangles, [corners, there])]


def _triangles(figure: BaseGeometry) -> tuple[Float[np.ndarray, "n 2"], list[_Piece]]:
    """Return the corners of polygons, and the triangles between them, counter-clockwise."""
    triangles = shapely.constrained_delaunay_triangles(figure).geoms
    corners, index = np.unique(
        np.concatenate([corners_of(one) for one in triangles]), axis=0, return_inverse=True
    )
    return corners, [list(one) for one in index.reshape(-1, 3)]


def corners_of(polygon: BaseGeometry) -> Float[np.ndarray, "V 2"]:
    """Return the corners of a polygon without holes, counter-clockwise, m."""
    return shapely.get_coordinates(shapely.orient_polygons(polygon))[:-1]


def _merged(pieces: list[_Piece], places: list[Float[np.ndarray, "n 2"]]) -> list[_Piece]:
    """Merge neighbours over their common edge, the longest first, if they are convex in all places."""
    corners = places[0]
    owner = {edge: i for i, piece in enumerate(pieces) for edge in _edges(piece)}
    inner = [(a, b) for a, b in owner if a < b and (b, a) in owner]
    alive = dict(enumerate(pieces))
    for a, b in sorted(inner, key=lambda edge: -float(np.linalg.norm(corners[edge[0]] - corners[edge[1]]))):
        one, other = owner[a, b], owner[b, a]
        joined = _joined(alive[one], alive[other], a, b)
        if one == other or not all(_is_convex(place[joined]) for place in places):
            continue
        alive[one] = joined
        del alive[other]
        owner.update(dict.fromkeys(_edges(joined), one))
    return list(alive.values())


def _edges(piece: _Piece) -> list[tuple[int, int]]:
    return list(pairwise([*piece, piece[0]]))


def _joined(one: _Piece, other: _Piece, a: int, b: int) -> _Piece:
    """Return the corners of two pieces without their common edge, which is (a, b) in the first."""
    i, j = one.index(b), other.index(a)
    return one[i:] + one[:i] + (other[j:] + other[:j])[1:-1]


def _is_convex(corners: Float[np.ndarray, "V 2"]) -> bool:
    step = np.roll(corners, -1, 0) - corners
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    following = np.roll(step, -1, 0)
    return bool((step[:, 0] * following[:, 1] - step[:, 1] * following[:, 0] >= -FLAT).all())
