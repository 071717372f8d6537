import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import SHAPES, Shape
from mjx_fit.control.policies import SPIRAL
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.scene.outline import is_its_own_mirror_image
from mjx_fit.scene.parts import hole_boxes, peg_boxes, plate_top_m
from mjx_fit.training.split import require_symmetric
from mjx_fit.types import Attempt
from mjx_fit.utils.errors import RequestError

SCENE = SceneConfig()


def inside(boxes, points):
    """Number of boxes that each point (n, 3) lies in."""
    return (np.abs(points[:, None] - boxes.centre) < boxes.half).all(-1).sum(1)


def section(shape, points):
    """Whether each point (n, 2) lies in a shape's cross-section, straight from its rectangles."""
    low, high = np.split(np.asarray(shape.rectangles), 2, axis=1)
    return ((points[:, None] > low) & (points[:, None] < high)).all(-1).any(1)


ELL = Shape("ell", ((-0.020, -0.020, 0.000, 0.020), (0.000, -0.020, 0.020, 0.000)))
TEE = Shape("tee", ((-0.020, -0.020, 0.000, 0.020), (0.000, -0.008, 0.020, 0.008)))
FLIPPED = Shape("flipped", tuple((x0, -y1, x1, -y0) for x0, y0, x1, y1 in ELL.rectangles))
PLUG = Shape("plug", ((-0.015, -0.012, -0.005, 0.012), (0.005, -0.012, 0.015, 0.012)))
ALL = (*SHAPES, ELL, TEE, PLUG)


def test_sizes_are_the_design_pages():
    extent = {shape.name: tuple(2 * np.max(shape.rectangles, 0)[2:]) for shape in SHAPES}
    assert extent == {"cross": (0.04, 0.04), "rectangle": (0.04, 0.025), "square": (0.03, 0.03)}
    assert SHAPES[0].rectangles == ((-0.02, -0.01, 0.02, 0.01), (-0.01, -0.02, 0.01, 0.02))


@pytest.mark.parametrize("shape", ALL, ids=lambda shape: shape.name)
@given(clearance=st.floats(0.0002, 0.004), seed=st.integers(0, 2**32 - 1))
def test_hole_is_the_complement_of_the_widened_peg(shape, clearance, seed):
    scene = dataclasses.replace(SCENE, clearance_m=clearance)
    low = [-scene.plate_half_width_m] * 2 + [-scene.hole_depth_m]
    points = np.random.default_rng(seed).uniform(low, [scene.plate_half_width_m] * 2 + [0], (2000, 3))
    widened = dataclasses.replace(
        shape,
        rectangles=tuple(
            (a - clearance, b - clearance, c + clearance, d + clearance) for a, b, c, d in shape.rectangles
        ),
    )
    free = section(widened, points[:, :2])
    assert np.array_equal(inside(hole_boxes(shape, scene), points), np.where(free, 0, 1))


@pytest.mark.parametrize("shape", ALL, ids=lambda shape: shape.name)
def test_peg_is_its_section_extruded(shape):
    points = np.random.default_rng(0).uniform(
        [-0.025, -0.025, 0], [0.025, 0.025, SCENE.peg_length_m], (4000, 3)
    )
    seen = section(shape, points[:, :2] * [1, -1])  # the tool looks down
    assert np.array_equal(inside(peg_boxes(shape, SCENE), points) > 0, seen)


def test_hole_has_a_floor_below_its_depth():
    point = np.array([[0, 0, -SCENE.hole_depth_m - 0.001]])
    assert all(inside(hole_boxes(shape, SCENE), point) == 1 for shape in SHAPES)
    assert plate_top_m(SCENE) > SCENE.hole_depth_m >= 0.03


@pytest.mark.parametrize(
    ("peg", "hole"),
    [*itertools.product(SHAPES, SHAPES), (ELL, ELL), (TEE, TEE), (PLUG, PLUG), (FLIPPED, ELL)],
)
def test_a_peg_enters_its_own_hole_only(peg, hole):
    """Minkowski: a rectangle of the peg hits a wall unless it is off by more than the sum of half sizes."""
    walls = hole_boxes(hole, SCENE)
    offset = np.stack(np.meshgrid(*[np.linspace(-0.03, 0.03, 601)] * 2), -1).reshape(-1, 1, 1, 2)
    boxes = peg_boxes(peg, SCENE)
    middle, half = (boxes.centre * [1, -1, -1])[:, None, :2], boxes.half[:, None, :2]  # it hangs down
    hits = (
        (np.abs(offset + middle - walls.centre[1:, :2]) < half + walls.half[1:, :2] - 1e-9)
        .all(-1)
        .any(-1)
        .any(-1)
    )
    assert hits.all() == (peg is not hole)


