"""Commands of six components: the controller turns the TCP, in both engines."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxlie import SO3

from mjx_fit.api import draw_attempts
from mjx_fit.config.files import read_config
from mjx_fit.control import goals
from mjx_fit.control.kinematics import STRAIGHT_DOWN, turned_down
from mjx_fit.control.policies import Policy, PolicyInput
from mjx_fit.control.policy_file import require_policy
from mjx_fit.data.collect import collect
from mjx_fit.data.exports import export
from mjx_fit.data.manifest import read_manifest
from mjx_fit.data.plan import Plan
from mjx_fit.data.reader import load
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.engines.select import make_engine
from mjx_fit.utils.errors import RequestError

CONFIG = read_config(None, ["scene.start_height_m=0.02"])
TURN = np.array([0.04, -0.03, 0.2])


def turning(turn: np.ndarray, push_m: float = 0.0) -> Policy:
    """Return a policy that turns the TCP over its place, and pushes."""

    def act(state, seen: PolicyInput):
        away = seen.start.estimate_world - seen.tip_pos_world[:2]
        return state, jnp.concatenate([away, jnp.array([-push_m, *turn])])

    return Policy(lambda start, key: (), act, "turning", turns=True)


def rotation_of(quat: np.ndarray) -> np.ndarray:
    """Return the rotation vector from straight down."""
    down = SO3(jnp.array([0.0, 1.0, 0.0, 0.0]))
    return np.asarray((SO3(jnp.asarray(quat)) @ down.inverse()).log())


def test_the_tcp_turns_in_free_space_as_commanded():
    attempts = draw_attempts(jax.random.key(0), 3, config=CONFIG)
    done = NativeEngine(CONFIG, 1, turning(TURN)).run(attempts, 25)
    trace = done.felt.trace
    for quat, place in zip(trace.tip_quat_world[:, -1], trace.tip_pos_world[:, -1], strict=True):
        np.testing.assert_allclose(rotation_of(quat), TURN, atol=3e-3)
        assert place[2] > 0.05
    np.testing.assert_allclose(trace.tip_pos_world[:, -1, :2], attempts.estimate_world, atol=5e-4)
    assert trace.turn_world is not None
    np.testing.assert_allclose(trace.turn_world, np.broadcast_to(TURN, (3, 25, 3)), atol=1e-6)
    assert trace.action_world.shape == (3, 25, 3)
    assert done.truth.valid.all()


@pytest.mark.parametrize("push", ["displacement", "force"])
def test_a_turned_peg_is_inserted_into_a_turned_socket(push):
    """The socket is turned by 0.15 rad: the peg goes in with that command, not straight down."""
    keys = ["placement.socket_yaw_rad=0.15", "placement.socket_roll_rad=0.03", f"control.push={push}"]
    config = read_config(None, [*keys, "scene.start_height_m=0.004"])
    drawn = draw_attempts(jax.random.key(0), 6, config=config)
    attempts = replace(drawn, hole_type=drawn.peg_type, estimate_world=drawn.hole_pos_world)
    for turn, inserted in (([0.03, 0, 0.15], True), ([0.0, 0, 0], False)):
        done = NativeEngine(config, 1, turning(np.array(turn), push_m=0.004)).run(attempts, 40)
        assert (np.asarray(done.truth.inserted) == inserted).all()


def test_the_frame_of_a_rotation_vector_is_that_rotation_of_straight_down():
    turns = np.random.default_rng(0).normal(0, 0.5, (3, 5)).astype(np.float32)
    frames = np.asarray(turned_down(jnp.asarray(turns)))
    for i, turn in enumerate(turns.T):
        angle = np.linalg.norm(turn)
        x, y, z = turn / angle
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        rodrigues = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        np.testing.assert_allclose(frames[..., i], rodrigues @ STRAIGHT_DOWN, atol=1e-6)


def test_goals_turn_evenly_during_an_action_and_keep_the_position():
    tip, command = np.array([0.5, 0.1, 0.2], np.float32), np.array([0.01, 0, -0.004, *TURN], np.float32)
    wanted = goals.commanded(tip, command, CONFIG.control)
    begin = goals.at_rest(tip, CONFIG.control, np.zeros(3, np.float32))
    _, halfway = goals.goal_during(begin, wanted, 24, CONFIG.control)
    np.testing.assert_allclose(halfway, [0.505, 0.1, 0.198, *TURN / 2], atol=1e-6)
    flat = goals.commanded(tip, command[:3], CONFIG.control)
    np.testing.assert_array_equal(np.asarray(wanted)[:3], flat)


@pytest.mark.parametrize(("turns", "width"), [(True, 3), (False, 6)])
def test_a_command_of_another_width_is_refused(turns, width):
    policy = Policy(lambda start, key: (), lambda state, seen: (state, jnp.zeros(width)), "odd", turns=turns)
    with pytest.raises(RequestError, match=rf"the command of odd is float32 \({width},\): expected floats"):
        require_policy(policy)


def test_data_keep_turns(tmp_path):
    plan = Plan(episodes=2, actions=2, policy="turning", engine="native", batch=2)
    collect(CONFIG, tmp_path, plan, NativeEngine(CONFIG, 1, turning(TURN)))
    turn = load(tmp_path).rollout.felt.trace.turn_world
    assert turn is not None
    np.testing.assert_allclose(turn, np.broadcast_to(TURN, (2, 2, 3)), atol=1e-6)
    assert read_manifest(tmp_path).request["turns"] is True
    export(tmp_path, tmp_path / "all.npz")
    np.testing.assert_array_equal(np.load(tmp_path / "all.npz")["trace_turn_world"], turn)


@pytest.mark.slow
def test_both_engines_turn_the_same_way():
    config = read_config(None, ["placement.socket_yaw_rad=0.1", "placement.grasp_roll_rad=0.03"])
    drawn = draw_attempts(jax.random.key(0), 4, config=config)
    attempts = replace(drawn, estimate_world=drawn.hole_pos_world + np.float32(0.006))
    policy = turning(np.array([0.02, 0.02, 0.1]), push_m=0.004)
    native, mjx = (make_engine(name, config, policy).run(attempts, 8) for name in ("native", "mjx"))
    for name in ("tip_pos_world", "tip_quat_world", "turn_world"):
        one, other = (np.asarray(getattr(done.felt.trace, name)) for done in (native, mjx))
        np.testing.assert_allclose(one, other, atol=2e-4)
