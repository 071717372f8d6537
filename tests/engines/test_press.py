"""A push that is a force: in contact, in free space, at touch-down, with an arm that loses force."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mjx_fit.api import draw_attempts, load_config
from mjx_fit.control.force_control import FULL_PUSH_M
from mjx_fit.control.policies import stateless
from mjx_fit.engines.select import make_engine
from mjx_fit.task.effort import effort_of

PUSH = stateless(lambda seen: jnp.array([0.0, 0.0, -FULL_PUSH_M]))
DRAG = stateless(lambda seen: jnp.array([0.01, 0.0, -FULL_PUSH_M]))
PRESS_N, SPEED_MPS = 5.0, 0.01


def pushed(*sets: str, policy: Any = PUSH, engine: str = "native", actions: int = 15):
    """Attempts far from the hole under one command, and their vertical force on the socket (n, J, 50)."""
    config = load_config(None, "control.push=force", "detector.half_width_m=0.001", *sets)
    config = replace(config, wrist=config.wrist.without_errors(), pose=config.pose.without_errors())
    attempts = draw_attempts(jax.random.key(3), 4, config=config)
    away = jnp.asarray(attempts.estimate_world) + jnp.array([0.045, 0.0])
    attempts = replace(attempts, estimate_world=away)
    done = make_engine(engine, config, policy).run(attempts, actions)
    assert done.truth.valid.all()
    wrench = np.asarray(done.felt.trace.wrench_sensor) - np.asarray(done.felt.tare_sensor)[:, None, None]
    return done, wrench[..., 2]


@pytest.mark.parametrize("engine", ["native", pytest.param("mjx", marks=pytest.mark.slow)])
def test_a_push_presses_with_its_force_and_does_not_chatter(engine):
    _, force = pushed(engine=engine)
    assert force[:, 8:].mean((1, 2)) == pytest.approx(np.full(4, PRESS_N), rel=0.02)
    assert force[:, 8:].std((1, 2)).max() < 0.03 * PRESS_N


@pytest.mark.parametrize("contact_time_s", [0.004, 0.01, 0.03])
@pytest.mark.parametrize("kp", [425, 846])
def test_the_force_does_not_depend_on_the_stiffness_of_contact_or_arm(contact_time_s, kp):
    sets = f"scene.contact_time_s={contact_time_s}", f"control.kp_position={kp}"
    _, force = pushed(*sets, "control.press_n=8")
    assert force[:, 8:].mean((1, 2)) == pytest.approx(np.full(4, 8.0), rel=0.02)
    assert force[:, 8:].std((1, 2)).max() < 0.24


def test_in_free_space_a_push_moves_at_its_speed():
    up = stateless(lambda seen: jnp.array([0.0, 0.0, FULL_PUSH_M]))
    done, _ = pushed(policy=up, actions=10)
    speed = np.asarray(done.felt.trace.tip_linvel_world)[:, 3:, 2]
    assert speed == pytest.approx(np.full(speed.shape, SPEED_MPS), rel=0.05)


def test_a_touch_down_is_softer_than_that_of_a_displacement():
    soft, _ = pushed(actions=8)
    hard, _ = pushed("control.push=displacement", actions=8)
    assert effort_of(soft.felt).peak_force_n.max() < 0.5 * effort_of(hard.felt).peak_force_n.max()


@pytest.mark.parametrize("lost_n", [2, 4])
def test_a_push_arrives_although_a_dead_zone_swallows_a_part(lost_n):
    _, force = pushed(f"arm.dead_zone_n={lost_n}", actions=40)
    assert force[:, 25:].mean((1, 2)) == pytest.approx(np.full(4, PRESS_N), abs=0.3)


def test_the_lateral_pull_has_a_limit():
    """With so much friction that the peg sticks, the wrist feels the pull of the spring."""
    sets = "scene.friction=1.25", "control.press_n=20", "control.press_speed_mps=0.05"
    done, _ = pushed(*sets, "control.slide_n=6", policy=DRAG, actions=25)
    wrench = np.asarray(done.felt.trace.wrench_sensor) - np.asarray(done.felt.tare_sensor)[:, None, None]
    lateral = np.linalg.norm(wrench[:, 12:, :, :2], axis=-1)
    assert lateral.max() < 6.6
    assert lateral[:, -5:].mean() > 4


def test_without_losses_a_regulated_path_is_followed_as_before():
    """The corrections of an ideal arm are small, except for the lag behind friction."""
    done, _ = pushed("scene.friction=0.05", policy=PUSH, actions=20)
    action = np.asarray(done.felt.trace.action_world)
    assert np.abs(action[:, 10:, :2]).max() < 2e-4
    assert action[:, 10:, 2] == pytest.approx(np.full(action[:, 10:, 2].shape, -FULL_PUSH_M), rel=0.05)
