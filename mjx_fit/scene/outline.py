"""Outlines of parts as polygons: cross-sections whose arcs are replaced by facets.

A facet errs by at most a stated tolerance: half of it inside and half outside of a whole circle, all of it on
the side of the chord for other arcs.
"""

import math
from collections.abc import Iterator

import numpy as np
import shapely
from jaxtyping import Float
from shapely import LinearRing, MultiPolygon, Polygon
from shapely.affinity import rotate, translate
from shapely.affinity import scale as scale_about_origin
from shapely.geometry.base import BaseGeometry

from mjx_fit.config.sections.cross_section import CrossSection, Rectangle
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.utils.errors import RequestError, shown

GRID_M = 1e-9
"""Coordinates are rounded to this grid, so that figures which touch share their corners."""
MITRE_LIMIT = 10.0
PLATE_RIM_M = 0.001
"""Narrowest rim of a plate around a hole."""


def outline(section: CrossSection, tolerance_m: float) -> MultiPolygon:
    """Convert a cross-section to polygons.

    Args:
        section: Cross-section.
        tolerance_m: Largest distance of a facet from its arc, m.
    """
    kinds = {
        "circle": lambda one: _circle(one.diameter_m / 2, tolerance_m),
        "rectangle": lambda one: _rectangle(one, tolerance_m),
        "polygon": lambda one: _ring(one.sides, one.inscribed_diameter_m / 2 / math.cos(math.pi / one.sides)),
        "star": lambda one: _star(one.points, one.diameter_m / 2, one.inner_diameter_m / 2),
        "path": lambda one: _path(one, tolerance_m),
        "union": lambda parts: shapely.union_all([outline(part, tolerance_m) for part in parts], GRID_M),
        "difference": lambda parts: outline(parts[0], tolerance_m).difference(
            shapely.union_all([outline(part, tolerance_m) for part in parts[1:]], GRID_M), GRID_M
        ),
    }
    figure = next(
        make(getattr(section, kind)) for kind, make in kinds.items() if getattr(section, kind) is not None
    )
    x, y = section.at_m
    figure = translate(rotate(figure, section.turn_deg, (0, 0)), x, y)
    return _polygons(shapely.set_precision(figure, GRID_M))


def peg_outline(shape: Shape, scene: SceneConfig, scale: float = 1.0) -> MultiPolygon:
    """Return the outline of a peg as it is seen from above when inserted, m.

    Args:
        shape: The part.
        scene: Defines the clearance where the part does not, and the share of it that facets may err by.
        scale: Factor of the cross-section.
    """
    if shape.section is None:
        figure = shapely.union_all([shapely.box(*corners) for corners in shape.rectangles])
    else:
        figure = outline(shape.section, facet_tolerance_m(shape, scene))
    return _polygons(scale_about_origin(figure, scale, scale, origin=(0, 0)))


def hole_outline(shape: Shape, scene: SceneConfig, scale: float = 1.0) -> MultiPolygon:
    """Return the outline of a hole: the peg's grown by the clearance, or the socket's own, m."""
    if shape.socket.section is None:
        return grown(peg_outline(shape, scene, scale), scene.clearance_of(shape))
    figure = outline(shape.socket.section, facet_tolerance_m(shape, scene))
    return _polygons(scale_about_origin(figure, scale, scale, origin=(0, 0)))


def contact_width_m(shape: Shape, scene: SceneConfig) -> float:
    """Return the depth over which the impedance of a part's contact rises, m: at most a tenth of its gap.

    The configured parts of rectangles keep the configured depth.
    """
    if shape.section is None and shape.clearance_m is None:
        return scene.contact_width_m
    return min(scene.contact_width_m, LEAST_GAPS * scene.clearance_of(shape))


LEAST_GAPS = 0.1
"""Share of the clearance within which 99.9 % of penetrations should stay."""


def facet_tolerance_m(shape: Shape, scene: SceneConfig) -> float:
    """Return how far a facet may be from its arc, m: peg and socket share what the gap may err by."""
    return shape.facet_error * scene.clearance_of(shape) / 2


def is_its_own_mirror_image(shape: Shape, scene: SceneConfig) -> bool:
    """Check whether peg and hole are symmetric about the plane y = 0, to within the error of facets."""
    most_m = 2 * facet_tolerance_m(shape, scene)

    def is_symmetric(figure: MultiPolygon) -> bool:
        mirrored = scale_about_origin(figure, 1, -1, origin=(0, 0))
        return bool(shapely.hausdorff_distance(figure.boundary, mirrored.boundary) <= most_m)

    return is_symmetric(peg_outline(shape, scene)) and is_symmetric(hole_outline(shape, scene))


