"""Cross-sections of pegs and holes."""

from itertools import pairwise
from typing import Annotated

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import STRICT

Metres = Annotated[float, Field(ge=-0.03, le=0.03, json_schema_extra={"unit": "m"})]
Corners = tuple[Metres, Metres, Metres, Metres]
LEAST_SIDE_M = 0.001
"""Shortest side of a rectangle: thinner parts would bend, and the simulated bodies are rigid."""


@dataclass(frozen=True, config=STRICT)
class Shape:
    """Cross-section of an extruded peg as a union of rectangles; its hole adds the clearance on every side.

    Example:
        >>> import mjx_fit as mf
        >>> mf.Shape("slot", ((-0.02, -0.005, 0.02, 0.005),)).half_width_m
        0.02

    Attributes:
        name: Name in files and figures.
        rectangles: Lower and upper corner (x, y, x, y) of each rectangle, in m from the tool axis, along the
            world axes, as the inserted peg is seen from above. Rectangles may be disjoint, like the prongs of
            a plug.
    """

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]
    rectangles: Annotated[tuple[Corners, ...], Field(min_length=1, max_length=4)]

    @model_validator(mode="after")
    def _corners_in_order(self) -> "Shape":
        for x0, y0, x1, y1 in self.rectangles:
            if min(x1 - x0, y1 - y0) < LEAST_SIDE_M:
                raise ValueError(
                    f"rectangles: {[x0, y0, x1, y1]} is invalid in {self.name!r}: expected a lower "
                    f"and an upper corner, and no side shorter than {LEAST_SIDE_M}"
                )
        return self

    @property
    def half_width_m(self) -> float:
        """Half the side of the bounding square centred on the axis; pegs and sockets are never rotated."""
        return max(abs(edge) for rectangle in self.rectangles for edge in rectangle)

    def covers(self, x: float, y: float) -> bool:
        """Check whether a point, in m from the axis, lies in the shape."""
        return any(x0 <= x <= x1 and y0 <= y <= y1 for x0, y0, x1, y1 in self.rectangles)

    @property
    def is_its_own_mirror_image(self) -> bool:
        """True if the shape is symmetric about the plane y = 0."""
        xs = sorted({edge for x0, _, x1, _ in self.rectangles for edge in (x0, x1)})
        ys = sorted({edge for _, y0, _, y1 in self.rectangles for edge in (y0, y1, -y0, -y1)})
        middles = [((a + b) / 2, (c + d) / 2) for a, b in pairwise(xs) for c, d in pairwise(ys)]
        return all(self.covers(x, y) == self.covers(x, -y) for x, y in middles)


SHAPES = (
    Shape("cross", ((-0.020, -0.010, 0.020, 0.010), (-0.010, -0.020, 0.010, 0.020))),
    Shape("rectangle", ((-0.020, -0.0125, 0.020, 0.0125),)),
    Shape("square", ((-0.015, -0.015, 0.015, 0.015),)),
)
