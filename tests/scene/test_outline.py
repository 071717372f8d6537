"""Outlines of cross-sections, against closed forms and dense sampling."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.affinity import rotate

from mjx_fit.config.sections.cross_section import Circle, CrossSection, Polygon, Rectangle, Star
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import SHAPES, Shape, Socket
from mjx_fit.scene.outline import (
    facet_tolerance_m,
    hole_outline,
    is_its_own_mirror_image,
    outline,
    peg_outline,
)
from mjx_fit.scene.part_rules import require_possible
from mjx_fit.utils.errors import RequestError

SCENE = SceneConfig()
ROUND = CrossSection(circle=Circle(0.008))
FLAT = CrossSection(rectangle=Rectangle((0.008, 0.001)), at_m=(0.0, 0.0035))
D_SHAFT = CrossSection(difference=(ROUND, FLAT))
TUBE = CrossSection(difference=(CrossSection(circle=Circle(0.016)), CrossSection(circle=Circle(0.010))))
PRONGS = CrossSection(
    union=tuple(CrossSection(rectangle=Rectangle((0.004, 0.008)), at_m=(x, 0.0)) for x in (-0.006, 0.006))
)
ALL = (
    ROUND,
    CrossSection(polygon=Polygon(6, 0.01)),
    CrossSection(star=Star(5, 0.03, 0.014), turn_deg=10.0),
    CrossSection(rectangle=Rectangle((0.012, 0.0045), 0.001)),
    D_SHAFT,
    TUBE,
    PRONGS,
    CrossSection(path=((0.0, 0.0, 1.0), (0.01, 0.0), (0.01, 0.01), (0.0, 0.01))),
)


def sampled(figure, n=4000):
    """Points on the boundary of polygons, evenly spaced (n, 2)."""
    places = np.linspace(0, 1, n)
    return shapely.get_coordinates(shapely.line_interpolate_point(figure.boundary, places, normalized=True))


def corners(figure, least_rad=0.3):
    """Corners of polygons at which the boundary turns by more than an angle, as a multi-point."""
    found = []
    for polygon in figure.geoms:
        for ring in (polygon.exterior, *polygon.interiors):
            points = np.asarray(ring.coords)[:-1] @ [1, 1j]
            turn = np.angle((np.roll(points, -1) - points) / (points - np.roll(points, 1)))
            found += [(point.real, point.imag) for point in points[abs(turn) > least_rad]]
    return shapely.MultiPoint(found)


@given(st.floats(0.001, 0.05), st.floats(1e-6, 1e-4))
def test_facets_of_a_circle_err_as_much_inside_as_outside(diameter, tolerance):
    figure = outline(CrossSection(circle=Circle(diameter)), tolerance)
    error = np.hypot(*sampled(figure).T) - diameter / 2
    assert abs(error).max() <= tolerance * 1.001 + 2e-9
    assert error.max() + error.min() == pytest.approx(0, abs=0.05 * tolerance + 2e-9)


@given(st.floats(-2, 2).filter(lambda bulge: abs(bulge) > 0.01), st.floats(1e-6, 1e-4))
def test_facets_of_an_arc_are_as_near_to_it_as_stated(bulge, tolerance):
    """From (-5, 0) to (5, 0) mm: the arc's height is the bulge times half the chord."""
    chord, far = 0.01, (0.0, math.copysign(0.025, bulge))
    figure = outline(CrossSection(path=((-0.005, 0.0, bulge), (0.005, 0.0), far)), tolerance)
    height = bulge * chord / 2
    centre, radius = (
        (0.0, (height**2 - chord**2 / 4) / (2 * -height)),
        abs(height) / 2 + chord**2 / 8 / abs(height),
    )
    points = sampled(figure)
    on_arc = points[points[:, 1] * bulge < -1e-7]
    error = np.hypot(*(on_arc - centre).T) - radius
    assert abs(error).max() <= tolerance * 1.001 + 2e-9


def test_areas_are_those_of_closed_forms():
    tolerance = 1e-7
    areas = {
        ROUND: math.pi * 0.004**2,
        ALL[1]: 0.01**2 * math.sqrt(3) / 2,
        ALL[2]: 10 * 0.5 * 0.015 * 0.007 * math.sin(math.pi / 5),
        ALL[3]: 0.012 * 0.0045 - (4 - math.pi) * 0.001**2,
        TUBE: math.pi * (0.008**2 - 0.005**2),
        PRONGS: 2 * 0.004 * 0.008,
        ALL[7]: 0.01**2 + math.pi * 0.005**2 / 2,
    }
    for section, area in areas.items():
        assert outline(section, tolerance).area == pytest.approx(area, rel=2e-4)


@pytest.mark.parametrize("section", ALL)
def test_the_gap_is_the_clearance_all_around(section):
    """Nowhere smaller by more than a tenth, nor larger, but for sharp corners, where it is longer."""
    gap = 0.0001
    shape = Shape("any", section=section, clearance_m=gap)
    peg, hole = peg_outline(shape, SCENE), hole_outline(shape, SCENE)
    points = shapely.points(sampled(peg))
    ratio = np.asarray(shapely.distance(points, hole.boundary)) / gap
    assert ratio.min() > 0.9
    away = np.nan_to_num(shapely.distance(points, corners(peg)), nan=1.0) > 3 * gap
    assert ratio[away].max() < 1.1
    assert away.mean() > 0.85
    assert hole.contains(peg)