def rings_of(figure: MultiPolygon) -> Iterator[LinearRing]:
    """Yield outer and inner rings of all polygons."""
    return (ring for part in figure.geoms for ring in (part.exterior, *part.interiors))


def grown(figure: BaseGeometry, gap_m: float) -> MultiPolygon:
    """Grow an outline by a gap on every side; corners stay corners."""
    return _polygons(figure.buffer(gap_m, join_style="mitre", mitre_limit=MITRE_LIMIT))


def inset(figure: MultiPolygon, by_m: float) -> MultiPolygon:
    """Move all sides into the material, or out of it, by a distance, m; every corner stays a corner."""
    return MultiPolygon(
        [
            Polygon(rings[0], rings[1:])
            for rings in (
                [inset_corners(np.asarray(ring.coords)[:-1], by_m) for ring in rings_of(MultiPolygon([part]))]
                for part in figure.geoms
            )
        ]
    )


def inset_corners(corners: Float[np.ndarray, "n 2"], by_m: float) -> Float[np.ndarray, "n 2"]:
    """Move the sides of a ring into its material by a distance, m; see ``inset``."""
    step = np.roll(corners, -1, 0) - corners
    outward = np.column_stack([step[:, 1], -step[:, 0]]) / np.linalg.norm(step, axis=1, keepdims=True)
    before = np.roll(outward, 1, 0)
    return corners - by_m * (before + outward) / (1 + (before * outward).sum(1, keepdims=True))


def _polygons(figure) -> MultiPolygon:
    """Keep the areas of a figure, counter-clockwise, without points on straight lines."""
    parts = [
        part for part in getattr(figure, "geoms", [figure]) if part.geom_type == "Polygon" and part.area > 0
    ]
    return MultiPolygon([shapely.orient_polygons(part.simplify(0)) for part in parts])


def _ring(n: int, radius: float, first: float | None = None) -> Polygon:
    """Return a regular polygon; without ``first``, one side lies parallel to x, below the centre."""
    first = -math.pi / 2 + math.pi / n if first is None else first
    angle = first + 2 * math.pi * np.arange(n) / n
    return Polygon(radius * np.stack([np.cos(angle), np.sin(angle)], 1))


def _circle(radius: float, tolerance_m: float) -> Polygon:
    """Return a polygon of an even number of sides, half inside and half outside of the circle."""
    n = 2 * math.ceil(math.pi / (4 * math.atan(math.sqrt(tolerance_m / radius))))
    n = max(n, 6)
    return _ring(n, 2 * radius / (1 + math.cos(math.pi / n)))


def _star(points: int, outer: float, inner: float) -> Polygon:
    angle = math.pi / 2 + math.pi * np.arange(2 * points) / points
    radius = np.where(np.arange(2 * points) % 2 == 0, outer, inner)
    return Polygon(np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1))


def _rectangle(one: Rectangle, tolerance_m: float) -> Polygon:
    (x, y), fillet = (side / 2 for side in one.size_m), one.fillet_m
    if fillet == 0:
        return Polygon([(-x, -y), (x, -y), (x, y), (-x, y)])
    turn = math.tan(math.pi / 8)
    corners = (
        (x - fillet, -y, turn), (x, -y + fillet), (x, y - fillet, turn), (x - fillet, y),
        (-x + fillet, y, turn), (-x, y - fillet), (-x, -y + fillet, turn), (-x + fillet, -y),
    )  # fmt: skip
    return _path(corners, tolerance_m)


def _path(corners, tolerance_m: float) -> Polygon:
    points = []
    for here, there in zip(corners, (*corners[1:], corners[0]), strict=True):
        points += _arc(here, there, tolerance_m)
    figure = Polygon(points) if len(points) > 2 else Polygon()
    if not figure.is_valid or figure.area == 0:
        why = "it has no area" if figure.is_valid else shapely.is_valid_reason(figure)
        raise RequestError(f"config: scene.shapes: path: {shown(list(corners))} is invalid: {why}")
    return figure


def _arc(here, there, tolerance_m: float) -> list[tuple[float, float]]:
    """Return the points of a straight line or an arc, without the last one."""
    start, end = complex(*here[:2]), complex(*there[:2])
    bulge = here[2] if len(here) == 3 else 0.0
    if bulge == 0 or start == end:
        return [(start.real, start.imag)]
    sweep = 4 * math.atan(bulge)
    centre = (start + end) / 2 + 1j * (end - start) / 2 * (1 - bulge**2) / (2 * bulge)
    radius = abs(start - centre)
    half = math.acos(max(1 - tolerance_m / radius, -1.0))
    n = max(math.ceil(abs(sweep) / (2 * half)), 1)
    points = centre + (start - centre) * np.exp(1j * sweep * np.arange(n) / n)
    return [(point.real, point.imag) for point in points]
