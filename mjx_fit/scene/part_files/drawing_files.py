"""Curves in drawings, as lines: DXF by ezdxf, SVG by svgpathtools."""

import re
import warnings
from collections.abc import Iterator
from math import inf
from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float
from shapely import LineString

from mjx_fit.utils.errors import RequestError

Line = Float[np.ndarray, "n 2"]
MOST_LINES = 2**12
"""Most lines in place of one curve."""
_BAD = (ValueError, TypeError, IndexError, KeyError, AttributeError, AssertionError, ArithmeticError)
"""What readers of drawings raise where an element is broken."""
DXF_UNITS = {1: "in", 4: "mm", 5: "cm", 6: "m", 13: "um"}
PIXEL_M = 0.0254 / 96
"""Unit of an SVG file without a view box."""
_SAME_UNIT = 0.001
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

    try:
        return [
            np.array([(point.x, point.y) for point in curve.flattening(tolerance)])
            for entity in _entities(ezdxf.readfile(path).modelspace())
            for curve in _curves(entity)
        ]
    except (OSError, ezdxf.DXFError, *_BAD) as error:
        raise RequestError(f"{path}: cannot be read as DXF: {_one_line(error)}") from None


def dxf_unit(path: Path) -> str | None:
    """Return the unit that the header of a DXF file states; None: none, or another than ``DXF_UNITS``.

    Raises:
        RequestError: The file is no DXF.
    """
    import ezdxf

    try:
        return DXF_UNITS.get(ezdxf.readfile(path).header.get("$INSUNITS", 0))
    except (OSError, ezdxf.DXFError, *_BAD) as error:
        raise RequestError(f"{path}: cannot be read as DXF: {_one_line(error)}") from None


def _curves(entity) -> Iterator:
    """Yield the curves of an entity; text, dimensions and the like have none."""
    from ezdxf import path as curves

    try:
        whole = curves.make_path(entity)
    except TypeError:
        return
    for curve in whole.sub_paths() if whole.has_sub_paths else (whole,):
        if len(curve):
            if not np.isfinite([(one.x, one.y) for one in curve.control_vertices()]).all():
                raise ValueError("a coordinate is not finite")
            yield curve


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
        with warnings.catch_warnings(action="error", category=UserWarning):  # it leaves something out
            parts = [part for one in Document(str(path)).paths() for part in one.continuous_subpaths()]
            flat = [[_flattened(segment, tolerance) for segment in part] for part in parts]
    except _TooFineError:
        raise RequestError(
            f"{path}: cannot be used: a curve needs more than {MOST_LINES} lines: expected another --units, "
            "or a larger --tolerance"
        ) from None
    except (OSError, ParseError, Warning, *_BAD) as error:
        raise RequestError(f"{path}: cannot be read as SVG: {_one_line(error)}") from None
    return [np.concatenate(segments) * [1, -1] for segments in flat if segments]


def svg_unit_m(path: Path) -> float | None:
    """Return the unit of an SVG file's coordinates, m; None: the file does not state its size in a unit.

    Raises:
        RequestError: The file is no SVG, or its width and height state two units.
    """
    from xml.etree import ElementTree

    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise RequestError(f"{path}: cannot be read as SVG: {error}") from None
    sizes = [_length_m(root.get(side, "")) for side in ("width", "height")]
    if "viewBox" not in root.attrib:
        return PIXEL_M if any(sizes) else None
    box = [_number(word) for word in root.get("viewBox", "").replace(",", " ").split()]
    if len(box) != 4:
        return None
    units = [size / many for size, many in zip(sizes, box[2:], strict=True) if size and 0 < many < inf]
    if units and max(units) > (1 + _SAME_UNIT) * min(units):
        raise RequestError(
            f"{path}: cannot be used: a unit of its view box is {1000 * units[0]:.4g} mm by its width and "
            f"{1000 * units[1]:.4g} mm by its height: expected one scale"
        )
    return units[0] if units else None


def _length_m(text: str) -> float | None:
    """Return a length with a unit, m; None: it has none."""
    found = _LENGTH.fullmatch(text)
    number = _number(found[1]) if found and found[2] in _UNIT_MM else 0.0
    return 0.001 * number * _UNIT_MM[found[2]] if found and 0 < number < inf else None


def _number(text: str) -> float:
    """Return a number, 0 if the text is none."""
    try:
        return float(text)
    except ValueError:
        return 0.0


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


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
