"""Presets of the world."""

import pytest

from mjx_fit.cli.main import main
from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import WORLDS, world_file
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError


def test_every_preset_is_a_file_and_the_default_is_none():
    files = {path.stem for path in (resources.folder("configs") / "worlds").glob("*.yaml")}
    assert files == set(WORLDS[1:])
    assert read_config(world_file(None)) == read_config(world_file("home")) == Config()
    for name in WORLDS[1:]:
        read_config(world_file(name))


def test_the_world_before_the_mended_contact_jumps_and_has_one_time_for_both_forces():
    before, paper = (read_config(world_file(name)) for name in ("as-2026-11", "paper"))
    assert (before.control.goal, before.scene.slip_time_s) == ("step", None)
    assert (paper.control.goal, paper.scene.slip_time_s) == ("ramp", 0.05)


def test_an_unknown_world_is_one_line():
    with pytest.raises(
        RequestError, match=r"^--world: 'moon' is invalid: expected home, as-2026-11, paper, forge, wide$"
    ):
        world_file("moon")


def test_set_takes_precedence_over_the_world(capsys):
    main(["config", "--world", "paper", "--set", "scene.slip_time_s=0.07"])
    line = next(line for line in capsys.readouterr().out.splitlines() if "slip_time_s" in line)
    assert " 0.07 " in line
    assert " 0.05 " not in line
