"""Statements of the page on frames (docs/frames.md) about world, tool, sensor, socket and grasp."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mjx_fit.api import draw_attempts
from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.control.policies import Policy, PolicyInput
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.scene.build import simulation_scene
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.placement import GRASP, setting_of
from mjx_fit.types import Rollout
from mjx_fit.types.physics import AS_CONFIGURED, Physics

CONFIG = Config()
DOWN = Rotation.from_quat([0.0, 1.0, 0.0, 0.0], scalar_first=True)
BESIDE_M = 0.018
ANGLES = {"roll": 0.1, "pitch": -0.15, "yaw": 0.4}


def pressing(push_m: float) -> Policy:
    """Return a policy that goes down beside the estimate."""

    def act(state, seen: PolicyInput):
        goal = seen.start.estimate_world + BESIDE_M
        return state, jnp.append(goal - seen.tip_pos_world[:2], -push_m)

    return Policy(lambda start, key: (), act, "pressing")


def played(push_m: float, *sets: str, actions: int = 10) -> Rollout:
    config = read_config(None, [*sets, "wrist.force_bias_n=0"])
    drawn = draw_attempts(jax.random.key(0), 2, config=config)
    attempts = replace(drawn, estimate_world=drawn.hole_pos_world)
    return NativeEngine(config, 1, pressing(push_m)).run(attempts, actions)


@pytest.fixture(scope="module")
def pressed() -> Rollout:
    return played(0.004)


@pytest.fixture(scope="module")
def hanging() -> Rollout:
    return played(0.0, "scene.start_height_m=0.015")


def test_the_tcp_is_where_the_engine_says():
    """Attempts start with it ``start_height_m`` over the nominal top; it is a straight peg's lower face."""
    drawn = draw_attempts(jax.random.key(0), 2)
    engine = NativeEngine(CONFIG, 1)
    model = simulation_scene(CONFIG.scene).models[0]
    start = engine.batch_at_rest(drawn).bind("site_xpos")[:, model.site("tip").id]
    want = np.full((2, 1), plate_top_m(CONFIG.scene) + CONFIG.scene.start_height_m)
    np.testing.assert_allclose(start, np.concatenate([drawn.estimate_world, want], 1), atol=3e-5)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    lowest = max(
        model.geom_pos[geom, 2] + model.geom_size[geom, 2]
        for geom in range(model.ngeom)
        if model.geom_bodyid[geom] == model.body("peg").id
    )
    np.testing.assert_allclose(model.site("tip").pos, [0, 0, lowest], atol=1e-9)


def test_straight_down_is_a_half_turn_about_x(hanging):
    quat = np.asarray(hanging.felt.trace.tip_quat_world)[:, -1]
    np.testing.assert_allclose(np.abs(quat), np.tile([0, 1.0, 0, 0], (2, 1)), atol=2e-3)
    np.testing.assert_allclose(DOWN.as_matrix(), np.diag([1, -1, -1]), atol=1e-12)


def test_in_free_space_the_arm_holds_the_weight(hanging):
    wrench, tare = np.asarray(hanging.felt.trace.wrench_sensor), np.asarray(hanging.felt.tare_sensor)
    model = simulation_scene(CONFIG.scene).models[0]
    weight = float(model.body_mass[model.body("peg").id]) * 9.81
    assert weight == pytest.approx(0.98, abs=0.005)
    np.testing.assert_allclose(tare[:, 2], -weight, atol=1e-3)
    np.testing.assert_allclose((wrench - tare[:, None, None])[:, -1, :, :3].mean(1), 0, atol=0.05)


