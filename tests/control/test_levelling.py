"""A tool that gives way to torques: the peg comes to lie flat on a plate that leans."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mjx_fit.api import draw_attempts
from mjx_fit.config.files import read_config
from mjx_fit.control.framed import acting
from mjx_fit.control.levelling import MOST_RAD, Levelled, levelled
from mjx_fit.control.policies import Policy, PolicyInput, PolicyStart, stateless
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.types import Rollout

DOWN = Rotation.from_quat([0.0, 1.0, 0.0, 0.0], scalar_first=True)
LEAN = ("placement.socket_roll_rad=0.05", "placement.socket_pitch_rad=-0.03")
BESIDE = jnp.array([0.012, -0.014])


def pressing(seen: PolicyInput):
    """Press beside the hole."""
    goal = seen.start.estimate_world + BESIDE
    return jnp.append(goal - seen.tip_pos_world[:2], -0.004)


def played(*sets: str, policy: Policy | None = None, actions: int = 40) -> Rollout:
    config = read_config(None, ["control.push=force", "scene.start_height_m=0.006", *sets])
    drawn = draw_attempts(jax.random.key(0), 3, config=config)
    rest = np.zeros((3, len(config.filter.coordinates) - 2), np.float32)
    attempts = replace(drawn, estimate_world=np.concatenate([drawn.hole_pos_world, rest], 1))
    return NativeEngine(config, 1, policy or stateless(pressing)).run(attempts, actions)


def tilt_deg(done: Rollout) -> np.ndarray:
    """Angle between the peg's axis and the normal of the plate at the end of each action."""
    normal = Rotation.from_euler("xyz", [0.05, -0.03, 0]).apply([0, 0, 1])
    quat = np.asarray(done.felt.trace.tip_quat_world)
    axes = (Rotation.from_quat(quat.reshape(-1, 4), scalar_first=True) * DOWN.inv()).apply([0, 0, 1])
    return np.degrees(np.arccos(np.clip(axes @ normal, -1, 1))).reshape(quat.shape[:2])


def test_a_peg_comes_to_lie_flat():
    rigid, gives = (tilt_deg(played(*LEAN, f"control.tilt_radps={y}")) for y in (0, 0.07))
    assert (rigid[:, -1] > 2.5).all()
    np.testing.assert_allclose(gives[:, 3], rigid[:, 3], atol=0.3)  # in the air
    assert (gives[:, -1] < 1.0).all()


@pytest.mark.parametrize("coordinates", ["[x, y]", "[x, y, z, yaw, roll, pitch]"])
def test_it_does_so_in_any_frame(coordinates):
    gives = tilt_deg(played(*LEAN, "control.tilt_radps=0.07", f"filter.coordinates={coordinates}"))
    assert (gives[:, -1] < 1.0).all()


def test_on_an_upright_plate_the_tool_stays_upright():
    done = played("control.tilt_radps=0.07")
    turn = np.asarray(done.felt.trace.turn_world)
    assert np.rad2deg(np.linalg.norm(turn[:, -1], axis=-1)).max() < 1


def test_without_an_admittance_nothing_changes():
    config, policy = read_config(None, []), stateless(pressing)
    assert levelled(policy, config) is policy
    assert not acting(policy, config).turns


def seen(torque: list[float], contact: bool = True) -> PolicyInput:
    wrench = jnp.tile(jnp.array([0, 0, 5.0, *torque]), (50, 1))
    zero = jnp.zeros(3)
    start = PolicyStart(jnp.array(0), jnp.zeros(2), jnp.array(0))
    quat = jnp.array([0.0, 1.0, 0, 0])
    return PolicyInput(
        start, jax.random.key(0), jax.random.key(0), jnp.array(1), zero, quat, zero, zero, wrench,
        jnp.array(contact), 10,
    )  # fmt: skip


def test_it_gives_at_the_admittance_in_the_torques_direction_up_to_a_limit():
    """By hand: the arm's torque about the tool's x is 0.1 N·m, so the plate's about the world's is -0.1."""
    config = read_config(None, ["control.tilt_radps=0.05"])
    policy = levelled(Policy(lambda start, key: (), lambda state, seen: (state, jnp.ones(3)), "p"), config)
    state, command = policy.act(Levelled((), jnp.zeros(3)), seen([0.1, 0, 0.3]))
    np.testing.assert_allclose(command, [1, 1, 1, -0.5 * 0.1 * 0.1, 0, 0], atol=1e-7)
    _, again = policy.act(state, seen([0, 0.1, 0]))
    np.testing.assert_allclose(again[3:], [-0.005, 0.005, 0], atol=1e-7)
    _, free = policy.act(state, seen([1, 1, 0], contact=False))
    np.testing.assert_allclose(free[3:], [-0.005, 0, 0], atol=1e-7)
    far = Levelled((), jnp.array([MOST_RAD, 0, 0]))
    _, most = policy.act(far, seen([-9, 0, 0]))
    assert np.linalg.norm(most[3:]) == pytest.approx(MOST_RAD, rel=1e-5)
