"""Solids: hollow ones, bodies inside of others, flanges, tapers and chamfers."""

import math

import numpy as np
import pytest
import trimesh

from mjx_fit.scene.outline import outline
from mjx_fit.scene.part_files.importing import Wanted, import_part
from mjx_fit.utils.errors import RequestError


def test_hollow_and_forked_solids_keep_their_holes(tmp_path):
    trimesh.creation.annulus(3, 6, 20).export(tmp_path / "tube.stl")
    tube = import_part(tmp_path / "tube.stl", Wanted())
    assert tube.area_m2 == pytest.approx(27e-6 * math.pi, rel=0.02)
    assert len(outline(tube.section, 1e-6).geoms[0].interiors) == 1
    prongs = [trimesh.creation.box([3, 8, 20]).apply_translation([x, 0, 0]) for x in (-5, 5)]
    trimesh.util.concatenate(prongs).export(tmp_path / "prongs.obj")
    part = import_part(tmp_path / "prongs.obj", Wanted())
    assert part.area_m2 == pytest.approx(48e-6)
    assert len(outline(part.section, 1e-6).geoms) == 2


def test_bodies_inside_of_others_are_solid_and_cavities_are_empty(tmp_path):
    """A connector's pins inside its block, a block that is flush with a side, and a closed chamber."""

    def boxed(name, *boxes):
        bodies = [
            trimesh.creation.box([x, y, 20.0 - cut]).apply_translation([at, 0, 0]) for x, y, cut, at in boxes
        ]
        return bodies, tmp_path / f"{name}.stl"

    for name, boxes, area in (
        ("pins", ((10, 10, 0, 0), (1, 1, 0, 3), (1, 1, 0, -3)), 100),
        ("flush", ((8, 4, 0, 0), (2, 2, 0, 3)), 32),
    ):
        bodies, file = boxed(name, *boxes)
        trimesh.util.concatenate(bodies).export(file)
        assert import_part(file, Wanted()).area_m2 == pytest.approx(area * 1e-6, rel=1e-6)
    (block, chamber), file = boxed("chamber", (10, 10, 0, 0), (2, 2, 1, 0))
    chamber.invert()
    for inside_out in (False, True):
        both = trimesh.util.concatenate([block, chamber])
        if inside_out:
            both.invert()
        both.export(file)
        assert import_part(file, Wanted(chamfer_m=0.001)).area_m2 == pytest.approx(96e-6, rel=1e-6)


def stepped(path, heights_mm, widths_mm):
    """A solid of square blocks from the tip upwards."""
    blocks, top = [], 0.0
    for height, width in zip(heights_mm, widths_mm, strict=True):
        block = trimesh.creation.box([width, width, height])
        blocks.append(block.apply_translation([0, 0, top + height / 2]))
        top += height
    trimesh.util.concatenate(blocks).export(path)
    return path


def test_a_thin_flange_is_a_change_of_the_section(tmp_path):
    file = stepped(tmp_path / "flange.stl", (0.7, 0.8, 20), (8, 14, 8))
    with pytest.raises(RequestError, match=r"its section changes by 4.24 mm over the insertion"):
        import_part(file, Wanted())
    at_the_tip = stepped(tmp_path / "tip.stl", (0.3, 20), (7, 8))
    with pytest.raises(RequestError, match=r"changes by 0.707 mm .* --chamfer"):
        import_part(at_the_tip, Wanted())


def frustum(path, low, high, n=4, height=20.0):
    """A pyramid, or a cone of many sides, cut off, that stands on the end of half width ``low``."""
    angle = 2 * np.pi * (np.arange(n) + 0.5) / n
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / n)
    corners = [np.column_stack([size * ring, np.full(n, z)]) for size, z in ((low, 0.0), (high, height))]
    trimesh.Trimesh(np.concatenate(corners)).convex_hull.export(path)
    return path


@pytest.mark.parametrize("n", [4, 48])
def test_a_taper_is_a_change_of_the_section(tmp_path, n):
    """The half width at 5 mm differs from that at the ends of the depth by a fifth per mm."""
    with pytest.raises(RequestError, match=r"its section changes by (1.41|1) mm over the insertion"):
        import_part(frustum(tmp_path / "taper.stl", 2.0, 6.0, n), Wanted())
    slight = frustum(tmp_path / "slight.stl", 4.0, 4.004, n)
    part = import_part(slight, Wanted())
    change = 0.001e-3 * (math.sqrt(2) if n == 4 else 1)
    assert part.change_m == pytest.approx(change, rel=0.01)


def test_short_sides_of_solids_are_kept(tmp_path):
    """Sides of 49 um, as those of the fillets of a small part in fine facets."""
    frustum(tmp_path / "fine.stl", 2.0, 2.0, 256)
    part = import_part(tmp_path / "fine.stl", Wanted(tolerance_m=1e-7))
    assert part.corners == 256
    assert part.area_m2 == pytest.approx(256 * math.tan(math.pi / 256) * 4e-6, rel=3e-5)


def test_meshes_with_corners_at_every_height_are_cut(tmp_path):
    generator = np.random.default_rng(0)
    box = trimesh.creation.box([8, 8, 20])
    for _ in range(4):
        box = box.subdivide()
    inside = (abs(box.vertices[:, 2]) < 9.9) & (abs(abs(box.vertices[:, :2]).max(1) - 4) < 1e-9)
    box.vertices[inside, 2] += generator.uniform(-0.05, 0.05, inside.sum())
    box.export(tmp_path / "dense.stl")
    assert import_part(tmp_path / "dense.stl", Wanted()).area_m2 == pytest.approx(64e-6, rel=1e-6)


def test_the_chamfer_of_a_solid_is_left_out(tmp_path):
    rings = [(3.0, 0.0), (4.0, 1.0), (4.0, 20.0)]
    angle = np.linspace(0, 2 * np.pi, 4, endpoint=False)
    corners = [(r * math.cos(a), r * math.sin(a), z) for r, z in rings for a in angle]
    trimesh.Trimesh(corners).convex_hull.export(tmp_path / "peg.stl")
    with pytest.raises(RequestError, match="its section changes by"):
        import_part(tmp_path / "peg.stl", Wanted())
    part = import_part(tmp_path / "peg.stl", Wanted(chamfer_m=0.001))
    assert part.area_m2 == pytest.approx(32e-6)
    assert part.change_m == pytest.approx(0, abs=1e-9)


def test_a_sheet_that_encloses_nothing_is_refused(tmp_path):
    corners = [[0, 0, 0], [9, 0, 0], [0, 0, 20]]
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 1]], process=False).export(tmp_path / "sheet.obj")
    with pytest.raises(RequestError, match=r"sheet\.obj: cannot be used: .*(encloses nothing|not closed)"):
        import_part(tmp_path / "sheet.obj", Wanted())
