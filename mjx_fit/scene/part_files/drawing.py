"""Closed outlines in drawings: DXF by ezdxf, SVG by svgpathtools."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float
from shapely import LineString, MultiPolygon

from mjx_fit.utils.errors import RequestError

Line = Float[np.ndarray, "n 2"]
JOIN = 1e-3
"""Share of the tolerance within which ends of lines are joined."""


def read_dxf(path: Path, tolerance: float) -> list[Line]:
    """Read all curves in the model space of a DXF file, with arcs and splines as lines.

    Args:
        path: The file.
        tolerance: Largest distance of a line from its curve, in units of the file.

    Raises:
        RequestError: The file is no DXF.
    """
    import ezdxf
    from ezdxf import path as curves

    try:
        document = ezdxf.readfile(path)
    except (OSError, ezdxf.DXFError, UnicodeDecodeError) as error:
        raise RequestError(f"{path}: cannot be read as DXF: {error}") from None
    flat: list[Line] = []
    for entity in _entities(document.modelspace()):
        try:
            curve = curves.make_path(entity)
        except TypeError:  # text, dimensions and the like have no path
            continue
        flat += [
            np.array([(point.x, point.y) for point in part.flattening(tolerance)])
            for part in (curve.sub_paths() if curve.has_sub_paths else (curve,))
            if len(part)
        ]
    return flat


def _entities(layout) -> Iterator:
    """Yield the entities of a layout, those of blocks in their place."""
    for entity in layout:
        if entity.dxftype() == "INSERT":
            yield from _entities(entity.virtual_entities())
        else:
            yield entity


def read_svg(path: Path, tolerance: float) -> list[Line]:
    """Read all paths and figures of an SVG file, y upwards, with arcs and curves as lines.

    Units are those of the view box.

    Args:
        path: The file.
        tolerance: Largest distance of a line from its curve, in units of the file.

    Raises:
        RequestError: The file is no SVG.
    """
    from xml.etree.ElementTree import ParseError

    from svgpathtools import Document

    try:
        paths = Document(str(path)).paths()
    except (OSError, ParseError, ValueError, AttributeError) as error:
        raise RequestError(f"{path}: cannot be read as SVG: {error}") from None
    flat = []
    for one in paths:
        for part in one.continuous_subpaths():
            flat.append(np.concatenate([_flattened(segment, tolerance) for segment in part]) * [1, -1])
    return flat


def _flattened(segment, tolerance: float) -> Line:
    """Return points on a segment, both ends included, that are nowhere further from it than a tolerance."""

    def at(times: Float[np.ndarray, "n"]) -> Line:
        return np.array([(point.real, point.imag) for point in map(segment.point, times)])

    if type(segment).__name__ == "Line":
        return at(np.array([0.0, 1.0]))
    n = 8
    while True:
        points = at(np.linspace(0, 1, 2 * n + 1))
        if shapely.distance(LineString(points[::2]), shapely.points(points[1::2])).max() <= tolerance:
            return points[::2]
        n *= 2


def closed_area(lines: list[Line], tolerance: float, path: Path) -> MultiPolygon:
    """Return the area that closed lines enclose; a line inside of another bounds a hole.

    Args:
        lines: Lines, whose ends meet.
        tolerance: Tolerance of the lines; ends are joined within a thousandth of it.
        path: The file, for messages.

    Raises:
        RequestError: There is no line, an outline is not closed, or outlines cross.
    """
    if not lines:
        raise RequestError(f"{path}: cannot be used: it holds no line")
    drawn = shapely.MultiLineString([LineString(line) for line in lines if len(line) > 1])
    drawn = shapely.set_precision(drawn, tolerance * JOIN, mode="pointwise")
    _, _, dangling, _ = shapely.polygonize_full(list(drawn.geoms))
    if not dangling.is_empty:
        x, y = shapely.get_coordinates(dangling)[0]
        raise RequestError(f"{path}: cannot be used: an outline is not closed, at ({x:g}, {y:g})")
    if _crosses(drawn):
        raise RequestError(f"{path}: cannot be used: its outlines cross")
    figure = shapely.build_area(drawn)
    if figure.is_empty:
        raise RequestError(f"{path}: cannot be used: no outline is closed")
    parts = getattr(figure, "geoms", [figure])
    return MultiPolygon([shapely.orient_polygons(part) for part in parts])


def _crosses(drawn: shapely.MultiLineString) -> bool:
    """Check whether lines cross, themselves or others, anywhere but at their ends."""
    lines = list(drawn.geoms)
    if not all(line.is_simple for line in lines):
        return True
    tree = shapely.STRtree(lines)
    one, other = tree.query(lines, predicate="crosses")
    return bool((one != other).any())