def test_round_parts_keep_their_gap_at_any_yaw():
    shape = Shape("peg", section=ROUND, clearance_m=0.0001)
    peg, hole = peg_outline(shape, SCENE), hole_outline(shape, SCENE)
    for degrees in np.linspace(0, 8, 17):
        turned = rotate(peg, degrees, origin=(0, 0))
        gap = shapely.distance(shapely.points(sampled(turned)), hole.boundary)
        assert abs(gap / 0.0001 - 1).max() < 0.11
    assert facet_tolerance_m(shape, SCENE) == pytest.approx(0.05 * SCENE.clearance_of(shape))


def test_the_papers_parts_are_their_rectangles():
    for shape in SHAPES:
        peg = peg_outline(shape, SCENE)
        assert peg.area == pytest.approx(
            shapely.union_all([shapely.box(*each) for each in shape.rectangles]).area
        )
        assert hole_outline(shape, SCENE).bounds == pytest.approx(
            [np.sign(edge) * (abs(edge) + SCENE.clearance_m) for edge in peg.bounds]
        )


@settings(deadline=None)
@given(st.floats(-180, 180), st.floats(-0.005, 0.005), st.floats(-0.005, 0.005))
def test_turns_come_before_moves(degrees, x, y):
    corner = CrossSection(path=((0.0, 0.0), (0.01, 0.0), (0.0, 0.004)), turn_deg=degrees, at_m=(x, y))
    turn = np.exp(1j * math.radians(degrees))
    wanted = [turn * point + complex(x, y) for point in (0, 0.01, 0.004j)]
    found = [complex(*point) for point in shapely.get_coordinates(outline(corner, 1e-5))]
    assert max(min(abs(point - other) for other in found) for point in wanted) < 2e-9


def test_mirror_images():
    same = Shape("d", section=D_SHAFT)
    turned = Shape("d", section=CrossSection(union=(D_SHAFT,), turn_deg=90.0))
    assert not is_its_own_mirror_image(same, SCENE)
    assert is_its_own_mirror_image(turned, SCENE)
    lopsided = Shape(
        "any", section=ROUND, socket=Socket(section=CrossSection(circle=Circle(0.009), at_m=(0.0, 1e-4)))
    )
    assert not is_its_own_mirror_image(lopsided, SCENE)
    assert all(is_its_own_mirror_image(shape, SCENE) for shape in SHAPES)


@pytest.mark.parametrize(
    ("shape", "why"),
    [
        (Shape("none", section=CrossSection(difference=(FLAT, ROUND, FLAT))), "the section is empty"),
        (
            Shape("thin", section=CrossSection(rectangle=Rectangle((0.01, 0.0005)))),
            "thinner than",
        ),
        (
            Shape(
                "rib",
                section=CrossSection(
                    union=(ROUND, CrossSection(rectangle=Rectangle((0.0009, 0.004)), at_m=(0.0, 0.005)))
                ),
            ),
            "thinner than",
        ),
        (Shape("large", section=CrossSection(polygon=Polygon(3, 0.06))), "is 0.104 m wide: expected at most"),
        (
            Shape(
                "off_the_plate",
                section=ROUND,
                socket=Socket(
                    section=CrossSection(
                        union=(
                            CrossSection(circle=Circle(0.06)),
                            *(
                                CrossSection(rectangle=Rectangle((0.06, 0.002)), at_m=(x, 0.0))
                                for x in (0.028, 0.03)
                            ),
                        ),
                        at_m=(0.02, 0.0),
                    )
                ),
            ),
            "socket: its mouth reaches 0.0[89].* expected at most 0.079",
        ),
        (
            Shape("wide", section=ROUND, socket=Socket(section=CrossSection(circle=Circle(0.0079)))),
            "does not fit its own socket",
        ),
        (
            Shape("bow", section=CrossSection(path=((0.0, 0.0), (0.01, 0.01), (0.01, 0.0), (0.0, 0.01)))),
            "path: .* is invalid: Self-intersection",
        ),
        (Shape("line", section=CrossSection(path=((0.0, 0.0), (0.01, 0.01)))), "it has no area"),
    ],
)
def test_impossible_parts_are_refused(shape, why):
    with pytest.raises(RequestError, match=f"config: scene.shapes: .*{why}"):
        require_possible(shape, SCENE)


def test_a_clearance_that_the_socket_does_not_have_is_refused():
    """Stiffness and facets follow from it: too large a value would make the contact too soft, unsaid."""
    own = Socket(section=CrossSection(rectangle=Rectangle((0.01016, 0.00615))))
    section = CrossSection(rectangle=Rectangle((0.01, 0.006)))
    require_possible(Shape("one", section=section, clearance_m=0.000075, socket=own), SCENE)
    with pytest.raises(RequestError, match=r"clearance_m: 0\.0002 is more than the gap"):
        require_possible(Shape("one", section=section, clearance_m=0.0002, socket=own), SCENE)
