"""Places in relation to outlines against shapely."""

import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from shapely import BufferJoinStyle

from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import SHAPES
from mjx_fit.engines.mjx import outlines
from mjx_fit.engines.mjx.boundary import Boundary, boundary
from mjx_fit.scene.outline import hole_outline

SHAFTS = read_config(parts_file("shafts")).scene
PARTS = [(shape, SceneConfig()) for shape in SHAPES] + [(shape, SHAFTS) for shape in SHAFTS.shapes]
N = 2000


def related(shape, scene, point) -> Boundary:
    """Places in relation to a hole, whose outline has as many spare sides as among parts with more sides."""
    outline = outlines.socket_of(shape, scene).outline
    outline = outlines._spread(outline, 3 * outline.start.shape[1] + 1)
    sides = (jnp.asarray(vectors, jnp.float32)[..., None] for vectors in outline)
    found = boundary(type(outline)(*sides), jnp.asarray(point.T, jnp.float32)[..., None])
    return Boundary(*(np.asarray(field)[..., 0] for field in found))


def around(figure, near_m=None):
    """Points around a figure, or within a distance of its corners."""
    rng = np.random.default_rng(0)
    if near_m is None:
        x0, y0, x1, y1 = figure.buffer(0.005).bounds
        return rng.uniform((x0, y0), (x1, y1), (N, 2))
    corners = shapely.get_coordinates(figure)
    return corners[rng.integers(len(corners), size=N)] + rng.uniform(-near_m, near_m, (N, 2))


@pytest.mark.parametrize(("shape", "scene"), PARTS, ids=[shape.name for shape, _ in PARTS])
def test_inside_distance_and_way_out(shape, scene):
    figure = hole_outline(shape, scene)
    for near_m in (None, 2e-5):
        point = around(figure, near_m)
        at = related(shape, scene, point)
        where = shapely.points(point)
        distance = np.asarray(shapely.distance(where, figure.boundary))
        np.testing.assert_allclose(at.distance, distance, rtol=1e-4, atol=1e-8)
        clear = distance > 1e-7
        np.testing.assert_array_equal(at.inside[clear], np.asarray(shapely.contains(figure, where))[clear])
        # The way out leads over the boundary.
        to_boundary = at.distance * np.where(at.inside, 1.0, -1.0)
        foot = shapely.points(point + (to_boundary * at.outward).T)
        assert np.asarray(shapely.distance(foot, figure.boundary))[clear].max() < 1e-7


@pytest.mark.parametrize("name", ["cross", "hexagon", "d_shaft", "keyed_shaft"])
def test_lines_of_equal_mitred_distance_have_corners(name):
    shape, scene = next(part for part in PARTS if part[0].name == name)
    figure = hole_outline(shape, scene)
    point = around(figure, 2e-4)
    at = related(shape, scene, point)
    for i in np.flatnonzero(at.mitred > 1e-6)[:300]:
        signed = at.mitred[i] * (-1 if at.inside[i] else 1)
        closer, further = (
            figure.buffer(float(signed) + by, join_style=BufferJoinStyle.mitre, mitre_limit=100)
            for by in (-2e-7, 2e-7)
        )
        assert further.contains(shapely.Point(point[i]))
        assert not closer.contains(shapely.Point(point[i]))
