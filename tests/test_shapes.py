import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.config import SceneConfig
from mjx_fit.shapes import NAMES, SHAPES, hole_boxes, peg_boxes, plate_top_m

SCENE = SceneConfig()


def inside(boxes, points):
    """Number of boxes that each point (n, 3) lies in."""
    return (np.abs(points[:, None] - boxes.centre) < boxes.half).all(-1).sum(1)


def section(shape, points):
    """Whether each point (n, 2) lies in a shape's cross-section, straight from its rectangles."""
    return (np.abs(points[:, None]) < np.asarray(shape.rectangles)).all(-1).any(1)


def test_sizes_are_the_design_pages():
    extent = {shape.name: tuple(2 * np.max(shape.rectangles, 0)) for shape in SHAPES}
    assert extent == {"cross": (0.04, 0.04), "rectangle": (0.04, 0.025), "square": (0.03, 0.03)}
    assert SHAPES[0].rectangles == ((0.02, 0.01), (0.01, 0.02))


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
@given(clearance=st.floats(0.0002, 0.004), seed=st.integers(0, 2**32 - 1))
def test_hole_is_the_complement_of_the_widened_peg(shape, clearance, seed):
    scene = dataclasses.replace(SCENE, clearance_m=clearance)
    low = [-scene.plate_half_width_m] * 2 + [-scene.hole_depth_m]
    points = np.random.default_rng(seed).uniform(low, [scene.plate_half_width_m] * 2 + [0], (2000, 3))
    widened = dataclasses.replace(
        shape, rectangles=tuple((a + clearance, b + clearance) for a, b in shape.rectangles)
    )
    free = section(widened, points[:, :2])
    assert np.array_equal(inside(hole_boxes(shape, scene), points), np.where(free, 0, 1))


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
def test_peg_is_its_section_extruded(shape):
    points = np.random.default_rng(0).uniform(
        [-0.025, -0.025, 0], [0.025, 0.025, SCENE.peg_length_m], (4000, 3)
    )
    assert np.array_equal(inside(peg_boxes(shape, SCENE), points) > 0, section(shape, points[:, :2]))


def test_hole_has_a_floor_below_its_depth():
    point = np.array([[0, 0, -SCENE.hole_depth_m - 0.001]])
    assert all(inside(hole_boxes(shape, SCENE), point) == 1 for shape in SHAPES)
    assert plate_top_m(SCENE) > SCENE.hole_depth_m >= 0.03


@pytest.mark.parametrize(("peg", "hole"), list(itertools.product(SHAPES, SHAPES)))
def test_a_peg_enters_its_own_hole_only(peg, hole):
    """Minkowski: a rectangle of the peg hits a wall unless it is off by more than the sum of half sizes."""
    walls = hole_boxes(hole, SCENE)
    offset = np.stack(np.meshgrid(*[np.linspace(-0.03, 0.03, 601)] * 2), -1).reshape(-1, 1, 1, 2)
    rectangles = np.asarray(peg.rectangles)[:, None]
    hits = (
        (np.abs(offset - walls.centre[1:, :2]) < rectangles + walls.half[1:, :2] - 1e-9)
        .all(-1)
        .any(-1)
        .any(-1)
    )
    assert hits.all() == (peg is not hole)
