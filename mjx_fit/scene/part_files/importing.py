"""Import of parts from files: their cross-section as a path of straight lines, in metres."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon
from shapely.affinity import scale, translate
from shapely.geometry.base import BaseGeometry

from mjx_fit.config.sections.cross_section import MOST_ACROSS_M, CrossSection
from mjx_fit.scene.part_files import drawing_files
from mjx_fit.scene.part_files.closed_lines import closed_area
from mjx_fit.scene.part_files.solid import MESHES, STEP, Solid
from mjx_fit.utils.errors import RequestError

UNITS_M = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254, "um": 1e-6}
DRAWINGS = (".dxf", ".svg")
SUFFIXES = (*DRAWINGS, *MESHES, *STEP)
LEAST_ACROSS_M = 0.0005
MOST_CORNERS, MOST_OUTLINES = 2000, 100
GRID_M = 1e-7
"""Coordinates of imported parts are rounded to a tenth of a micrometre."""

_OF_CURVES, _OF_ENDS, _OF_CORNERS = 1 / 8, 1 / 4, 5 / 8
"""Shares of the tolerance: lines in place of curves, ends that nearly meet, corners that are left out."""


@dataclass(frozen=True)
class Wanted:
    """What to take from a file.

    Attributes:
        units: Unit of the file's coordinates, a key of ``UNITS_M``, if the file does not state it as STEP
            and some SVG files do.
        tolerance_m: Largest distance of a straight line from the part, m.
        axis: Direction of insertion of a solid.
        at_m: Distance of a solid's section from the end that is inserted first, m; None: in the middle of the
            depth.
        depth_m: Insertion depth, over which the section must not change, m.
        chamfer_m: Height of the chamfer at that end, where the section may change, m.
    """

    units: str = "mm"
    tolerance_m: float = 5e-6
    axis: str = "-z"
    at_m: float | None = None
    depth_m: float = 0.01
    chamfer_m: float = 0.0


@dataclass(frozen=True)
class Imported:
    """Cross-section from a file.

    Attributes:
        section: Cross-section, centred on the middle of its extent.
        size_m: Extent along x and y, m.
        area_m2: Area, m².
        corners: Number of corners.
        change_m: Largest change of the section over the insertion depth, m; None: the file is a drawing.
    """

    section: CrossSection
    size_m: tuple[float, float]
    area_m2: float
    corners: int
    change_m: float | None


def import_part(path: Path, wanted: Wanted) -> Imported:
    """Read the cross-section of a part.

    Raises:
        RequestError: The file cannot be read, or it holds no part that can be simulated.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise RequestError(f"{path}: cannot be read: expected a file that ends in {', '.join(SUFFIXES)}")
    figure, change = _drawn(path, suffix, wanted) if suffix in DRAWINGS else _cut(path, wanted)
    size = _require_size(path, figure, _unit_in_words(path, wanted))
    if change is not None and change > wanted.tolerance_m:
        raise RequestError(
            f"{path}: cannot be used: its section changes by {1000 * change:.3g} mm over the insertion depth "
            f"of {1000 * wanted.depth_m:g} mm, more than the tolerance ({1000 * wanted.tolerance_m:g} mm); "
            "choose --axis, --depth and --chamfer"
        )
    x0, y0, x1, y1 = figure.bounds
    centred = translate(figure, -(x0 + x1) / 2, -(y0 + y1) / 2)
    simple = shapely.set_precision(centred.simplify(_OF_CORNERS * wanted.tolerance_m), GRID_M)
    corners = int(shapely.get_num_coordinates(simple))
    if corners > MOST_CORNERS:
        raise RequestError(
            f"{path}: cannot be used: it has {corners} corners: expected at most {MOST_CORNERS}; choose a "
            "larger --tolerance"
        )
    pieces = sum(1 + shapely.get_num_interior_rings(part) for part in getattr(simple, "geoms", [simple]))
    if pieces > MOST_OUTLINES:
        raise RequestError(
            f"{path}: cannot be used: it has {pieces} outlines: expected at most {MOST_OUTLINES}"
        )
    return Imported(_section(simple), size, simple.area, corners, change)


