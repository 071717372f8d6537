"""Drawings as exporters write them: rounded ends, doubled lines, units; and broken files."""

import math

import ezdxf
import numpy as np
import pytest
import shapely
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


def rounded(width, height, radius, lines):
    """Corners of a rectangle whose fillets have so many lines each."""
    turn = np.linspace(0, np.pi / 2, lines + 1)
    centres = [
        (width / 2 - radius, height / 2 - radius) * np.array(sign)
        for sign in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ]
    return np.concatenate(
        [
            centre + radius * np.column_stack([np.cos(turn + k * np.pi / 2), np.sin(turn + k * np.pi / 2)])
            for k, centre in enumerate(centres)
        ]
    )


@pytest.mark.parametrize("digits", [6, 3])
def test_lines_much_shorter_than_the_tolerance_keep_their_shape(tmp_path, digits):
    """Each corner is the exact or nearly exact end of two lines, 12 um long: nothing is drawn together."""
    corners = rounded(8, 4, 0.5, 64)

    def lines(space):
        for k, (a, b) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
            space.add_line(np.round(a, digits + k % 2), np.round(b, digits + k % 2))

    part = import_part(drawn(tmp_path / "fillets.dxf", lines), Wanted(tolerance_m=2.5e-5))
    assert part.size_m == pytest.approx((0.008, 0.004), abs=2e-6)
    assert part.area_m2 == pytest.approx(1e-6 * shapely.Polygon(corners).area, rel=3e-3)
    exact = shapely.Polygon(corners / 1000)
    assert shapely.hausdorff_distance(outline(part.section, 1e-6).boundary, exact.boundary, 0.01) < 2.5e-5


def test_small_notches_are_closed(tmp_path):
    corners = [(0, 0), (4, 0), (4, 0.02), (4.02, 0.02), (4.02, 0), (9, 0), (9, 5), (0, 5)]

    def lines(space):
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            space.add_line(a, b)

    part = import_part(drawn(tmp_path / "notch.dxf", lines), Wanted(tolerance_m=5e-5))
    assert part.area_m2 == pytest.approx(45e-6, rel=1e-4)


def test_files_that_state_their_units_are_measured_in_them(tmp_path):
    plug = [import_part(SAMPLES / "usb.step", Wanted(units=units)) for units in ("mm", "cm", "m")]
    assert {part.size_m for part in plug} == {plug[0].size_m}
    stated = 'width="10mm" height="5mm" viewBox="0 0 37.795 18.8975"'
    rectangle = '<rect x="1" y="1" width="30" height="15"/>'
    part = import_part(written(tmp_path / "stated.svg", SVG.format(stated, rectangle)), Wanted())
    assert part.size_m == pytest.approx((0.3 / 37.795, 0.15 / 37.795), rel=1e-4)
    plain = import_part(written(tmp_path / "plain.svg", SVG.format("", rectangle)), Wanted())
    assert plain.size_m == pytest.approx((0.03, 0.015))
    for stated, width_m in (
        ('width="40mm"', 30 * 0.0254 / 96),  # without a view box, units are pixels
        ('height="10mm" viewBox="0 0 60 20"', 0.015),
    ):
        part = import_part(written(tmp_path / "one.svg", SVG.format(stated, rectangle)), Wanted())
        assert part.size_m[0] == pytest.approx(width_m, rel=1e-4)
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
    two = 'width="20mm" height="5mm" viewBox="0 0 10 5"'
    yield written(folder / "two.svg", SVG.format(two, triangle)), "2 mm by its width and 1 mm by its height"
    yield written(folder / "circle.svg", SVG.format("", '<circle cx="1" cy="2"/>')), "cannot be read as SVG"
    turned = '<g transform="twist(3)"><path d="M0 0 L10 0 L5 8 Z"/></g>'
    yield written(folder / "turned.svg", SVG.format("", turned)), "cannot be read as SVG"
    far = '<path d="M0 0 C 1e9 1e9 -1e9 1e9 10 0 Z"/>'
    yield written(folder / "far.svg", SVG.format("", far)), "needs more than 4096 lines"
    angle = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    radius = 8 + np.arange(4000) % 2

    def saw(space):
        space.add_lwpolyline(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]), close=True)

    def notched(space):
        space.add_lwpolyline([(0, 0), (8, 0), (8, 4), (0, 4)], close=True)
        space.add_lwpolyline([(2, 0), (4, 0), (4, 2), (2, 2)], close=True)

    yield drawn(folder / "notched.dxf", notched), r"an outline runs along another, at \("
    for name, draw in (
        ("block", lambda space: space.add_blockref("NONE", (0, 0))),
        ("hatch", lambda space: space.add_hatch()),
        ("huge", lambda space: space.add_line((0, 0), (math.inf, 1))),
    ):
        yield drawn(folder / f"{name}.dxf", draw), "cannot be|holds no line"
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
