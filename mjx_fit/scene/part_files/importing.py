"""Import of parts from files: their cross-section as a path of straight lines, in metres."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

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
        units: Unit of the file's coordinates, a key of ``UNITS_M``; None: the one that the file states. STEP
            files, and SVG files with a size, are always read in their own.
        tolerance_m: Largest distance of a straight line from the part, m.
        axis: Direction of insertion of a solid.
        at_m: Distance of a solid's section from the end that is inserted first, m; None: in the middle of the
            depth.
        depth_m: Insertion depth, over which the section must not change, m.
        chamfer_m: Height of the chamfer at that end, where the section may change, m.
    """

    units: str | None = "mm"
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
        parts: Number of outlines that are apart.
        holes: Number of outlines inside of others, which bound holes.
        unit: Unit of the file's coordinates in words.
        change_m: Largest change of the section over the insertion depth, m; None: the file is a drawing.
    """

    section: CrossSection
    size_m: tuple[float, float]
    area_m2: float
    corners: int
    parts: int
    holes: int
    unit: str
    change_m: float | None


def import_part(path: Path, wanted: Wanted) -> Imported:
    """Read the cross-section of a part.

    Raises:
        RequestError: The file cannot be read, or it holds no part that can be simulated.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise RequestError(f"{path}: cannot be read: expected a file that ends in {', '.join(SUFFIXES)}")
    unit = _unit(path, suffix, wanted.units)
    read = _drawn if suffix in DRAWINGS else _cut
    figure, change = read(path, wanted, unit)
    size = _require_size(path, figure, unit)
    if change is not None and change > wanted.tolerance_m:
        raise RequestError(
            f"{path}: cannot be used: its section changes by {1000 * change:.3g} mm over the insertion depth "
            f"of {1000 * wanted.depth_m:g} mm, more than the tolerance ({1000 * wanted.tolerance_m:g} mm); "
            "choose --axis, --depth and --chamfer"
        )
    x0, y0, x1, y1 = figure.bounds
    centred = translate(figure, -(x0 + x1) / 2, -(y0 + y1) / 2)
    simple = shapely.set_precision(centred.simplify(_OF_CORNERS * wanted.tolerance_m), GRID_M)
    polygons = getattr(simple, "geoms", [simple])
    holes = sum(len(part.interiors) for part in polygons)
    outlines = len(polygons) + holes
    corners = int(shapely.get_num_coordinates(simple)) - outlines  # rings end where they begin
    if corners > MOST_CORNERS:
        raise RequestError(
            f"{path}: cannot be used: it has {corners} corners: expected at most {MOST_CORNERS}; choose a "
            "larger --tolerance"
        )
    if outlines > MOST_OUTLINES:
        raise RequestError(
            f"{path}: cannot be used: it has {outlines} outlines: expected at most {MOST_OUTLINES}"
        )
    return Imported(_section(simple), size, simple.area, corners, len(polygons), holes, unit.words, change)


class _Unit(NamedTuple):
    """Unit of a file's coordinates, in m, and where it is stated."""

    metres: float
    words: str


def _unit(path: Path, suffix: str, asked: str | None) -> _Unit:
    if suffix in STEP:
        return _Unit(1.0, f"the unit that the file states{'; --units is not used' * bool(asked)}")
    if suffix == ".svg" and (own_m := drawing_files.svg_unit_m(path)):
        return _Unit(own_m, f"the unit that the file states{'; --units is not used' * bool(asked)}")
    stated = drawing_files.dxf_unit(path) if suffix == ".dxf" else None
    if asked is None and stated is None:
        raise RequestError(f"--units: required: {path} does not state the unit of its coordinates")
    if asked is None or asked == stated:
        return _Unit(UNITS_M[stated or ""], f"{stated}, as the file states")
    instead = f"; the file states {stated}" if stated else ""
    return _Unit(UNITS_M[asked], f"--units {asked}{instead}")


def _drawn(path: Path, wanted: Wanted, unit: _Unit) -> tuple[MultiPolygon, None]:
    """Return the figure of a drawing, m."""
    tolerance = wanted.tolerance_m / unit.metres
    read = drawing_files.read_dxf if path.suffix.lower() == ".dxf" else drawing_files.read_svg
    figure = closed_area(read(path, _OF_CURVES * tolerance), _OF_ENDS * tolerance, path)
    return scale(figure, unit.metres, unit.metres, origin=(0, 0)), None


def _cut(path: Path, wanted: Wanted, unit: _Unit) -> tuple[MultiPolygon, float]:
    """Return the section of a solid, and how far it changes over the insertion depth, m."""
    solid = Solid(path, wanted.axis, _OF_CURVES * wanted.tolerance_m, unit.metres)
    start, depth = wanted.chamfer_m, wanted.depth_m
    if solid.length <= depth:
        raise RequestError(
            f"{path}: cannot be used: it is {1000 * solid.length:.4g} mm long along {wanted.axis} in "
            f"{unit.words}: expected more than the insertion depth "
            f"({1000 * depth:g} mm, --depth)"
        )
    at = (start + depth) / 2 if wanted.at_m is None else wanted.at_m
    return solid.section(at), solid.largest_change(at, start, depth)


def _require_size(path: Path, figure: MultiPolygon, unit: _Unit) -> tuple[float, float]:
    x0, y0, x1, y1 = figure.bounds
    size = x1 - x0, y1 - y0
    if not LEAST_ACROSS_M <= max(size) <= MOST_ACROSS_M or min(size) < LEAST_ACROSS_M:
        raise RequestError(
            f"{path}: cannot be used: the section is {1000 * size[0]:.4g} by {1000 * size[1]:.4g} mm "
            f"(unit: {unit.words}): expected {1000 * LEAST_ACROSS_M} to {1000 * MOST_ACROSS_M:g} mm"
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