def _drawn(path: Path, suffix: str, wanted: Wanted) -> tuple[MultiPolygon, None]:
    """Return the figure of a drawing, m."""
    own_m = drawing_files.svg_unit_m(path) if suffix == ".svg" else None
    unit_m = own_m or UNITS_M[wanted.units]
    tolerance = wanted.tolerance_m / unit_m
    read = drawing_files.read_dxf if suffix == ".dxf" else drawing_files.read_svg
    figure = closed_area(read(path, _OF_CURVES * tolerance), _OF_ENDS * tolerance, path)
    return scale(figure, unit_m, unit_m, origin=(0, 0)), None


def _cut(path: Path, wanted: Wanted) -> tuple[MultiPolygon, float]:
    """Return the section of a solid, and how far it changes over the insertion depth, m."""
    solid = Solid(path, wanted.axis, _OF_CURVES * wanted.tolerance_m, UNITS_M[wanted.units])
    start, depth = wanted.chamfer_m, wanted.depth_m
    if solid.length <= depth:
        raise RequestError(
            f"{path}: cannot be used: it is {1000 * solid.length:.4g} mm long along {wanted.axis} "
            f"{_unit_in_words(path, wanted)}: expected more than the insertion depth "
            f"({1000 * depth:g} mm, --depth)"
        )
    at = (start + depth) / 2 if wanted.at_m is None else wanted.at_m
    return solid.section(at), solid.largest_change(at, start, depth)


def _unit_in_words(path: Path, wanted: Wanted) -> str:
    suffix = path.suffix.lower()
    own = suffix in STEP or (suffix == ".svg" and drawing_files.svg_unit_m(path) is not None)
    return "in the unit that the file states" if own else f"in --units {wanted.units}"


def _require_size(path: Path, figure: MultiPolygon, unit: str) -> tuple[float, float]:
    x0, y0, x1, y1 = figure.bounds
    size = x1 - x0, y1 - y0
    if not LEAST_ACROSS_M <= max(size) <= MOST_ACROSS_M or min(size) < LEAST_ACROSS_M:
        raise RequestError(
            f"{path}: cannot be used: the section is {1000 * size[0]:.4g} by {1000 * size[1]:.4g} mm "
            f"{unit}: expected {1000 * LEAST_ACROSS_M} to {1000 * MOST_ACROSS_M:g} mm"
        )
    return size


def _section(figure: BaseGeometry) -> CrossSection:
    """Write polygons as paths, their holes as differences."""
    parts = [_of_polygon(part) for part in getattr(figure, "geoms", [figure])]
    return parts[0] if len(parts) == 1 else CrossSection(union=tuple(parts))


def _of_polygon(polygon: Polygon) -> CrossSection:
    paths = [
        CrossSection(path=tuple((float(x), float(y)) for x, y in np.asarray(ring.coords)[:-1].round(7)))
        for ring in (polygon.exterior, *polygon.interiors)
    ]
    return paths[0] if len(paths) == 1 else CrossSection(difference=tuple(paths))


def shape_tree(name: str, part: Imported, clearance_m: float, chamfer_m: float = 0.0) -> dict[str, Any]:
    """Return the entry of ``scene.shapes`` for a part, without what has its default."""
    tree = {"name": name, "section": _tree(part.section), "clearance_m": clearance_m}
    return tree | ({"chamfer_m": chamfer_m} if chamfer_m else {})


def _tree(section: CrossSection) -> dict[str, Any]:
    if section.path is not None:
        return {"path": [list(corner) for corner in section.path]}
    kind, parts = (
        ("union", section.union) if section.union is not None else ("difference", section.difference)
    )
    return {kind: [_tree(part) for part in parts or ()]}
