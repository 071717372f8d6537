"""``part import`` and ``part show``: what they write, say and refuse."""

import pytest
import yaml
from places import EXPERIMENTS

from mjx_fit.cli import main
from mjx_fit.config.files import read_config

SLOT, PLUG = EXPERIMENTS / "parts" / "slot.dxf", EXPERIMENTS / "parts" / "usb.step"


def imported(file, name, out):
    words = ["part", "import", str(file), "--units", "mm", "--name", name, "--out", str(out)]
    return main.main(words)


def test_parts_are_added_to_a_file_and_shown(tmp_path, capsys):
    out = tmp_path / "mine.yaml"
    assert imported(SLOT, "slot", out) == 0
    said = capsys.readouterr().out
    assert "slot: 20 by 10 mm, 165.98 mm²" in said
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
        (["--name", "Not A Name"], "scene.shapes.0.name"),
        (["--units", "m"], "expected 0.5 to 60 mm"),
        (["--units", "um"], "0.02 mm long along -z in --units um"),
        (["--depth", "40"], "shorter than the insertion depth"),
    ],
)
def test_what_cannot_be_imported_is_refused_in_a_line(words, said, tmp_path, capsys):
    given = ["--units", "mm", "--name", "plug", *words]
    assert main.main(["part", "import", str(PLUG), "--out", str(tmp_path / "mine.yaml"), *given]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_presets_and_files_are_parts_of_any_command(tmp_path, capsys):
    assert main.main(["config", "--parts", "nist", "--json"]) == 0
    assert '"rj45"' in capsys.readouterr().out
    assert main.main(["config", "--parts", "bolts"]) == 2
    assert "expected paper, nist, shafts or a YAML file" in capsys.readouterr().err
