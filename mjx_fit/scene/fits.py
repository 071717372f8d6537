"""Which peg fits which socket, by geometry: the peg's section inside the hole's, moved or turned."""

import math
from functools import lru_cache
from typing import cast

import numpy as np
import shapely
from jaxtyping import Bool
from shapely import MultiPolygon
from shapely.affinity import rotate

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.scene.decomposition import convex_pieces
from mjx_fit.scene.outline import hole_outline, peg_outline

ROOM_M = 1e-7
"""A peg needs this much room: without it the sections touch."""
TURNED_ROOM_M = 2e-6
"""A peg that is turned needs this much room."""
_FIRST_YAWS = 32


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
    slack = np.array(hole.bounds).reshape(2, 2) - np.array(peg.bounds).reshape(2, 2)
    (low_x, low_y), (high_x, high_y) = slack
    if peg.area > hole.area or low_x > high_x or low_y > high_y:
        return False
    positions = shapely.box(low_x, low_y, high_x, high_y)
    reach = np.ptp(np.array(peg.bounds).reshape(2, 2), axis=0).max()
    wall = shapely.box(*hole.bounds).buffer(reach, join_style="mitre").difference(hole)
    hits = [
        shapely.MultiPoint((w[:, None] - p[None]).reshape(-1, 2)).convex_hull
        for w in convex_pieces(wall)
        for p in convex_pieces(peg)
    ]
    return not positions.buffer(ROOM_M).difference(shapely.union_all(hits)).buffer(-ROOM_M).is_empty


def fits_turned(peg: MultiPolygon, hole: MultiPolygon) -> bool:
    """Check whether a peg fits a hole at some position and yaw.

    Turned by less than an angle, no point moves further than the angle times its distance from the centre. So
    a range of yaws is ruled out if the peg, thinner by that much all around, does not fit in its middle. The
    others are halved until a peg fits, or until what is cut off is less than ``TURNED_ROOM_M``.
    """
    if peg.area > hole.area or _inner_radius(peg) > _inner_radius(hole) + TURNED_ROOM_M:
        return False
    centre = peg.centroid
    radius_m = shapely.hausdorff_distance(peg.boundary, centre)
    half = math.pi / _FIRST_YAWS
    yaws = 2 * half * np.arange(_FIRST_YAWS)
    while len(yaws) and half * radius_m > TURNED_ROOM_M:
        thinner = peg.buffer(-half * radius_m, join_style="mitre")
        kept = []
        for yaw in yaws:
            whole, less = (
                cast(MultiPolygon, rotate(one, yaw, origin=centre, use_radians=True))
                for one in (peg, thinner)
            )
            if fits(whole, hole):
                return True
            if less.is_empty or fits(less, hole):
                kept.append(yaw)
        half /= 2
        yaws = np.add.outer(kept, [-half, half]).ravel()
    return False


def _inner_radius(figure: MultiPolygon) -> float:
    """Return the radius of the largest circle inside, m, to within half of ``TURNED_ROOM_M``."""
    return shapely.maximum_inscribed_circle(figure, TURNED_ROOM_M / 2).length
