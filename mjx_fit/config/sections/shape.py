"""Cross-sections of pegs and holes."""

from typing import Annotated

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.cross_section import CrossSection
from mjx_fit.config.sections.fields import STRICT

Metres = Annotated[float, Field(ge=-0.03, le=0.03, json_schema_extra={"unit": "m"})]
Corners = tuple[Metres, Metres, Metres, Metres]
LEAST_SIDE_M = 0.001
"""Shortest side of a rectangle: thinner parts would bend, and the simulated bodies are rigid."""


NAME, LONGEST_NAME = r"^[a-z][a-z0-9_]*$", 40
Chamfer = Annotated[float, Field(ge=0, le=0.005, json_schema_extra={"unit": "m"})]


@dataclass(frozen=True, config=STRICT)
class Socket:
    """Socket of a part, if it differs from the part grown by the clearance.

    Attributes:
        section: Cross-section of the hole; null: the part's, grown by the clearance.
        chamfer_m: Width and height of the chamfer around its mouth, at 45°.
        through: True for a hole without a floor.
    """

    section: CrossSection | None = None
    chamfer_m: Chamfer = 0.0
    through: bool = False


@dataclass(frozen=True, config=STRICT)
class Shape:
    """Cross-section of an extruded peg, and its socket; either ``rectangles`` or ``section`` is given.

    Example:
        >>> import mjx_fit as mf
        >>> mf.Shape("slot", ((-0.02, -0.005, 0.02, 0.005),)).half_width_m
        0.02

    Attributes:
        name: Name in files and figures.
        rectangles: Lower and upper corner (x, y, x, y) of each rectangle, in m from the tool axis, along the
            world axes, as the inserted peg is seen from above. Rectangles may be disjoint, like the prongs of
            a plug.
        section: Figure with arcs, sloping sides or holes.
        clearance_m: Gap between peg and hole per side; null: ``scene.clearance_m``.
        facet_error: Error of facets over the clearance: flat facets replace arcs, and the gap between peg and
            socket errs by at most this share, half of it by either.
        chamfer_m: Width and height of the chamfer around the tip, at 45°.
        socket: What differs in the socket.
    """

    name: Annotated[str, Field(pattern=NAME, max_length=LONGEST_NAME)]
    rectangles: Annotated[tuple[Corners, ...], Field(max_length=4)] = ()
    section: CrossSection | None = None
    clearance_m: Annotated[float, Field(ge=0.00005, le=0.005, json_schema_extra={"unit": "m"})] | None = None
    facet_error: Annotated[float, Field(ge=0.01, le=1)] = 0.1
    chamfer_m: Chamfer = 0.0
    socket: Socket = Socket()

    @model_validator(mode="after")
    def _is_one(self) -> "Shape":
        if bool(self.rectangles) == (self.section is not None):
            raise ValueError(f"name: {self.name}: expected either rectangles or a section")
        return self

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
        """Half the side of a square around the axis that holds the peg, whose sides are never rotated."""
        if self.section is not None:
            return self.section.radius_m
        return max(abs(edge) for rectangle in self.rectangles for edge in rectangle)


SHAPES = (
    Shape("cross", ((-0.020, -0.010, 0.020, 0.010), (-0.010, -0.020, 0.010, 0.020))),
    Shape("rectangle", ((-0.020, -0.0125, 0.020, 0.0125),)),
    Shape("square", ((-0.015, -0.015, 0.015, 0.015),)),
)
