"""Pieces of pegs and sockets against the outlines that the other engine sees."""

from dataclasses import replace

import pytest
import shapely
from shapely import Polygon

from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.config.sections.cross_section import Circle, CrossSection, Rectangle, Star
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import SHAPES, Shape, Socket
from mjx_fit.scene.outline import hole_outline, inset, peg_outline
from mjx_fit.scene.part_rules import require_possible
from mjx_fit.scene.pieces import peg_pieces, socket_pieces
from mjx_fit.scene.variation import require_linear
from mjx_fit.utils.errors import RequestError

SCENE = SceneConfig()
ROUND = CrossSection(circle=Circle(0.004))
OWN = Socket(section=CrossSection(rectangle=Rectangle((0.0044, 0.0045))))
TEE = CrossSection(
    path=(
        *((-0.008, -0.006), (-0.003, -0.006), (-0.003, -0.0025), (0.008, -0.0025, 1.0)),
        *((0.008, 0.0025), (-0.003, 0.0025), (-0.003, 0.006), (-0.008, 0.006)),
    )
)
DISC = CrossSection(circle=Circle(0.02))
LUG = CrossSection(rectangle=Rectangle((0.006, 0.006)), at_m=(0.0, 0.01))
BORE = CrossSection(circle=Circle(0.008), at_m=(0.001, 0.0))
PRONGS = [CrossSection(rectangle=Rectangle((0.004, 0.01)), at_m=(x, 0.0)) for x in (-0.005, 0.005)]
CHAMFERED = {
    "tee": TEE,
    "key": CrossSection(union=(DISC, LUG)),
    "pipe": CrossSection(difference=(DISC, BORE)),
    "fork": CrossSection(union=tuple(PRONGS)),
    "spikes": CrossSection(star=Star(5, 0.03, 0.016)),
}
OVERLAP = 0.03
"""Share by which the pieces of a chamfer overlap, inside of the material."""
PARTS = {
    **{
        name: (
            Shape(name, section=one, clearance_m=0.0005, chamfer_m=0.0007, socket=Socket(chamfer_m=0.0009)),
            SCENE,
        )
        for name, one in CHAMFERED.items()
    },
    **{shape.name: (shape, SCENE) for shape in SHAPES},
    "own_clearance": (replace(SHAPES[0], name="own_clearance", clearance_m=0.0002), SCENE),
    "own_socket": (Shape("own_socket", section=ROUND, clearance_m=0.0002, socket=OWN), SCENE),
    "wide_mouth": (
        Shape("wide_mouth", section=ROUND, clearance_m=0.0002, socket=Socket(chamfer_m=0.004)),
        SCENE,
    ),
    "through": (Shape("through", section=ROUND, chamfer_m=0.001, socket=Socket(through=True)), SCENE),
    **{
        shape.name: (shape, scene)
        for name in ("nist", "shafts", "nonconvex")
        for scene in [read_config(parts_file(name)).scene]
        for shape in scene.shapes
    },
}


def cut(pieces, height_m, turned=False):
    """Union of the pieces' sections at a height, and the sum of their areas."""
    sections = []
    for piece in pieces:
        low, high = piece.corners[:, 2].min(), piece.corners[:, 2].max()
        if not low < height_m < high:
            continue
        rings = [ring for ring in piece.rings if len(ring.corners)]
        below = [ring for ring in rings if ring.height_m <= height_m][-1]
        above = next(ring for ring in rings if ring.height_m > height_m)
        share = (height_m - below.height_m) / (above.height_m - below.height_m)
        # A horizontal cut of a convex hull of two polygons holds all convex combinations of their corners.
        points = (1 - share) * below.corners[:, None] + share * above.corners[None]
        sections.append(
            shapely.MultiPoint(points.reshape(-1, 2) * ([1, -1] if turned else [1, 1])).convex_hull
        )
    polygons = [one for one in sections if isinstance(one, Polygon)]
    return shapely.union_all(polygons), sum(one.area for one in polygons)


@pytest.mark.parametrize("name", PARTS)
def test_a_socket_is_its_plate_without_the_hole(name):
    shape, scene = PARTS[name]
    require_possible(shape, scene)
    width, chamfer = scene.plate_half_width_m, shape.socket.chamfer_m
    plate, hole = shapely.box(-width, -width, width, width), hole_outline(shape, scene)
    for height in (-0.3 * scene.hole_depth_m, -0.9 * scene.hole_depth_m, -0.3 * chamfer):
        if height == 0:
            continue
        here = inset(hole, -max(chamfer + height, 0.0))
        material, area = cut(socket_pieces(shape, scene), height)
        assert material.symmetric_difference(plate.difference(here)).area < 1e-10, height
        assert area == pytest.approx(material.area, rel=1e-6 if height < -chamfer else OVERLAP)


@pytest.mark.parametrize("name", PARTS)
def test_a_peg_is_its_section_with_a_chamfer(name):
    shape, scene = PARTS[name]
    length, chamfer, figure = scene.peg_length_m, shape.chamfer_m, peg_outline(shape, scene)
    for height in (0.5 * length, length - 0.4 * chamfer - 1e-6):
        here = inset(figure, max(chamfer - (length - height), 0.0))
        material, area = cut(peg_pieces(shape, scene), height, turned=True)
        assert material.symmetric_difference(here).area < 1e-9 * figure.area + 1e-12, height
        if not shape.rectangles:  # which may overlap
            assert area == pytest.approx(material.area, rel=OVERLAP if height > length - chamfer else 1e-6)


def test_a_clearance_of_its_own_is_not_drawn():
    scene = replace(SCENE, shapes=(*SHAPES[:2], PARTS["own_clearance"][0]))
    with pytest.raises(RequestError, match=r"randomize\.clearance_m cannot be drawn: own_clearance"):
        require_linear(scene, {"clearance_m": (0.0008, 0.0012)}, "randomize")
    require_linear(scene, {"part_scale": (0.99, 1.01)}, "randomize")


@pytest.mark.parametrize(("name", "most"), [("tee", 4), ("key", 4), ("fork", 4), ("spikes", 8)])
def test_a_chamfer_adds_no_more_than_a_piece_for_each(name, most):
    shape, scene = PARTS[name]
    assert len(peg_pieces(shape, scene)) <= most
    plain = replace(shape, socket=Socket())
    assert len(socket_pieces(shape, scene)) < 2 * len(socket_pieces(plain, scene))
