"""Parts as exporters write them: rounded ends, doubled lines, hollow solids, units; and broken files."""

import math

import ezdxf
import numpy as np
import pytest
import trimesh
from places import EXPERIMENTS

from mjx_fit.scene.outline import outline
from mjx_fit.scene.part_files.importing import Wanted, import_part
from mjx_fit.utils.errors import RequestError

SAMPLES = EXPERIMENTS / "parts"
SVG = '<svg xmlns="http://www.w3.org/2000/svg" {}>{}</svg>'


def drawn(path, draw):
    document = ezdxf.new(units=4)
    draw(document.modelspace())
    document.saveas(path)
    return path


def written(path, text):
    path.write_text(text)
    return path


@pytest.mark.parametrize("digits", [4, 5, 6])
def test_ends_that_nearly_meet_are_joined(tmp_path, digits):
    """An arc and its chord, with coordinates rounded as exporters do."""
    for angle in np.linspace(61, 340, 17):

        def segment(space, angle=angle):
            space.add_arc((0, 0), 5, 0, round(angle, digits))
            end = 5 * math.cos(math.radians(angle)), 5 * math.sin(math.radians(angle))
            space.add_line((5, 0), np.round(end, digits))

        part = import_part(drawn(tmp_path / "segment.dxf", segment), Wanted(tolerance_m=1e-6))
        turn = math.radians(angle)
        assert part.area_m2 == pytest.approx(12.5e-6 * (turn - math.sin(turn)), rel=2e-3)


def test_lines_that_are_drawn_twice_count_once(tmp_path):
    corners = [(0, 0), (9, 0), (9, 5), (0, 5)]

    def twice(space):
        space.add_lwpolyline(corners, close=True)
        space.add_lwpolyline(corners, close=True)
        space.add_line(corners[0], corners[1])

    assert import_part(drawn(tmp_path / "twice.dxf", twice), Wanted()).area_m2 == pytest.approx(45e-6)


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


def test_files_that_state_their_units_are_measured_in_them(tmp_path):
    plug = [import_part(SAMPLES / "usb.step", Wanted(units=units)) for units in ("mm", "cm", "m")]
    assert {part.size_m for part in plug} == {plug[0].size_m}
    stated = 'width="10mm" height="5mm" viewBox="0 0 37.795 18.8975"'
    rectangle = '<rect x="1" y="1" width="30" height="15"/>'
    part = import_part(written(tmp_path / "stated.svg", SVG.format(stated, rectangle)), Wanted())
    assert part.size_m == pytest.approx((0.3 / 37.795, 0.15 / 37.795), rel=1e-4)
    plain = import_part(written(tmp_path / "plain.svg", SVG.format("", rectangle)), Wanted())
    assert plain.size_m == pytest.approx((0.03, 0.015))
    sizes = [("e-mm", "0 0 30 15"), ("30mm", "0 0 0 15"), ("30mm", "0 0 x 15"), ("-30mm", "0 0 30 15")]
    for width, box in sizes:
        odd = written(tmp_path / "odd.svg", SVG.format(f'width="{width}" viewBox="{box}"', rectangle))
        assert import_part(odd, Wanted()).size_m == plain.size_m


def broken(folder):
    """Files that no part can be made of, and what is said of them."""
    triangle = '<path d="M0 0 L10 0 L5 8 Z"/>'
    yield written(folder / "nothing.svg", SVG.format("", '<path d=""/>')), "holds no line"
    arc = '<path d="M0 0 A5 5 0 0 1 0 0"/>'
    yield written(folder / "arc.svg", SVG.format("", arc + triangle)), "cannot be"
    far = '<path d="M0 0 C 1e9 1e9 -1e9 1e9 10 0 Z"/>'
    yield written(folder / "far.svg", SVG.format("", far)), "needs more than 4096 lines"
    angle = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    radius = 8 + np.arange(4000) % 2

    def saw(space):
        space.add_lwpolyline(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]), close=True)

    yield drawn(folder / "saw.dxf", saw), "corners: expected at most 2000; choose a larger --tolerance"
    squares = "".join(
        f'<rect x="{2 * (i % 12)}" y="{2 * (i // 12)}" width="1" height="1"/>' for i in range(120)
    )
    yield written(folder / "many.svg", SVG.format("", squares)), "it has 120 outlines: expected at most 100"
    yield written(folder / "empty.step", ""), "it holds no solid"
    header = "ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n"
    yield written(folder / "header.step", header), "it holds no solid"


def test_broken_files_get_one_line_and_libraries_say_nothing(tmp_path, capfd):
    for file, why in broken(tmp_path):
        with pytest.raises(RequestError, match=f"{file.name}: .*{why}") as error:
            import_part(file, Wanted())
        assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")
