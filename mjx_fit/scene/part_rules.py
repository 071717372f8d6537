"""Checks whether a part can be made: thickness, size, chamfers, and whether the peg fits its own socket."""

import numpy as np
from shapely import MultiPolygon

from mjx_fit.config.sections.cross_section import MOST_ACROSS_M
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.scene.outline import (
    GRID_M,
    MITRE_LIMIT,
    PLATE_RIM_M,
    grown,
    hole_outline,
    inset,
    peg_outline,
    rings_of,
)
from mjx_fit.utils.errors import RequestError

_ROUNDING = 1e-6
"""Share of a length that rounding may make."""


def require_possible(shape: Shape, scene: SceneConfig) -> None:
    """Check that a part has an area, is not thinner than its clearance, and fits its own socket and plate.

    Raises:
        RequestError: The part cannot be made.
    """
    peg, gap = peg_outline(shape, scene), scene.clearance_of(shape)
    if peg.is_empty:
        raise _impossible(shape, "the section is empty")
    if _thin_area(peg, gap) > 0:
        raise _impossible(shape, f"a piece of its section is thinner than the clearance ({gap} m)")
    x0, y0, x1, y1 = peg.bounds
    across = max(x1 - x0, y1 - y0)
    if across > (1 + _ROUNDING) * MOST_ACROSS_M:
        raise _impossible(shape, f"it is {across:.3g} m wide: expected at most {MOST_ACROSS_M}")
    hole = hole_outline(shape, scene)
    for field, figure, by in (
        ("chamfer_m", peg, shape.chamfer_m),
        ("socket.chamfer_m", hole, -shape.socket.chamfer_m),
    ):
        if not _keeps_its_sides(figure, by):
            raise _impossible(shape, f"{field}: {abs(by)} leaves no room for a side of its section")
    _require_socket(shape, scene, peg, hole)


def _require_socket(shape: Shape, scene: SceneConfig, peg: MultiPolygon, hole: MultiPolygon) -> None:
    """Check that a peg fits its own socket with its clearance, and the socket its plate."""
    gap = scene.clearance_of(shape)
    if not hole.contains(peg):
        raise _impossible(shape, "the peg does not fit its own socket")
    least = float(peg.boundary.distance(hole.boundary))
    if least < (1 - shape.facet_error - _ROUNDING) * gap:
        raise _impossible(
            shape, f"clearance_m: {gap:g} is more than the gap to its socket's section ({least:.3g} m)"
        )
    reach, most = (
        max(map(abs, hole.bounds)) + shape.socket.chamfer_m,
        scene.plate_half_width_m - PLATE_RIM_M,
    )
    if reach > most:
        raise _impossible(
            shape,
            f"socket: its mouth reaches {reach:.3g} m from the axis: expected at most {most:g}, "
            f"scene.plate_half_width_m less {PLATE_RIM_M}",
        )


def _thin_area(figure: MultiPolygon, width_m: float) -> float:
    """Return the area of what is thinner than a width, m²: corners are not."""
    by = 0.499 * width_m
    core = figure.buffer(-by, join_style="mitre", mitre_limit=MITRE_LIMIT)
    return figure.difference(grown(core, by + 10 * GRID_M)).area


def _keeps_its_sides(figure: MultiPolygon, by_m: float) -> bool:
    """Check that no side vanishes and no sides meet if all are moved inwards by a distance."""
    moved = inset(figure, by_m)
    before, after = (
        [np.diff(np.asarray(ring.coords), axis=0) for ring in rings_of(each)] for each in (figure, moved)
    )
    same_way = all((one * other).sum(1).min() > 0 for one, other in zip(before, after, strict=True))
    return same_way and moved.is_valid


def _impossible(shape: Shape, why: str) -> RequestError:
    return RequestError(f"config: scene.shapes: {shape.name} cannot be used: {why}")
