"""Training runs that ship under a name."""

import pytest

import mjx_fit as mf
from mjx_fit.cli.parser import parser
from mjx_fit.utils import resources


def test_the_weights_of_november_2026_are_loaded_by_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before, now = mf.load_sensor("as-2026-11"), mf.load_sensor()
    assert (before.config.sensor.pose, now.config.sensor.pose) == ("world", "start")
    assert before.fingerprint != now.fingerprint


@pytest.mark.parametrize(
    "words",
    [
        ["evaluate", "position", "--out", "a.json", "--run"],
        ["evaluate", "robustness", "--out", "a.json", "--run"],
        ["collect", "--out", "data", "--run"],
        ["train", "--data", "data", "--out", "run", "--init"],
    ],
)
def test_commands_take_the_name_and_a_folder_of_that_name_takes_precedence(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    option = words[-1].removeprefix("--")
    shipped = getattr(parser().parse_args([*words, "as-2026-11"]), option)
    assert shipped == resources.folder("weights-as-2026-11")
    (tmp_path / "as-2026-11").mkdir()
    assert str(getattr(parser().parse_args([*words, "as-2026-11"]), option)) == "as-2026-11"
