"""The area that the lines of a drawing enclose."""

from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from shapely import LineString, MultiPolygon
from shapely.geometry.base import BaseGeometry

from mjx_fit.scene.part_files.drawing_files import Line
from mjx_fit.utils.errors import RequestError

_GRID = 1e-3
"""Share of the tolerance within which corners are one."""
_NEIGHBOURS = 8
_SHORT = 4
"""The ends of a line shorter than so many tolerances are not joined to each other."""


def closed_area(lines: list[Line], tolerance: float, path: Path) -> MultiPolygon:
    """Return the area that closed lines enclose; a line inside of another bounds a hole.

    Args:
        lines: Lines, whose ends meet within the tolerance. A line that is drawn twice counts once.
        tolerance: Tolerance of the lines.
        path: The file, for messages.

    Raises:
        RequestError: There is no line, an outline is not closed, outlines cross or run along each other.
    """
    lines = [line for line in lines if len(line) > 1 and np.ptp(line, axis=0).max() > 0]
    if not lines:
        raise RequestError(f"{path}: cannot be used: it holds no line")
    if not all(np.isfinite(line).all() for line in lines):
        raise RequestError(f"{path}: cannot be used: a coordinate is not finite")
    joined = shapely.MultiLineString([LineString(line) for line in _joined(lines, tolerance)])
    drawn = list(shapely.set_precision(joined, _GRID * tolerance, mode="pointwise").geoms)
    _require_uncrossed(drawn, path)
    single = shapely.union_all(drawn)
    _require_closed(single, tolerance, path)
    figure = shapely.build_area(single)
    if figure.is_empty:
        raise RequestError(f"{path}: cannot be used: no outline is closed")
    parts = getattr(figure, "geoms", [figure])
    return MultiPolygon([shapely.orient_polygons(part) for part in parts])


def _require_closed(drawn: BaseGeometry, tolerance: float, path: Path) -> None:
    """Require that lines neither end nor fork: where outlines share a side, their inside is not defined."""
    parts = [np.array(part.coords)[[0, -1]] for part in getattr(drawn, "geoms", [drawn])]
    places, count = np.unique(np.concatenate(parts), axis=0, return_counts=True)
    ends = places[count == 1]
    if len(ends):
        away = np.sort(np.linalg.norm(ends - ends[0], axis=1))
        gap = (
            f"; the nearest other end is {away[1]:.3g} away, more than {tolerance:.3g}"
            if away[1:].size
            else ""
        )
        raise RequestError(
            f"{path}: cannot be used: an outline is not closed, at {_in_file(ends[0], path)}{gap}"
        )
    forks = places[count % 2 == 1]
    if len(forks):
        raise RequestError(
            f"{path}: cannot be used: an outline runs along another, at {_in_file(forks[0], path)}"
        )


def _in_file(point: Float[np.ndarray, "2"], path: Path) -> str:
    """Write a place in the file's own coordinates: y of SVG points down."""
    y = -point[1] if path.suffix.lower() == ".svg" else point[1]
    return f"({point[0]:.6g}, {y + 0.0:.6g})"


def _joined(lines: list[Line], tolerance: float) -> list[Line]:
    """Move ends that nearly meet to one place: the nearest of those that meet no other end exactly."""
    ends = np.concatenate([line[[0, -1]] for line in lines])
    _, place, count = np.unique(
        np.round(ends / (_GRID * tolerance)), axis=0, return_inverse=True, return_counts=True
    )
    lengths = np.array([np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines])
    alone = np.flatnonzero(count[place] == 1)
    free = set(alone.tolist())
    for a, b in _near(ends[alone], tolerance):
        one, other = int(alone[a]), int(alone[b])
        of_one_short_line = one // 2 == other // 2 and lengths[one // 2] <= _SHORT * tolerance
        if one in free and other in free and not of_one_short_line:
            ends[other] = ends[one]
            free -= {one, other}
    return [
        np.concatenate([start[None], line[1:-1], end[None]])
        for line, (start, end) in zip(lines, ends.reshape(-1, 2, 2), strict=True)
    ]


def _near(points: Float[np.ndarray, "n 2"], distance: float) -> Int[np.ndarray, "pairs 2"]:
    """Return pairs of points within a distance, the nearest first; of each point, its nearest neighbours."""
    if len(points) < 2:
        return np.empty((0, 2), int)
    most = min(1 + _NEIGHBOURS, len(points))
    away, other = map(np.asarray, KDTree(points).query(points, most, distance_upper_bound=distance))
    away[other == np.arange(len(points))[:, None]] = np.inf  # itself
    rows, columns = np.nonzero(np.isfinite(away))
    order = np.argsort(away[rows, columns], kind="stable")
    return np.stack([rows, other[rows, columns]], 1)[order]


def _require_uncrossed(lines: list[LineString], path: Path) -> None:
    """Require that lines touch themselves and others at their ends alone."""
    for line in lines:
        if not line.is_simple:
            raise RequestError(
                f"{path}: cannot be used: its outlines cross: one crosses itself, which begins at "
                f"{_in_file(np.array(line.coords[0]), path)}"
            )
    tree = shapely.STRtree(lines)
    one, other = tree.query(lines, predicate="crosses")
    crossing = one != other
    if crossing.any():
        k = int(np.flatnonzero(crossing)[0])
        place = shapely.get_coordinates(lines[one[k]].intersection(lines[other[k]]))[0]
        raise RequestError(f"{path}: cannot be used: its outlines cross, at {_in_file(place, path)}")
