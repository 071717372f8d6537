"""Conversion of cross-sections to boxes: those of a peg, and those of a square socket around its hole.

A box is ``(centre, half)``, both (3,) in metres. Pegs are given in the frame of the body ``peg``: its origin
is on the sensor's face, its z axis points along the tool to the TCP. Sockets are given in the frame of their
upper face, z up. The tool points down with its x axis along the world's, so its y axis is opposite to the
world's: in the tool frame a peg is the mirror image of its shape, which is drawn as inserted in the hole.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape

FLOOR_THICKNESS_M = 0.01
HANGING = np.array([1.0, -1.0, -1.0])
"""Signs that convert coordinates in the frame of the body ``peg`` to world axes."""


@dataclass(frozen=True)
class Boxes:
    """Axis-aligned boxes.

    Attributes:
        low: Lower corners (n, 3), m.
        high: Upper corners (n, 3), m.
    """

    low: Float[np.ndarray, "n 3"]
    high: Float[np.ndarray, "n 3"]

    @property
    def centre(self) -> Float[np.ndarray, "n 3"]:
        """Centres, m."""
        return (self.low + self.high) / 2

    @property
    def half(self) -> Float[np.ndarray, "n 3"]:
        """Half sizes, m."""
        return (self.high - self.low) / 2


def plate_top_m(scene: SceneConfig) -> float:
    """Height of the socket's upper face above the table, m."""
    return scene.hole_depth_m + FLOOR_THICKNESS_M


def start_tip_m(scene: SceneConfig) -> float:
    """Return the height of the TCP at the start of an attempt, m."""
    return plate_top_m(scene) + scene.start_height_m


def peg_boxes(shape: Shape, scene: SceneConfig, scale: float = 1.0) -> Boxes:
    """Create the boxes of a peg, one per rectangle, in the frame of the body ``peg``.

    Args:
        shape: Cross-section.
        scene: Defines the length.
        scale: Factor of the cross-section.
    """
    rectangles = _scaled(shape, scale)
    low = [[x0, -y1, 0.0] for x0, _, _, y1 in rectangles]
    high = [[x1, -y0, scene.peg_length_m] for _, y0, x1, _ in rectangles]
    return Boxes(np.array(low), np.array(high))


def hole_boxes(shape: Shape, scene: SceneConfig, scale: float = 1.0) -> Boxes:
    """Create the boxes of a socket whose hole is wider than the peg by the clearance on every side.

    The boxes are a floor, four walls around the hole's bounding rectangle, and the part of that rectangle
    outside the hole. Together they fill the socket except for the hole, without overlap.

    Args:
        shape: Cross-section of the peg.
        scene: Defines clearance, depth and size of the socket.
        scale: Factor of the cross-section.
    """
    gap, width, bottom = scene.clearance_of(shape), scene.plate_half_width_m, -scene.hole_depth_m
    open_ = [(x0 - gap, y0 - gap, x1 + gap, y1 + gap) for x0, y0, x1, y1 in _scaled(shape, scale)]
    left, front = (min(rectangle[i] for rectangle in open_) for i in (0, 1))
    right, back = (max(rectangle[i] for rectangle in open_) for i in (2, 3))
    low = [
        [-width, -width, bottom - FLOOR_THICKNESS_M],
        [-width, -width, bottom],
        [right, -width, bottom],
        [left, -width, bottom],
        [left, back, bottom],
    ]
    high = [
        [width, width, bottom],
        [left, width, 0],
        [width, width, 0],
        [right, front, 0],
        [right, width, 0],
    ]
    for x0, y0, x1, y1 in _left_over(open_):
        low.append([x0, y0, bottom])
        high.append([x1, y1, 0])
    return Boxes(np.array(low, float), np.array(high, float))


def _scaled(shape: Shape, scale: float) -> list["_Rectangle"]:
    return [(scale * x0, scale * y0, scale * x1, scale * y1) for x0, y0, x1, y1 in shape.rectangles]


_SLIVER_M = 1e-6
"""Thinner strips are rounding errors, not parts of a shape."""
_Rectangle = tuple[float, float, float, float]


def _left_over(open_: list[_Rectangle]) -> list[_Rectangle]:
    """Return the uncovered part of the rectangles' bounding rectangle, in strips along y."""
    xs = sorted({edge for x0, _, x1, _ in open_ for edge in (x0, x1)})
    ys = sorted({edge for _, y0, _, y1 in open_ for edge in (y0, y1)})
    found: list[_Rectangle] = []
    for x0, x1 in pairwise(xs):
        if x1 - x0 < _SLIVER_M:
            continue
        strip: list[_Rectangle] = []
        for y0, y1 in pairwise(ys):
            if y1 - y0 < _SLIVER_M or any(a < x1 and x0 < c and b < y1 and y0 < d for a, b, c, d in open_):
                continue
            if strip and strip[-1][3] == y0:
                strip[-1] = (x0, strip[-1][1], x1, y1)
            else:
                strip.append((x0, y0, x1, y1))
        found += strip
    return found
