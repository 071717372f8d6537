"""Cross-sections of parts: plain figures, their unions and differences, moved and turned in the plane."""

import cmath
import math
from typing import Annotated

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import STRICT

MOST_ACROSS_M = 0.06
"""Largest extent of a part: a socket of the default size must hold it."""
Metres = Annotated[float, Field(ge=-MOST_ACROSS_M / 2, le=MOST_ACROSS_M / 2, json_schema_extra={"unit": "m"})]
Length = Annotated[float, Field(ge=0.0005, le=MOST_ACROSS_M, json_schema_extra={"unit": "m"})]
Fillet = Annotated[float, Field(ge=0, le=MOST_ACROSS_M / 2, json_schema_extra={"unit": "m"})]
Turn = Annotated[float, Field(ge=-360, le=360, json_schema_extra={"unit": "deg"})]
Bulge = Annotated[float, Field(ge=-100, le=100)]
FIGURES = ("circle", "rectangle", "polygon", "star", "path", "union", "difference")


@dataclass(frozen=True, config=STRICT)
class Circle:
    """Circle around the origin.

    Attributes:
        diameter_m: Diameter.
    """

    diameter_m: Length


@dataclass(frozen=True, config=STRICT)
class Rectangle:
    """Rectangle around the origin, its sides along x and y.

    Attributes:
        size_m: Extent along x and along y.
        fillet_m: Radius of the rounded corners.
    """

    size_m: tuple[Length, Length]
    fillet_m: Fillet = 0.0

    @model_validator(mode="after")
    def _corners_fit(self) -> "Rectangle":
        if self.fillet_m > min(self.size_m) / 2:
            raise ValueError(
                f"fillet_m: {self.fillet_m} is invalid: expected at most half the shorter side "
                f"({min(self.size_m) / 2})"
            )
        return self


@dataclass(frozen=True, config=STRICT)
class Polygon:
    """Regular polygon around the origin, one side parallel to x, below the origin.

    Attributes:
        sides: Number of sides.
        inscribed_diameter_m: Diameter of the inscribed circle: the width across flats of an even number of
            sides.
    """

    sides: Annotated[int, Field(ge=3, le=64)]
    inscribed_diameter_m: Length


@dataclass(frozen=True, config=STRICT)
class Star:
    """Star around the origin, one point along y.

    Attributes:
        points: Number of points.
        diameter_m: Diameter of the circle through the points.
        inner_diameter_m: Diameter of the circle through the notches.
    """

    points: Annotated[int, Field(ge=3, le=32)]
    diameter_m: Length
    inner_diameter_m: Length

    @model_validator(mode="after")
    def _notches_are_inside(self) -> "Star":
        if self.inner_diameter_m >= self.diameter_m:
            raise ValueError(
                f"inner_diameter_m: {self.inner_diameter_m} is invalid: expected less than diameter_m "
                f"({self.diameter_m})"
            )
        return self


@dataclass(frozen=True, config=STRICT)
class CrossSection:
    """Figure in the plane, in metres from the tool axis; exactly one kind is given.

    It is seen from above, as the inserted part stands in its socket, x and y along the world's axes.

    Attributes:
        circle: Circle.
        rectangle: Rectangle, with or without rounded corners.
        polygon: Regular polygon.
        star: Star.
        path: Corners (x, y) or (x, y, bulge) of a closed path. The bulge is that of DXF: the tangent of a
            quarter of the angle of the arc to the next corner, positive to the left; 0: a straight line.
        union: Everything that lies in one of these.
        difference: The first without all others.
        turn_deg: Rotation about the origin, counter-clockwise, before the move.
        at_m: Move of the origin to (x, y).
    """

    circle: Circle | None = None
    rectangle: Rectangle | None = None
    polygon: Polygon | None = None
    star: Star | None = None
    path: (
        Annotated[
            tuple[tuple[Metres, Metres] | tuple[Metres, Metres, Bulge], ...],
            Field(min_length=2, max_length=2000),
        ]
        | None
    ) = None
    union: "Annotated[tuple[CrossSection, ...], Field(min_length=1, max_length=100)] | None" = None
    difference: "Annotated[tuple[CrossSection, ...], Field(min_length=2, max_length=100)] | None" = None
    turn_deg: Turn = 0.0
    at_m: tuple[Metres, Metres] = (0.0, 0.0)

    @model_validator(mode="after")
    def _is_one(self) -> "CrossSection":
        given = [name for name in FIGURES if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f"{', '.join(given) or 'nothing'} is given: expected one of {', '.join(FIGURES)}"
            )
        return self

    @property
    def radius_m(self) -> float:
        """Radius of a circle around the tool axis that holds the figure."""
        return _radius(self, 0)


def _radius(section: CrossSection, at: complex) -> float:
    """Bound the distance of a figure from a point, in the frame outside of the figure's own move and turn."""
    at = (at - complex(*section.at_m)) * cmath.exp(-1j * math.radians(section.turn_deg))
    if section.union is not None:
        return max(_radius(part, at) for part in section.union)
    if section.difference is not None:
        return _radius(section.difference[0], at)
    if section.path is not None:
        corners = [complex(*corner[:2]) for corner in section.path]
        # No point of an arc is further from its start than the chord or the bulge's height allow.
        bulges = (abs(corner[2]) if len(corner) == 3 else 0.0 for corner in section.path)
        arcs = [
            abs(there - here) * bulge / 2
            for here, there, bulge in zip(corners, [*corners[1:], corners[0]], bulges, strict=True)
        ]
        return max(abs(corner - at) for corner in corners) + max(arcs)
    return abs(at) + _own_radius(section)


def _own_radius(section: CrossSection) -> float:
    """Return the radius of a plain figure around its own origin."""
    if section.circle is not None:
        return section.circle.diameter_m / 2
    if section.rectangle is not None:
        return math.hypot(*section.rectangle.size_m) / 2
    if section.polygon is not None:
        return section.polygon.inscribed_diameter_m / 2 / math.cos(math.pi / section.polygon.sides)
    assert section.star is not None
    return section.star.diameter_m / 2
