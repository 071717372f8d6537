"""``part import`` and ``part show``: what they write, say and refuse."""

import ezdxf
import numpy as np
import pytest
import yaml
from places import EXPERIMENTS

from mjx_fit.cli import main
from mjx_fit.config.files import read_config

SLOT, PLUG, WEDGE = (EXPERIMENTS / "parts" / name for name in ("slot.dxf", "usb.step", "wedge.stl"))


def imported(file, name, out, *more):
    words = ["part", "import", str(file), "--units", "mm", "--name", name, "--out", str(out), *more]
    return main.main(words)


def test_parts_are_added_to_a_file_and_shown(tmp_path, capsys):
    out = tmp_path / "mine.yaml"
    assert imported(SLOT, "slot", out) == 0
    said = capsys.readouterr().out
    assert "slot: 20 by 10 mm, 165.96 mm²" in said
    assert "straight lines err by at most 0.005 mm" in said
    assert imported(PLUG, "plug", out) == 0
    assert "the section changes by 0.000 mm over 10 mm" in capsys.readouterr().out
    assert read_config([out]).scene.names == ("slot", "plug")
    assert main.main(["part", "show", str(out), "--out", str(tmp_path / "shown.png")]) == 0
    assert "slot fits slot" in (said := capsys.readouterr().out)
    assert "plug fits plug" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "mine.png",
        "mine.yaml",
        "shown.png",
        "shown_fits.png",
    ]
    config = read_config([out])
    assert config.scene.shapes[0].clearance_m == pytest.approx(1e-4)


def test_nothing_is_lost_in_a_file_of_parts(tmp_path, capsys):
    out = tmp_path / "mine.yaml"
    assert imported(SLOT, "slot", out) == 0
    before = out.read_text()
    assert imported(PLUG, "slot", out) == 2
    assert "has a part of that name" in capsys.readouterr().err
    assert out.read_text() == before
    out.write_text("# mine\n" + before)
    assert imported(PLUG, "plug", out) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert out.read_text() == "# mine\n" + before
    assert yaml.safe_load(before)["scene"]["shapes"][0]["name"] == "slot"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--units", "furlong"], "--units: 'furlong'"),
        (["--clearance", "0.01"], "--clearance"),
        (["--axis", "w"], "--axis"),
        (["--name", "Not A Name"], "--name: 'Not A Name' is invalid: expected up to 40 of a-z"),
        (["--units", "m"], "expected 0.5 to 60 mm"),
        (["--units", "um"], "0.03 mm long along -z in --units um"),
        (["--depth", "40"], "expected more than the insertion depth (40 mm, --depth)"),
        (["--depth", "0.1"], "--depth: 0.1 is out of range"),
        (["--at", "50"], "--at: 50.0 is out of range: expected 0 to 10"),
        (["--tolerance", "1"], "--tolerance: 1.0 is out of range"),
        (["--chamfer", "6"], "--chamfer: 6.0 is out of range: expected 0 to 5"),
        (["--out", "mine.png"], "--out: mine.png is invalid: expected a file that ends in .yaml"),
    ],
)
def test_what_cannot_be_imported_is_refused_in_a_line(words, said, tmp_path, capsys):
    given = ["--units", "mm", "--name", "wedge", *words]
    assert main.main(["part", "import", str(WEDGE), "--out", str(tmp_path / "mine.yaml"), *given]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_options_of_solids_are_refused_for_drawings(tmp_path, capsys):
    assert imported(SLOT, "slot", tmp_path / "mine.yaml", "--axis=-x") == 2
    assert "--axis: '-x' cannot be used: " in capsys.readouterr().err


def test_nothing_is_written_if_the_picture_cannot_be(tmp_path):
    (tmp_path / "mine.png").mkdir()
    assert imported(SLOT, "slot", tmp_path / "mine.yaml") != 0
    assert [path.name for path in tmp_path.iterdir()] == ["mine.png"]


def test_a_file_that_could_not_be_read_again_is_not_written(tmp_path, capsys):
    """The reader of configurations takes 10,000 values."""
    angle, radius = np.linspace(0, 2 * np.pi, 1900, endpoint=False), 8 + np.arange(1900) % 2 / 5
    document = ezdxf.new(units=4)
    saw = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    document.modelspace().add_lwpolyline(saw, close=True)
    document.saveas(tmp_path / "saw.dxf")
    out = tmp_path / "mine.yaml"
    assert imported(tmp_path / "saw.dxf", "one", out) == 0
    kept = out.read_text()
    assert imported(tmp_path / "saw.dxf", "two", out) == 2
    assert "--out: the file would be too large to be read" in capsys.readouterr().err
    assert out.read_text() == kept
    assert read_config([out]).scene.names == ("one",)


def test_a_chamfer_is_written(tmp_path):
    out = tmp_path / "mine.yaml"
    assert imported(SLOT, "slot", out, "--chamfer", "0.5") == 0
    assert read_config([out]).scene.shapes[0].chamfer_m == 0.0005


def test_presets_and_files_are_parts_of_any_command(tmp_path, capsys):
    assert main.main(["config", "--parts", "nist", "--json"]) == 0
    assert '"rj45"' in capsys.readouterr().out
    assert main.main(["config", "--parts", "bolts"]) == 2
    assert "expected paper, nist, shafts, nonconvex or a YAML file" in capsys.readouterr().err


def test_a_picture_of_something_else_is_not_replaced(tmp_path, capsys):
    (tmp_path / "photo.png").write_text("mine")
    assert imported(SLOT, "slot", tmp_path / "photo.yaml") == 2
    assert "photo.png exists and would be replaced" in capsys.readouterr().err
    assert (tmp_path / "photo.png").read_text() == "mine"
    assert not (tmp_path / "photo.yaml").exists()


def test_a_file_without_parts_is_not_read_as_the_default_ones(tmp_path, capsys):
    (tmp_path / "task.yaml").write_text("detector: {half_width_m: 0.005}\n")
    assert main.main(["part", "show", str(tmp_path / "task.yaml")]) == 2
    assert "task.yaml cannot be used: it has no scene.shapes" in capsys.readouterr().err


def test_parts_that_training_cannot_mirror_are_named(tmp_path, capsys):
    assert imported(WEDGE, "wedge", tmp_path / "w.yaml") == 0
    line = "wedge is not its own mirror image in y: train with --set train.mirror=false"
    assert line in capsys.readouterr().out
