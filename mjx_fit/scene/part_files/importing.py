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
from mjx_fit.scene.part_files import drawing
from mjx_fit.scene.part_files.solid import AXES, MESHES, STEP, Solid
from mjx_fit.utils.errors import RequestError, require, shown

UNITS_M = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254, "um": 1e-6}
SUFFIXES = (".dxf", ".svg", *MESHES, *STEP)
LEAST_ACROSS_M = 0.0005
GRID_M = 1e-7
"""Coordinates of imported parts are rounded to a tenth of a micrometre."""


@dataclass(frozen=True)
class Wanted:
    """What to take from a file.

    Attributes:
        units: Unit of the file's coordinates, a key of ``UNITS_M``.
        tolerance_m: Largest distance of a straight line from the part, m.
        axis: Direction of insertion of a solid.
        at_m: Distance of a solid's section from the end that is inserted first, m.
        depth_m: Insertion depth, over which the section must not change, m.
    """

    units: str = "mm"
    tolerance_m: float = 5e-6
    axis: str = "-z"
    at_m: float | None = None
    depth_m: float = 0.01


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
    unit = UNITS_M[wanted.units]
    figure, change = _figure(path, suffix, wanted, unit)
    figure = scale(figure, unit, unit, origin=(0, 0))
    size = _require_size(path, figure, wanted.units)
    if change is not None and change > wanted.tolerance_m:
        raise RequestError(
            f"{path}: cannot be used: its section changes by {1000 * change:.3g} mm over the insertion depth "
            f"of {1000 * wanted.depth_m:g} mm, more than the tolerance ({1000 * wanted.tolerance_m:g} mm); "
            "choose --axis and --depth"
        )
    x0, y0, x1, y1 = figure.bounds
    centred = translate(figure, -(x0 + x1) / 2, -(y0 + y1) / 2)
    simple = shapely.set_precision(centred.simplify(wanted.tolerance_m / 2), GRID_M)
    section = _section(simple)
    return Imported(section, size, simple.area, int(shapely.get_num_coordinates(simple)), change)


def _figure(path: Path, suffix: str, wanted: Wanted, unit: float) -> tuple[MultiPolygon, float | None]:
    """Return the figure in a file, in its units, and how far a solid's section changes, m."""
    tolerance = wanted.tolerance_m / 2 / unit
    if suffix in (".dxf", ".svg"):
        read = drawing.read_dxf if suffix == ".dxf" else drawing.read_svg
        return drawing.closed_area(read(path, tolerance), tolerance, path), None
    solid, depth = Solid(path, wanted.axis, tolerance), wanted.depth_m / unit
    if solid.length < depth:
        raise RequestError(
            f"{path}: cannot be used: it is {1000 * unit * solid.length:.4g} mm long along {wanted.axis} in "
            f"--units {wanted.units}, shorter than the insertion depth ({1000 * wanted.depth_m:g} mm)"
        )
    at = depth / 2 if wanted.at_m is None else wanted.at_m / unit
    return solid.section(at), unit * solid.largest_change(at, depth)


def _require_size(path: Path, figure: MultiPolygon, units: str) -> tuple[float, float]:
    x0, y0, x1, y1 = figure.bounds
    size = x1 - x0, y1 - y0
    if not LEAST_ACROSS_M <= max(size) <= MOST_ACROSS_M or min(size) < LEAST_ACROSS_M:
        raise RequestError(
            f"{path}: cannot be used: the section is {1000 * size[0]:.4g} by {1000 * size[1]:.4g} mm in "
            f"--units {units}: expected {1000 * LEAST_ACROSS_M} to {1000 * MOST_ACROSS_M:g} mm"
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


def wanted_of(
    units: str, axis: str, at: float | None, depth_mm: float, clearance_mm: float, tolerance_mm: float | None
) -> Wanted:
    """Return what a command line asks for.

    Args:
        units: Unit of the file, and of ``at``.
        axis: Direction of insertion.
        at: Distance of the section from the tip.
        depth_mm: Insertion depth.
        clearance_mm: Air per side.
        tolerance_mm: Error of straight lines; None: a twentieth of the clearance.

    Raises:
        RequestError: A value is not allowed.
    """
    if units not in UNITS_M:
        raise RequestError(f"--units: {shown(units)} is invalid: expected {', '.join(UNITS_M)}")
    if axis not in AXES:
        raise RequestError(f"--axis: {shown(axis)} is invalid: expected {', '.join(AXES)}")
    tolerance_mm = clearance_mm / 20 if tolerance_mm is None else tolerance_mm
    require("--clearance", clearance_mm, 0.05, 5)
    require("--depth", depth_mm, 1, 80)
    require("--tolerance", tolerance_mm, 0.0001, clearance_mm / 2)
    at_m = None if at is None else at * UNITS_M[units]
    if at is not None:
        require(
            "--at", at, 0, depth_mm / 1000 / UNITS_M[units], "the section is taken within the insertion depth"
        )
    return Wanted(units, tolerance_mm / 1000, axis, at_m, depth_mm / 1000)


def shape_tree(name: str, part: Imported, clearance_mm: float) -> dict[str, Any]:
    """Return the entry of ``scene.shapes`` for a part, without what has its default."""
    return {"name": name, "section": _tree(part.section), "clearance_m": clearance_mm / 1000}


def _tree(section: CrossSection) -> dict[str, Any]:
    if section.path is not None:
        return {"path": [list(corner) for corner in section.path]}
    kind, parts = (
        ("union", section.union) if section.union is not None else ("difference", section.difference)
    )
    return {kind: [_tree(part) for part in parts or ()]}
