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
        RequestError,
        match=r"^--world: 'moon' is invalid: expected home, as-2026-11, paper, forge, wide, bench$",
    ):
        world_file("moon")


def test_set_takes_precedence_over_the_world(capsys):
    main(["config", "--world", "as-2026-11", "--set", "scene.contact_impedance=0.5"])
    line = next(line for line in capsys.readouterr().out.splitlines() if "contact_impedance" in line)
    assert " 0.5 " in line
    assert " 0.95 " not in line


def test_the_bench_is_forge_with_poses():
    """Its initial standard deviations are those of what a belief is about: socket and grasp together."""
    forge, bench = (read_config(world_file(name)) for name in ("forge", "bench"))
    differing = {words.partition(" ")[0] for words in config_differences(forge, bench)}
    assert {name for name in differing if not name.startswith(("randomize.socket_", "randomize.grasp_"))} == {
        "scene.start_height_m",
        "filter.coordinates",
        "filter.reads",
        "particles.grasp_std_m",
        "particles.grasp_std_rad",
        "seek.rock",
        "seek.probe_radpm",
        "spiral.tilt_rad",
        "spiral.yaw_rad",
        *(f"detector.prior_std_{of}" for of in ("m", "z_m", "yaw_rad", "tilt_rad")),
    }
    drawn = {name: one.uniform for name, one in vars(bench.randomize).items() if one is not None}

    def std(*names: str) -> float:
        return sum((drawn[name][1] - drawn[name][0]) ** 2 / 12 for name in names) ** 0.5

    detector = bench.detector
    found = (
        detector.prior_std_m,
        detector.prior_std_z_m,
        detector.prior_std_yaw_rad,
        detector.prior_std_tilt_rad,
    )
    position = ((2 * detector.half_width_m) ** 2 / 12 + std("grasp_x_m") ** 2) ** 0.5
    rotations = std("socket_yaw_rad", "grasp_yaw_rad"), std("socket_roll_rad", "grasp_roll_rad")
    assert found == pytest.approx((position, std("socket_z_m", "grasp_z_m"), *rotations), rel=0.02)
