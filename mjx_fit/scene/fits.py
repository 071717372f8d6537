"""Which peg fits which socket, by geometry: the peg's section inside the hole's, moved or turned."""

import math
from functools import lru_cache

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
_ALONG = 12
"""Number of longest sides whose directions are compared for turned pegs."""


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

    A peg that fits tightly has a side along a side of the hole: the yaws tried are those at which one of the
    longest sides of either is parallel to one of the other.
    """
    if peg.area > hole.area:
        return False
    one, other = _directions(peg), _directions(hole)
    yaws = {round(math.degrees(there - here) % 360, 6) for here in one for there in other}
    return any(fits(rotate(peg, yaw, origin=(0, 0)), hole) for yaw in sorted(yaws))


def _directions(figure: MultiPolygon) -> list[float]:
    """Return the directions of the longest sides, rad."""
    steps = [
        np.diff(np.asarray(ring.coords) @ [1, 1j])
        for part in figure.geoms
        for ring in (part.exterior, *part.interiors)
    ]
    longest = sorted(np.concatenate(steps), key=abs, reverse=True)[:_ALONG]
    return [float(np.angle(step)) for step in longest]
