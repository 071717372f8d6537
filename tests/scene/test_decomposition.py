"""Convex pieces of polygons, against shapely."""

import numpy as np
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely import MultiPolygon, Polygon
from shapely.affinity import rotate, scale

from mjx_fit.scene.decomposition import convex_pieces

SHARE = 1e-9


@st.composite
def simple_polygons(draw):
    """Star-shaped polygons of up to twelve corners, some with a hole in the middle, in mm."""
    n = draw(st.integers(3, 12))
    turns = np.cumsum(draw(st.lists(st.floats(0.2, 1.0), min_size=n, max_size=n)))
    radii = np.array(draw(st.lists(st.floats(2.0, 10.0), min_size=n, max_size=n)))
    angle = 2 * np.pi * turns / turns[-1]
    outer = Polygon(np.stack([radii * np.cos(angle), radii * np.sin(angle)], 1))
    hole = Polygon([(0.5, -0.5), (0.2, 0.6), (-0.5, 0.1)])
    figure = outer.difference(hole) if draw(st.booleans()) else outer
    assume(figure.is_valid and figure.geom_type == "Polygon")
    return figure


def require_partition(figure, pieces):
    """Pieces are convex and counter-clockwise, do not overlap, and cover the figure."""
    polygons = [Polygon(piece) for piece in pieces]
    assert all(shapely.is_ccw(polygon.exterior) for polygon in polygons)
    for polygon in polygons:
        assert polygon.convex_hull.area <= polygon.area * (1 + SHARE)
    assert np.isclose(sum(polygon.area for polygon in polygons), figure.area, rtol=SHARE)
    assert shapely.union_all(polygons).symmetric_difference(figure).area < SHARE * figure.area


@settings(deadline=None)
@given(simple_polygons())
def test_polygons_are_divided_without_loss(figure):
    require_partition(figure, convex_pieces(figure))


@settings(deadline=None)
@given(simple_polygons(), st.floats(-180, 180), st.booleans())
def test_turned_and_mirrored_polygons_are_divided_without_loss(figure, degrees, mirrored):
    other = rotate(scale(figure, xfact=-1 if mirrored else 1, origin=(0, 0)), degrees, origin=(0, 0))
    require_partition(other, convex_pieces(other))


def test_separate_areas_are_divided_separately():
    prongs = MultiPolygon([shapely.box(-3, -1, -1, 1), shapely.box(1, -1, 3, 1)])
    pieces = convex_pieces(prongs)
    assert sorted(len(piece) for piece in pieces) == [4, 4]
    require_partition(prongs, pieces)


def test_convex_polygons_stay_whole():
    for n in (3, 4, 6, 24, 46):
        angle = 2 * np.pi * np.arange(n) / n
        assert [
            len(piece) for piece in convex_pieces(Polygon(np.stack([np.cos(angle), np.sin(angle)], 1)))
        ] == [n]


def test_a_cross_has_three_pieces_at_most():
    cross = shapely.union_all([shapely.box(-2, -1, 2, 1), shapely.box(-1, -2, 1, 2)])
    assert len(convex_pieces(cross)) == 3