def test_a_lopsided_peg_goes_into_its_own_hole_alone():
    """On real physics, from where the hole is: an L and its mirror image."""
    config = Config(scene=SceneConfig(shapes=(ELL, FLIPPED, SHAPES[2])))
    peg, hole = jnp.array([0, 1, 2, 0, 1]), jnp.array([0, 1, 2, 1, 0])
    place = jnp.tile(jnp.array([0.5, 0.1]), (5, 1))
    keys = jax.random.split(jax.random.key(0), 5)
    attempts = Attempt(peg, hole, place, place, jnp.full(5, SPIRAL), keys)
    done = NativeEngine(config, 2).run(attempts, 30, horizon=100)
    assert done.truth.valid.all()
    assert np.array_equal(done.truth.inserted, peg == hole)


def test_a_lopsided_shape_is_not_shown_mirrored():
    assert all(is_its_own_mirror_image(shape, SCENE) for shape in (*SHAPES, TEE))
    assert not is_its_own_mirror_image(ELL, SCENE)
    shapes = [{"name": s.name, "rectangles": [list(r) for r in s.rectangles]} for s in (ELL, *SHAPES[1:])]
    config = read_config(None, [f"scene.shapes={shapes}", "train.mirror=false"])
    assert config.scene.names == ("ell", "rectangle", "square")
    mirrored = read_config(None, [f"scene.shapes={shapes}", "train.mirror=true"])
    with pytest.raises(RequestError, match=r"train\.mirror: .* 'ell' is not mirror-symmetric"):
        require_symmetric(mirrored)
    require_symmetric(config)


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        ([], "scene.shapes"),
        ([{"name": f"s{i}", "rectangles": [[0, 0, 0.01, 0.01]]} for i in range(13)], "scene.shapes"),
        ([{"name": "a", "rectangles": [[0.01, 0, 0, 0.01]]}] * 3, "a lower and an upper corner"),
        ([{"name": "A b", "rectangles": [[0, 0, 0.01, 0.01]]}] * 3, "scene.shapes.0.name"),
        ([{"name": "a", "rectangles": [[0, 0, 0.5, 0.01]]}] * 3, "scene.shapes.0.rectangles"),
        ([{"name": "a", "rectangles": [[0, 0, 0.01, 0.01]]}] * 3, "the names must differ"),
        (
            [{"name": "a", "rectangles": [[0, 0, 0.01, 0.01]], "hue": 1}] * 3,
            "hue: unknown key; allowed here: name",
        ),
    ],
)
def test_shapes_that_are_none(shapes, words):
    with pytest.raises(RequestError, match=words) as error:
        read_config(None, [f"scene.shapes={shapes}"])
    assert "\n" not in str(error.value)


def test_rounding_leaves_no_slivers():
    wide = dataclasses.replace(SCENE, clearance_m=0.002)
    near = Shape("near", ((-0.02, -0.02, 0.013, 0.02), (0.017, -0.02, 0.02, 0.02)))  # the gaps meet
    assert hole_boxes(near, wide).half.min() > 1e-6


@given(half_width=st.floats(0.0, 0.03), radius=st.floats(0.001, 0.04), plate=st.floats(0.08, 0.12))
def test_a_peg_that_is_let_through_stays_over_its_plate(half_width, radius, plate):
    """Straight from the corners: the worst error and the worst of the spiral along either axis."""
    settings = (f"detector.half_width_m={half_width}", f"spiral.radius_m={radius}")
    try:
        config = read_config(None, [*settings, f"scene.plate_half_width_m={plate}"])
    except RequestError:
        return
    corners = np.abs([rectangle for shape in config.scene.shapes for rectangle in shape.rectangles])
    assert half_width + radius + corners.max() <= plate
