"""Convex pieces of polygons: the triangles of a library's triangulation, merged while they stay convex.

Reference: Hertel and Mehlhorn, Fast triangulation of simple polygons, 1983: at most four times as many pieces
as necessary.
"""

from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Float
from shapely.geometry.base import BaseGeometry

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
    triangles = shapely.constrained_delaunay_triangles(figure).geoms
    corners, index = np.unique(
        np.concatenate([corners_of(one) for one in triangles]),
        axis=0,
        return_inverse=True,
    )
    return [corners[piece] for piece in _merged([list(one) for one in index.reshape(-1, 3)], corners)]


def corners_of(polygon: BaseGeometry) -> Float[np.ndarray, "V 2"]:
    """Return the corners of a polygon without holes, counter-clockwise, m."""
    return shapely.get_coordinates(shapely.orient_polygons(polygon))[:-1]


def _merged(pieces: list[_Piece], corners: Float[np.ndarray, "n 2"]) -> list[_Piece]:
    """Merge neighbours over their common edge, the longest first."""
    owner = {edge: i for i, piece in enumerate(pieces) for edge in _edges(piece)}
    inner = [(a, b) for a, b in owner if a < b and (b, a) in owner]
    alive = dict(enumerate(pieces))
    for a, b in sorted(inner, key=lambda edge: -float(np.linalg.norm(corners[edge[0]] - corners[edge[1]]))):
        one, other = owner[a, b], owner[b, a]
        joined = _joined(alive[one], alive[other], a, b)
        if one == other or not _is_convex(corners[joined]):
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
