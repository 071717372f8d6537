"""Sections of pegs and holes as unions of convex pieces: half-planes and discs, in fixed shapes for JAX.

A convex piece is the intersection of half-planes n · p <= d with unit normals n, and of a disc where an arc
bounds it: many facets in one. So the least of d - n · p and R - |p - c| is the distance of a point inside to
the nearest side; a section is the union of its pieces, and their largest value counts.
"""

import numpy as np
import shapely
from jaxtyping import Bool, Float
from shapely import MultiPolygon

from mjx_fit.scene.decomposition import convex_pieces
from mjx_fit.types import Array, pytree

FACET_M = 5e-5
"""Largest distance of a section's sides from those of the simulated part: fewer facets are quicker."""
_EVERYWHERE, _NOWHERE = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
"""Half-planes that fill up pieces, and pieces that fill up sections; the first as a disc has no arc."""
_LEAST_FACETS = 6
"""Facets that a disc replaces at least."""
_ON_ARC_M = 1e-7
"""Distance from a circle of corners that lie on it."""


@pytree
class Section:
    """Sections of C parts, m.

    Attributes:
        sides: Half-planes (n_x, n_y, d) of each piece.
        discs: Disc (c_x, c_y, R) of each piece, which contains those without an arc; None: no piece has one.
    """

    sides: Float[Array, "*C k s 3"]
    discs: Float[Array, "*C k 3"] | None


def simple(figure: MultiPolygon) -> MultiPolygon:
    """Return a figure with fewer facets, up to ``FACET_M`` from it."""
    parts = [part.simplify(FACET_M) for part in figure.geoms]
    return MultiPolygon([part for part in parts if isinstance(part, shapely.Polygon)])


def sections_of(figures: list[MultiPolygon]) -> Section:
    """Return the sections of all parts."""
    parts = [[_bounds(corners) for corners in _pieces(figure)] for figure in figures]
    most = max(map(len, parts))
    sides = max(1, *(len(straight) for pieces in parts for straight, _ in pieces))
    filled = np.full((len(parts), most, sides, 3), _EVERYWHERE, np.float32)
    filled[:, :, 0] = _NOWHERE
    discs = np.full((len(parts), most, 3), _EVERYWHERE, np.float32)
    for part, pieces in enumerate(parts):
        for i, (straight, disc) in enumerate(pieces):
            filled[part, i, 0] = _EVERYWHERE
            filled[part, i, : len(straight)] = straight
            discs[part, i] = _EVERYWHERE if disc is None else disc
    return Section(filled, discs if np.any(discs != _EVERYWHERE) else None)


def _pieces(figure: MultiPolygon) -> list[Float[np.ndarray, "s 2"]]:
    """Return convex pieces with whole arcs; of fewer facets where that makes them fewer."""
    exact, fewer = convex_pieces(figure), convex_pieces(simple(figure))
    return fewer if len(fewer) < len(exact) else exact


def _bounds(
    corners: Float[np.ndarray, "s 2"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "3"] | None]:
    """Return the half-planes of a convex piece, and its disc, if an arc bounds it."""
    disc, facets = _arc(corners)
    if facets.sum() < _LEAST_FACETS:
        disc, corners = None, _simple_ring(corners, FACET_M)
        facets = np.zeros(len(corners), bool)
    ahead = np.roll(corners, -1, 0) - corners
    normal = np.column_stack([ahead[:, 1], -ahead[:, 0]]) / np.linalg.norm(ahead, axis=1)[:, None]
    return np.column_stack([normal, (normal * corners).sum(1)])[~facets], disc


def _simple_ring(corners: Float[np.ndarray, "s 2"], within_m: float) -> Float[np.ndarray, "n 2"]:
    return shapely.get_coordinates(shapely.Polygon(corners).simplify(within_m))[:-1]


def _arc(corners: Float[np.ndarray, "s 2"]) -> tuple[Float[np.ndarray, "3"], Bool[np.ndarray, "s"]]:
    """Return the disc that replaces most sides of a convex piece, and which sides those are.

    The disc goes through the sides, so that they are outside of it as much as inside.
    """
    best, replaced = np.array(_EVERYWHERE), np.zeros(len(corners), bool)
    length = np.linalg.norm(np.roll(corners, -1, 0) - corners, axis=1)
    for i in range(len(corners)):
        disc = _through(corners[i - 2], corners[i - 1], corners[i])
        if disc is None:
            continue
        away = np.linalg.norm(corners - disc[:2], axis=1) - disc[2]
        if away.max() > _ON_ARC_M:
            continue
        on = np.abs(away) < _ON_ARC_M
        rise = disc[2] - np.sqrt(np.maximum(disc[2] ** 2 - length**2 / 4, 0))
        facets = on & np.roll(on, -1) & (rise < 2 * FACET_M)
        if facets.sum() > replaced.sum():
            best, replaced = disc - [0, 0, 2 / 3 * rise[facets].mean()], facets
    return best, replaced


def _through(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Float[np.ndarray, "3"] | None:
    """Return the circle through three points; None if they lie on a line."""
    to_b, to_c = b - a, c - a
    double = 2 * (to_b[0] * to_c[1] - to_b[1] * to_c[0])
    if double == 0:
        return None
    square_b, square_c = to_b @ to_b, to_c @ to_c
    x = (to_c[1] * square_b - to_b[1] * square_c) / double
    y = (to_b[0] * square_c - to_c[0] * square_b) / double
    return np.array([a[0] + x, a[1] + y, np.hypot(x, y)])
