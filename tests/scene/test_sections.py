"""Sections as half-planes and discs, against shapely's polygons."""

import numpy as np
import pytest
import shapely

import mjx_fit as mf
from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.scene.outline import hole_outline, peg_outline
from mjx_fit.scene.sections import FACET_M, sections_of

SCENES = {"paper": mf.Config().scene} | {
    name: read_config(parts_file(name)).scene for name in ("nonconvex", "nist", "shafts")
}


def depth(section, part, points):
    """How far inside points (n, 2) are: NumPy, from the definition."""
    sides = section.sides[part]
    inside = (sides[..., 2] - np.einsum("nd,ksd->nks", points, sides[..., :2])).min(-1)
    if section.discs is not None:
        discs = section.discs[part]
        inside = np.minimum(inside, discs[:, 2] - np.linalg.norm(points[:, None] - discs[:, :2], axis=-1))
    return inside.max(-1)


def require_inside(figures):
    """Compare which points are inside, away from the edges."""
    section, rng = sections_of(figures), np.random.default_rng(0)
    for part, figure in enumerate(figures):
        low, high = np.array(figure.bounds).reshape(2, 2)
        points = rng.uniform(low - 0.002, high + 0.002, (4000, 2))
        near = shapely.distance(shapely.boundary(figure), shapely.points(points)) < 2 * FACET_M
        far = points[~near]
        inside = shapely.contains_xy(figure, *far.T)
        assert inside.any()
        assert not inside.all()
        np.testing.assert_array_equal(depth(section, part, far) > 0, inside, f"part {part}")


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("outline", [peg_outline, hole_outline])
def test_inside_is_inside_of_the_polygon(name, outline):
    require_inside([outline(shape, SCENES[name]) for shape in SCENES[name].shapes])


def test_an_arc_that_is_not_all_around_cuts_nothing_off():
    """The ends of a slot are arcs of discs that do not contain it."""
    require_inside([shapely.MultiPolygon([shapely.LineString([(0, 0), (0.02, 0)]).buffer(0.005)])])


def test_an_arc_is_one_disc():
    scene = SCENES["nonconvex"]
    section = sections_of([peg_outline(shape, scene) for shape in scene.shapes])
    assert section.discs is not None
    key = scene.names.index("key")
    disc = section.discs[key][np.argmin(section.discs[key][:, 2])]
    np.testing.assert_allclose(disc, [0, 0, 0.01], atol=1e-5)
    assert section.sides.shape[2] == 7  # those of the star's pentagon with two corners of its arms


def test_parts_without_an_arc_have_no_discs():
    scene = SCENES["paper"]
    assert sections_of([peg_outline(shape, scene) for shape in scene.shapes]).discs is None
