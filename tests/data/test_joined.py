"""Several data sets as one: the places that are learnt are those of each set's own worlds."""

from pathlib import Path

import numpy as np
import pytest

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.data.collect import collect
from mjx_fit.data.joined import load_joined
from mjx_fit.data.plan import Plan
from mjx_fit.data.reader import load
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.scene.placement import place_for_tool
from mjx_fit.types.physics import AS_CONFIGURED

SIX = "filter.coordinates=[x, y, z, yaw, roll, pitch]"
DRAWN = ["randomize.socket_yaw_rad={uniform: [-0.1, 0.1]}", "randomize.grasp_x_m={uniform: [-0.003, 0.003]}"]
CONSTANT = ["placement.socket_z_m=0.001", "randomize.friction={uniform: [0.2, 0.4]}"]


def collected(out: Path, *sets: str) -> tuple[Path, Config]:
    config = read_config(None, [SIX, *sets])
    plan = Plan(episodes=4, actions=2, engine="native", batch=4, seed=3)
    collect(config, out, plan, NativeEngine(config, 1))
    return out, config


@pytest.fixture(scope="module")
def sets(tmp_path_factory) -> list[tuple[Path, Config]]:
    folder = tmp_path_factory.mktemp("joined")
    named = {"drawn": DRAWN, "constant": CONSTANT, "upright": ["randomize.friction={uniform: [0.2, 0.4]}"]}
    return [collected(folder / name, *keys) for name, keys in named.items()]


def truth(folder: Path, config: Config) -> np.ndarray:
    told = load(folder).rollout.truth
    return np.asarray(place_for_tool(told.hole_pos_world, told.physics, config))


def test_places_are_those_of_each_set(sets):
    joined = load_joined([folder for folder, _ in sets]).rollout.truth
    found = np.asarray(place_for_tool(joined.hole_pos_world, joined.physics, read_config(None, [SIX])))
    np.testing.assert_allclose(found, np.concatenate([truth(*one) for one in sets]), atol=1e-7)
    assert np.abs(found[:4, 3]).min() > 0
    np.testing.assert_allclose(found[4:8, 2], 0.001, atol=1e-7)
    assert not found[8:, 2:].any()


def test_a_single_set_keeps_its_places_too(sets):
    folder, config = sets[0]
    alone = load_joined([folder]).rollout.truth
    np.testing.assert_allclose(
        place_for_tool(alone.hole_pos_world, alone.physics, config), truth(folder, config), atol=1e-7
    )


def test_upright_worlds_carry_no_physics_into_training(sets):
    assert load_joined([sets[2][0]]).rollout.truth.physics == AS_CONFIGURED
