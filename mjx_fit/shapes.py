"""The catalogue of pegs and holes: a shape is a set of boxes, its hole the complement in a square plate.

A box is ``(centre, half)``, both (3,) in metres. Pegs are given in the frame of the body ``peg``: its origin
is the sensor's face, its z points along the tool to the tip. Hole boxes are given in the frame of the plate's
upper face, z up.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mjx_fit.config import SceneConfig

FLOOR_THICKNESS_M = 0.01


@dataclass(frozen=True)
class Shape:
    """A prism: the union of centred rectangles, extruded.

    Attributes:
        name: What it is called in files and figures.
        rectangles: Half sizes (x, y) of each rectangle, m.
    """

    name: str
    rectangles: tuple[tuple[float, float], ...]


SHAPES = (
    Shape("cross", ((0.020, 0.010), (0.010, 0.020))),
    Shape("rectangle", ((0.020, 0.0125),)),
    Shape("square", ((0.015, 0.015),)),
)
NAMES = tuple(shape.name for shape in SHAPES)


@dataclass(frozen=True)
class Boxes:
    """Axis-aligned boxes.

    Attributes:
        centre: (n, 3), m.
        half: Half sizes (n, 3), m.
    """

    centre: Float[np.ndarray, "n 3"]
    half: Float[np.ndarray, "n 3"]

    @staticmethod
    def between(low: list, high: list) -> "Boxes":
        """Boxes that reach from the corners ``low`` to the corners ``high``, both (n, 3)."""
        low_, high_ = np.asarray(low, float), np.asarray(high, float)
        return Boxes((low_ + high_) / 2, (high_ - low_) / 2)


def plate_top_m(scene: SceneConfig) -> float:
    """Height of the plate's upper face over the table."""
    return scene.hole_depth_m + FLOOR_THICKNESS_M


def peg_boxes(shape: Shape, scene: SceneConfig) -> Boxes:
    """The boxes of a peg, one for each rectangle, in the frame of the body ``peg``."""
    low = [[-a, -b, 0.0] for a, b in shape.rectangles]
    high = [[a, b, scene.peg_length_m] for a, b in shape.rectangles]
    return Boxes.between(low, high)


def hole_boxes(shape: Shape, scene: SceneConfig) -> Boxes:
    """The boxes of a plate with a hole that is wider than the peg by the clearance on every side.

    A floor, four walls around the hole's bounding rectangle and, for a shape that does not fill it, the four
    corners that it leaves. Together they fill the plate but for the hole, and do not overlap.
    """
    gap, width, bottom = scene.clearance_m, scene.plate_half_width_m, -scene.hole_depth_m
    sides = np.asarray(shape.rectangles) + gap
    a, b = sides.max(0)
    low = [
        [-width, -width, bottom - FLOOR_THICKNESS_M],
        [-width, -width, bottom],
        [a, -width, bottom],
        [-a, -width, bottom],
        [-a, b, bottom],
    ]
    high = [[width, width, bottom], [-a, width, 0], [width, width, 0], [a, -b, 0], [a, width, 0]]
    if len(shape.rectangles) == 2:
        c, d = sides.min(0)
        for x0, x1 in ((-a, -c), (c, a)):
            for y0, y1 in ((-b, -d), (d, b)):
                low.append([x0, y0, bottom])
                high.append([x1, y1, 0])
    return Boxes.between(low, high)
