"""Which peg fits which socket, against shapely and against positions that are known to fit."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import MultiPolygon, Polygon
from shapely.affinity import rotate, translate

from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.scene.fits import fits, fits_turned, fitting
from mjx_fit.scene.outline import grown


def box(width, height):
    return MultiPolygon([shapely.box(-width / 2, -height / 2, width / 2, height / 2)])


@st.composite
def jagged(draw):
    """Star-shaped polygons of seven corners, in m."""
    turns = np.cumsum(draw(st.lists(st.floats(0.5, 1.0), min_size=7, max_size=7)))
    radii = np.array(draw(st.lists(st.floats(0.004, 0.011), min_size=7, max_size=7)))
    angle = 2 * np.pi * turns / turns[-1]
    return MultiPolygon([Polygon(np.column_stack([radii * np.cos(angle), radii * np.sin(angle)]))])


@settings(deadline=None, max_examples=30)
@given(jagged(), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01))
def test_a_peg_fits_its_own_socket_wherever_that_is(peg, x, y):
    assert fits(peg, translate(grown(peg, 5e-5), x, y))
    assert not fits(peg, translate(grown(peg, -5e-5), x, y))


@settings(deadline=None, max_examples=10)
@given(jagged(), st.floats(0, 360))
def test_a_turned_socket_takes_a_turned_peg(peg, yaw):
    hole = rotate(grown(peg, 1e-4), yaw, origin=(0, 0))
    assert fits_turned(peg, hole)


@pytest.mark.parametrize("shape", ["paper", "nist", "shafts", "nonconvex"])
def test_every_peg_of_a_set_fits_its_own_socket(shape):
    assert fitting(read_config(parts_file(shape)).scene).diagonal().all()


def test_a_blade_fits_a_square_along_the_diagonal_alone():
    """The widest blade of thickness t in a square of side s is s √2 - t long."""
    square, thickness = box(0.01, 0.01), 0.0006
    longest = 0.01 * math.sqrt(2) - thickness
    for length, fit in ((longest - 2e-5, True), (longest + 1e-5, False)):
        blade = box(length, thickness)
        assert fits_turned(blade, square) == fit
        assert not fits(blade, square)
        assert fits(rotate(blade, 45), square) == fit


def test_a_square_enters_a_cross_between_its_arms():
    """No side of either is along a side of the other there."""
    square = box(0.03, 0.03)
    cross = MultiPolygon([box(0.042, 0.022).geoms[0].union(box(0.022, 0.042))])  # pyright: ignore
    assert fits_turned(square, cross)
    assert cross.contains(rotate(square, 36))
    assert not any(fits(rotate(square, yaw), cross) for yaw in (0, 45))


def test_prongs_fit_a_slot_and_two_holes_but_not_holes_that_are_further_apart():
    def pair(width, apart):
        return MultiPolygon([part for x in (-apart, apart) for part in translate(box(width, 0.01), x).geoms])

    prongs = pair(0.004, 0.005)
    assert fits(prongs, grown(box(0.014, 0.01), 1e-4))
    assert fits(prongs, grown(prongs, 1e-4))
    assert not fits(prongs, grown(pair(0.004, 0.0055), 1e-4))


def regular(sides, radius):
    angle = 2 * np.pi * np.arange(sides) / sides
    return MultiPolygon([Polygon(radius * np.column_stack([np.cos(angle), np.sin(angle)]))])


def test_pegs_of_the_size_of_a_round_hole_fit_where_its_corners_are():
    """Of 64 corners, every 16th takes a corner of a square; no yaw has one for all six of a hexagon."""
    hole = regular(64, 8.1025e-3)
    for yaw in (0.0, 3.0):
        square = rotate(regular(4, 8.102e-3), yaw)
        assert fits_turned(square, hole)
        hexagon = rotate(regular(6, 8.1e-3), yaw)
        assert not fits_turned(hexagon, hole)
    assert fits_turned(regular(6, 8.09e-3), hole)
