"""Parts from files: their sizes and areas, and one line for each file that holds no usable part."""

import math
from dataclasses import replace

import ezdxf
import numpy as np
import pytest
import trimesh
from places import EXPERIMENTS

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.scene.outline import is_its_own_mirror_image, outline
from mjx_fit.scene.part_files.importing import Wanted, import_part
from mjx_fit.scene.part_rules import require_possible
from mjx_fit.utils.errors import RequestError

SAMPLES = EXPERIMENTS / "parts"
MM2 = 1e-6


def drawing(path, draw):
    document = ezdxf.new(units=4)
    draw(document.modelspace())
    document.saveas(path)
    return path


@pytest.mark.parametrize(
    ("name", "size_mm", "area_mm2"),
    [
        ("slot.dxf", (20, 10), 100 + math.pi * (25 - 4)),
        ("gear.svg", (20, 20), None),
        ("wedge.stl", (18, 12), 108),
        ("d_shaft.step", (8, 7), 16 * (math.pi - math.acos(0.75)) + 3 * math.sqrt(7)),
        ("usb.step", (12, 4.5), 54 - (4 - math.pi) * 0.25),
    ],
)
def test_samples_have_their_sizes_and_areas(name, size_mm, area_mm2):
    part = import_part(SAMPLES / name, Wanted(tolerance_m=2e-6))
    assert part.size_m == pytest.approx(np.array(size_mm) / 1000, rel=6e-3)
    assert outline(part.section, 1e-6).area == pytest.approx(part.area_m2, rel=1e-6)
    if area_mm2 is not None:
        assert part.area_m2 == pytest.approx(area_mm2 * MM2, rel=1e-3)
    assert (part.change_m is None) == name.endswith((".dxf", ".svg"))
    require_possible(Shape("part", section=part.section, clearance_m=1e-4), SceneConfig())


@pytest.mark.parametrize("name", ["slot.dxf", "latch.dxf", "usb.step"])
def test_samples_that_are_symmetric_in_y_can_be_mirrored(name):
    """Straight lines in place of arcs are not symmetric, within the tolerance."""
    shape = Shape("part", section=import_part(SAMPLES / name, Wanted()).section, clearance_m=1e-4)
    assert is_its_own_mirror_image(shape, SceneConfig())


def test_outlines_are_counted():
    slot = import_part(SAMPLES / "slot.dxf", Wanted())
    assert (slot.parts, slot.holes) == (1, 1)
    wedge = import_part(SAMPLES / "wedge.stl", Wanted())
    assert (wedge.parts, wedge.holes, wedge.corners) == (1, 0, 3)


@pytest.mark.parametrize(
    ("header", "asked", "size_m", "words"),
    [
        (1, None, 0.0508, "in, as the file states"),
        (4, "mm", 0.002, "mm, as the file states"),
        (1, "mm", 0.002, "--units mm; the file states in"),
        (0, "cm", 0.02, "--units cm"),
    ],
)
def test_a_drawing_is_read_in_its_unit_unless_another_is_asked_for(tmp_path, header, asked, size_m, words):
    document = ezdxf.new(units=header)
    document.modelspace().add_lwpolyline([(0, 0), (2, 0), (2, 1), (0, 1)], close=True)
    document.saveas(tmp_path / "plate.dxf")
    part = import_part(tmp_path / "plate.dxf", Wanted(units=asked))
    assert part.size_m[0] == pytest.approx(size_m)
    assert part.unit == words


def test_a_file_without_a_unit_needs_one(tmp_path):
    document = ezdxf.new(units=0)
    document.modelspace().add_circle((0, 0), 3)
    document.saveas(tmp_path / "plate.dxf")
    for file in (tmp_path / "plate.dxf", SAMPLES / "wedge.stl"):
        with pytest.raises(RequestError, match=f"--units: required: .*{file.name} does not state"):
            import_part(file, Wanted(units=None))


def test_a_gear_is_drawn_the_right_way_up(tmp_path):
    """SVG's y axis points down; the part is seen as the picture is."""
    file = tmp_path / "arrow.svg"
    file.write_text('<svg xmlns="http://www.w3.org/2000/svg"><path d="M0 0 L10 0 L5 8 Z"/></svg>')
    corners = outline(import_part(file, Wanted()).section, 1e-6).geoms[0].exterior.coords
    assert min(corners, key=lambda point: point[1])[0] == pytest.approx(0, abs=1e-7)


