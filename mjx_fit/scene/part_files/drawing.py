"""Closed outlines in drawings: DXF by ezdxf, SVG by svgpathtools."""

import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from shapely import LineString, MultiPolygon

from mjx_fit.utils.errors import RequestError

Line = Float[np.ndarray, "n 2"]
_GRID = 1e-3
"""Share of the tolerance within which corners are one."""
MOST_LINES = 2**12
"""Most lines in place of one curve."""
_UNIT_MM = {"mm": 1.0, "cm": 10.0, "in": 25.4, "pt": 25.4 / 72, "pc": 25.4 / 6, "Q": 0.25}
_LENGTH = re.compile(r"\s*([0-9.eE+-]+)\s*([a-zA-Z%]*)\s*")


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
        RequestError: The file is no SVG, or a curve of it needs too many lines.
    """
    from xml.etree.ElementTree import ParseError

    from svgpathtools import Document

    try:
        parts = [part for one in Document(str(path)).paths() for part in one.continuous_subpaths()]
        flat = [[_flattened(segment, tolerance) for segment in part] for part in parts]
    except _TooFineError:
        raise RequestError(
            f"{path}: cannot be used: a curve needs more than {MOST_LINES} lines: expected another --units, "
            "or a larger --tolerance"
        ) from None
    except (OSError, ParseError, ValueError, AttributeError, AssertionError) as error:
        raise RequestError(f"{path}: cannot be read as SVG: {error or 'a curve has no length'}") from None
    return [np.concatenate(segments) * [1, -1] for segments in flat if segments]


def svg_unit_m(path: Path) -> float | None:
    """Return the unit of an SVG file's view box, m; None: the file does not state its size in a unit.

    Raises:
        RequestError: The file is no SVG.
    """
    from xml.etree import ElementTree

    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise RequestError(f"{path}: cannot be read as SVG: {error}") from None
    length = _LENGTH.fullmatch(root.get("width", ""))
    box = root.get("viewBox", "").replace(",", " ").split()
    if length is None or length[2] not in _UNIT_MM or len(box) != 4:
        return None
    try:
        width, units = float(length[1]), float(box[2])
    except ValueError:
        return None
    return 0.001 * width * _UNIT_MM[length[2]] / units if width > 0 and 0 < units < math.inf else None


class _TooFineError(Exception):
    """A curve needs too many lines."""


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
        if n > MOST_LINES:
            raise _TooFineError


def closed_area(lines: list[Line], tolerance: float, path: Path) -> MultiPolygon:
    """Return the area that closed lines enclose; a line inside of another bounds a hole.

    Args:
        lines: Lines, whose ends meet within the tolerance. A line that is drawn twice counts once.
        tolerance: Tolerance of the lines.
        path: The file, for messages.

    Raises:
        RequestError: There is no line, an outline is not closed, or outlines cross.
    """
    lines = [line for line in lines if len(line) > 1 and np.ptp(line, axis=0).max() > 0]
    if not lines:
        raise RequestError(f"{path}: cannot be used: it holds no line")
    joined = shapely.MultiLineString([LineString(line) for line in _joined(lines, tolerance)])
    drawn = list(shapely.set_precision(joined, _GRID * tolerance, mode="pointwise").geoms)
    if _crosses(drawn):
        raise RequestError(f"{path}: cannot be used: its outlines cross")
    single = shapely.union_all(drawn)
    _, _, dangling, _ = shapely.polygonize_full(list(getattr(single, "geoms", [single])))
    if not dangling.is_empty:
        x, y = shapely.get_coordinates(dangling)[0]
        raise RequestError(f"{path}: cannot be used: an outline is not closed, at ({x:g}, {y:g})")
    figure = shapely.build_area(single)
    if figure.is_empty:
        raise RequestError(f"{path}: cannot be used: no outline is closed")
    parts = getattr(figure, "geoms", [figure])
    return MultiPolygon([shapely.orient_polygons(part) for part in parts])


def _joined(lines: list[Line], distance: float) -> list[Line]:
    """Move ends of lines that are within a distance of each other to one place."""
    ends = np.concatenate([line[[0, -1]] for line in lines])
    points = np.asarray(shapely.points(ends))
    near = shapely.STRtree(points).query(points, predicate="dwithin", distance=distance)
    graph = coo_array((np.ones(near.shape[1]), near), shape=(len(ends),) * 2)
    _, label = connected_components(graph)
    _, first = np.unique(label, return_index=True)
    together = ends[first][label].reshape(-1, 2, 2)
    return [
        np.concatenate([start[None], line[1:-1], end[None]])
        for line, (start, end) in zip(lines, together, strict=True)
    ]


def _crosses(lines: list[LineString]) -> bool:
    """Check whether lines cross, themselves or others, anywhere but at their ends."""
    if not all(line.is_simple for line in lines):
        return True
    tree = shapely.STRtree(lines)
    one, other = tree.query(lines, predicate="crosses")
    return bool((one != other).any())
