"""Presets of the world."""

import dataclasses

import pytest

from mjx_fit.cli.main import main
from mjx_fit.config.files import read_config, read_stored_config
from mjx_fit.config.schema import Config, config_differences
from mjx_fit.config.worlds import WORLDS, world_file
from mjx_fit.filters.updates import NONE
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError


def test_every_preset_is_a_file_and_the_default_is_none():
    files = {path.stem for path in (resources.folder("configs") / "worlds").glob("*.yaml")}
    assert files == set(WORLDS[1:])
    assert read_config(world_file(None)) == read_config(world_file("home")) == Config()
    for name in WORLDS[1:]:
        read_config(world_file(name))


PHYSICS_AND_READINGS = ("scene", "control", "arm", "randomize", "wrist", "pose", "filter")


def test_the_world_of_november_2026_is_the_one_of_files_that_lack_later_keys():
    before = read_config(world_file("as-2026-11"))
    old = read_stored_config(resources.folder("weights-as-2026-11") / "config.yaml")
    for section in PHYSICS_AND_READINGS:
        assert getattr(old, section) == getattr(before, section), section


def test_the_world_of_the_paper_differs_from_home_in_readings_and_safeguards_alone():
    paper, home = (read_config(world_file(name)) for name in ("paper", "home"))
    differing = {words.partition(".")[0] for words in config_differences(paper, home)}
    assert differing == {"wrist", "pose", "filter"}
    assert paper.filter == NONE
    assert paper.pose == paper.pose.without_errors()
    noise = {
        name: getattr(home.wrist, name)
        for name in ("force_noise_n", "torque_xy_noise_nm", "torque_z_noise_nm")
    }
    assert paper.wrist == dataclasses.replace(home.wrist.without_errors(), **noise)


def test_an_unknown_world_is_one_line():
    with pytest.raises(
        RequestError, match=r"^--world: 'moon' is invalid: expected home, as-2026-11, paper, forge, wide$"
    ):
        world_file("moon")


def test_set_takes_precedence_over_the_world(capsys):
    main(["config", "--world", "as-2026-11", "--set", "scene.contact_impedance=0.5"])
    line = next(line for line in capsys.readouterr().out.splitlines() if "contact_impedance" in line)
    assert " 0.5 " in line
    assert " 0.95 " not in line