def test_lines_and_arcs_that_meet_are_joined_and_blocks_are_resolved(tmp_path):
    def half_disc(space):
        space.add_arc((0, 0), 5, 0, 180)
        space.add_line((5, 0), (-5, 0))

    def block(space):
        half_disc(space.doc.blocks.new("HALF"))
        space.add_blockref("HALF", (30, 20))
        space.add_text("not a part")

    for draw in (half_disc, block):
        part = import_part(drawing(tmp_path / "half.dxf", draw), Wanted(tolerance_m=1e-6))
        assert part.area_m2 == pytest.approx(12.5 * math.pi * MM2, rel=1e-3)


@pytest.mark.parametrize(("suffix", "axis"), [(".stl", "z"), (".obj", "z"), (".stl", "-x"), (".obj", "y")])
def test_solids_are_cut_across_the_direction_of_insertion(tmp_path, suffix, axis):
    sides = np.array([8.0, 12.0, 20.0])
    file = tmp_path / f"box{suffix}"
    trimesh.creation.box(sides).export(file)
    part = import_part(file, Wanted(axis=axis, depth_m=0.005))
    across = np.delete(sides, "xyz".index(axis[-1]))
    assert sorted(part.size_m) == pytest.approx(sorted(across / 1000), rel=1e-6)


@pytest.mark.parametrize(("axis", "corner_m"), [("-z", (-0.009, -0.006)), ("z", (-0.009, 0.006))])
def test_a_solid_is_seen_against_the_insertion(axis, corner_m):
    """The right angle of the file stays where it is if the part goes down, and is mirrored if it goes up."""
    part = import_part(SAMPLES / "wedge.stl", Wanted(axis=axis))
    corners = np.array(outline(part.section, 1e-6).geoms[0].exterior.coords)[:-1]
    assert len(corners) == 3
    across = [abs((a - b) @ (c - b)) for a, b, c in (np.roll(corners, i, 0) for i in range(3))]
    assert np.roll(corners, int(np.argmin(across)), 0)[1] == pytest.approx(corner_m, abs=2e-7)


def bad_files(folder):
    """Files without a usable part, with the options and what is wrong."""
    yield (
        drawing(folder / "open.dxf", lambda space: space.add_line((0, 0), (5, 5))),
        {},
        (r"is not closed, at \(0, 0\); the nearest other end is 7.07 away, more than 0.00125"),
    )
    bow = [(0, 0), (9, 9), (9, 0), (0, 9)]
    yield (
        drawing(folder / "bow.dxf", lambda space: space.add_lwpolyline(bow, close=True)),
        {},
        r"outlines cross: one crosses itself, which begins at \(0, 0\)",
    )
    yield drawing(folder / "none.dxf", lambda space: None), {}, "holds no line"

    def two_circles(space):
        space.add_circle((0, 0), 3)
        space.add_circle((4, 0), 3)

    yield drawing(folder / "two.dxf", two_circles), {}, r"outlines cross, at \(2, -?2.23"
    for units, size in (("m", r"2e\+04 by 1e\+04"), ("um", "0.02 by 0.01")):
        yield SAMPLES / "slot.dxf", {"units": units}, rf"the section is {size} mm \(unit: --units {units}"
    yield SAMPLES / "usb.step", {"axis": "z"}, "its section changes by .* more than the tolerance"
    yield SAMPLES / "wedge.stl", {"depth_m": 0.04}, "expected more than the insertion depth"
    for name, content in (
        ("bad.dxf", "x"),
        ("bad.svg", "x"),
        ("bad.stl", "x"),
        ("bad.step", "x"),
        ("bad.obj", ""),
    ):
        (folder / name).write_text(content)
        yield folder / name, {}, "cannot be (read|used)"
    yield folder / "missing.stl", {}, "cannot be read"
    yield folder / "part.txt", {}, "expected a file that ends in"
    mesh = trimesh.creation.box([8, 8, 20])
    mesh.update_faces(np.arange(len(mesh.faces)) > 1)
    mesh.export(folder / "leaky.stl")
    yield folder / "leaky.stl", {}, "its surface is not closed"


def test_files_without_a_usable_part_get_one_line(tmp_path):
    for file, options, why in bad_files(tmp_path):
        with pytest.raises(RequestError, match=f"{file.name}: .*{why}") as error:
            import_part(file, replace(Wanted(), **options))
        assert "\n" not in str(error.value)
