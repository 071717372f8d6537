"""Which peg fits which socket, by geometry: the peg's section inside the hole's, moved or turned."""

import math
from functools import lru_cache
from typing import cast

import numpy as np
import shapely
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from shapely import MultiPolygon
from shapely.affinity import translate

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.scene.decomposition import convex_pieces
from mjx_fit.scene.outline import hole_outline, peg_outline, rings_of

ROOM_M = 1e-7
"""A peg needs this much room: without it the sections touch."""
TURNED_ROOM_M = 2e-6
"""A peg that is turned needs this much room."""
_FIRST_YAWS = 32
ROUND_FROM = 12
"""Fewest facets of a circle."""

Pieces = list[Float[np.ndarray, "V 2"]]
"""Corners of convex polygons, m."""


@lru_cache(maxsize=16)
def fitting(scene: SceneConfig, *, turned: bool = False) -> Bool[np.ndarray, "C C"]:
    """Tell for each peg (row) and socket (column) whether the peg can enter.

    Args:
        scene: Configuration with the parts.
        turned: True: at any yaw; False: at the yaw of the configuration.
    """
    pegs = [peg_outline(shape, scene) for shape in scene.shapes]
    holes = [hole_outline(shape, scene) for shape in scene.shapes]
    test = fits_turned if turned else fits
    found = np.array([[test(peg, hole) for hole in holes] for peg in pegs])
    found.flags.writeable = False  # shared by all callers
    return found


def fits(peg: MultiPolygon, hole: MultiPolygon) -> bool:
    """Check whether a peg fits a hole at some position, without turning.

    The positions at which it hits a wall are the Minkowski sum of the wall and the mirrored peg; the sum of
    convex pieces is the hull of the sums of their corners.
    """
    return peg.area <= hole.area and _enters(convex_pieces(peg), _wall(hole, _extent(peg)), hole)


def _enters(peg: Pieces, wall: Pieces, hole: MultiPolygon) -> bool:
    corners = np.concatenate(peg)
    x0, y0, x1, y1 = hole.bounds
    (low_x, low_y), (high_x, high_y) = (x0, y0) - corners.min(0), (x1, y1) - corners.max(0)
    if low_x > high_x or low_y > high_y:
        return False
    positions = shapely.box(low_x, low_y, high_x, high_y)
    hits = [shapely.MultiPoint((w[:, None] - p[None]).reshape(-1, 2)).convex_hull for w in wall for p in peg]
    return not positions.buffer(ROOM_M).difference(shapely.union_all(hits)).buffer(-ROOM_M).is_empty


def _wall(hole: MultiPolygon, reach_m: float) -> Pieces:
    """Divide the material around a hole, as far as a peg in it reaches."""
    return convex_pieces(shapely.box(*hole.bounds).buffer(reach_m, join_style="mitre").difference(hole))


def fits_turned(peg: MultiPolygon, hole: MultiPolygon) -> bool:
    """Check whether a peg fits a hole at some position and yaw.

    Turned by less than an angle, no point moves further than the angle times its distance from the centre. So
    a range of yaws is ruled out if the peg, thinner by that much all around, does not fit in its middle. The
    others are halved until a peg fits, or until what is cut off is less than ``TURNED_ROOM_M``. Yaws that the
    symmetries of peg and hole make alike are tried once.
    """
    if peg.area > hole.area or _inner_radius(peg) > _inner_radius(hole) + TURNED_ROOM_M:
        return False
    if shapely.minimum_bounding_radius(peg) > shapely.minimum_bounding_radius(hole):
        return False
    centred = cast(MultiPolygon, translate(peg, -peg.centroid.x, -peg.centroid.y))
    radius_m = shapely.hausdorff_distance(centred.boundary, shapely.Point(0, 0))
    wall, pieces = _wall(hole, 2 * radius_m), convex_pieces(centred)
    period = 2 * math.pi / math.lcm(symmetry(centred), symmetry(hole))
    first = math.ceil(_FIRST_YAWS * period / (2 * math.pi))
    half = period / first / 2
    yaws = 2 * half * np.arange(first)
    while len(yaws) and half * radius_m > TURNED_ROOM_M:
        thinner = centred.buffer(-half * radius_m, join_style="mitre")
        less = [] if thinner.is_empty else convex_pieces(thinner)
        kept = []
        for yaw in yaws:
            if _enters(_turned(pieces, yaw), wall, hole):
                return True
            if not less or _enters(_turned(less, yaw), wall, hole):
                kept.append(yaw)
        half /= 2
        yaws = np.add.outer(kept, [-half, half]).ravel()
    return False


def _turned(pieces: Pieces, yaw: float) -> Pieces:
    cos, sin = math.cos(yaw), math.sin(yaw)
    return [piece @ np.array([[cos, sin], [-sin, cos]]) for piece in pieces]


def is_round(figure: MultiPolygon) -> bool:
    """Return whether a figure is bounded by circles about its centre, as facets draw them."""
    centre = shapely.get_coordinates(figure.centroid)
    radii = [np.linalg.norm(shapely.get_coordinates(ring) - centre, axis=1) for ring in rings_of(figure)]
    return all(len(r) > ROUND_FROM and np.ptp(r) < ROOM_M for r in radii)


def symmetry(figure: MultiPolygon) -> int:
    """Return how many yaws leave a figure as it is."""
    corners = np.unique(shapely.get_coordinates(figure), axis=0) - shapely.get_coordinates(figure.centroid)
    tree = KDTree(corners)
    for n in range(len(corners), 1, -1):
        if len(corners) % n == 0:
            (turned,) = _turned([corners], 2 * math.pi / n)
            if np.asarray(tree.query(turned)[0]).max() < ROOM_M:
                return n
    return 1


def _extent(figure: MultiPolygon) -> float:
    return float(np.ptp(np.array(figure.bounds).reshape(2, 2), axis=0).max())


def _inner_radius(figure: MultiPolygon) -> float:
    """Return the radius of the largest circle inside, m, to within half of ``TURNED_ROOM_M``."""
    return shapely.maximum_inscribed_circle(figure, TURNED_ROOM_M / 2).length