def test_a_tool_that_tilts_after_the_tare_feels_a_part_of_the_weight():
    """It is m g sin φ sideways, and m g (1 - cos φ) along the tool."""
    tilt = 0.1

    def act(state, seen: PolicyInput):
        over = seen.start.estimate_world - seen.tip_pos_world[:2]
        return state, jnp.concatenate([over, jnp.array([0.0, tilt, 0.0, 0.0])])

    config = read_config(None, ["scene.start_height_m=0.03", "wrist.force_bias_n=0"])
    policy = Policy(lambda start, key: (), act, "tilting", turns=True)
    felt = NativeEngine(config, 1, policy).run(draw_attempts(jax.random.key(0), 2, config=config), 15).felt
    change = np.asarray(felt.trace.wrench_sensor)[:, -1, :, :3].mean(1) - np.asarray(felt.tare_sensor)[:, :3]
    np.testing.assert_allclose(np.hypot(change[:, 0], change[:, 1]), 0.98 * np.sin(tilt), atol=0.01)
    np.testing.assert_allclose(change[:, 2], 0.98 * (1 - np.cos(tilt)), atol=0.01)


def test_a_peg_that_presses_down_has_a_positive_force(pressed):
    wrench, tare = np.asarray(pressed.felt.trace.wrench_sensor), np.asarray(pressed.felt.tare_sensor)
    last = (wrench - tare[:, None, None])[:, -1].mean(1)
    assert (last[:, 2] > 2).all()
    top = plate_top_m(CONFIG.scene)
    np.testing.assert_allclose(np.asarray(pressed.felt.trace.tip_pos_world)[:, -1, 2], top, atol=3e-4)


def test_a_socket_turns_about_the_centre_of_its_hole():
    hole = np.array([[0.5, 0.1]], np.float32)
    turned = {f"socket_{name}_rad": np.array([angle], np.float32) for name, angle in ANGLES.items()}
    raised = np.array([0.004], np.float32)
    setting = setting_of(hole, Physics(socket_z_m=raised, **turned), CONFIG)
    assert setting.socket_world is not None
    place = np.asarray(setting.socket_world.translation())[0]
    np.testing.assert_allclose(place, [0.5, 0.1, plate_top_m(CONFIG.scene) + 0.004], atol=1e-6)
    out = np.asarray(setting.socket_world.rotation().as_matrix())[0, :, 2]
    assert out[2] > 0.9


def test_angles_are_roll_then_pitch_then_yaw_about_fixed_axes():
    named = {f"{who}_{name}_rad": angle for who in ("socket", "grasp") for name, angle in ANGLES.items()}
    physics = Physics(**{name: np.array([angle], np.float32) for name, angle in named.items()})
    setting = setting_of(np.array([[0.5, 0.1]], np.float32), physics, CONFIG)
    assert setting.socket_world is not None
    assert setting.peg_tip is not None
    want = Rotation.from_euler("xyz", list(ANGLES.values()))  # lower case: about fixed axes
    for pose in (setting.socket_world, setting.peg_tip):
        found = Rotation.from_quat(np.asarray(pose.rotation().wxyz)[0], scalar_first=True)
        assert (found * want.inv()).magnitude() < 1e-6


def test_a_grasp_turns_the_peg_about_its_lower_face():
    rng = np.random.default_rng(0)
    physics = Physics(**{name: rng.uniform(-0.01, 0.01, 4).astype(np.float32) for name in GRASP})
    setting = setting_of(np.zeros((4, 2), np.float32), physics, CONFIG)
    assert setting.peg_tip is not None
    shift = np.stack([getattr(physics, name) for name in GRASP[:3]], -1)
    np.testing.assert_allclose(setting.peg_tip.translation(), shift, atol=1e-8)


def test_the_sensor_stays_with_the_hand(hanging):
    """What it reads in free space is the same, however the peg is held."""
    held = [f"placement.grasp_{name}_rad={angle}" for name, angle in ANGLES.items()]
    askew = played(0.0, "scene.start_height_m=0.015", *held, actions=1)
    np.testing.assert_allclose(askew.felt.tare_sensor, hanging.felt.tare_sensor, atol=1e-5)
    assert setting_of(np.zeros((1, 2)), AS_CONFIGURED, read_config(None, held)).peg_hand is not None
