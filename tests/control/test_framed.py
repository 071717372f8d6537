"""Policies in the frame of the estimate: what they see and command, and the world turned with them."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxlie import SO3
from scipy.spatial.transform import Rotation

from mjx_fit.api import draw_attempts
from mjx_fit.config.files import read_config
from mjx_fit.control.framed import framed
from mjx_fit.control.policies import Policy
from mjx_fit.engines.attempt_rules import Tip, peg_of
from mjx_fit.engines.select import make_engine
from mjx_fit.filters import frame
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.placement import GRASP, SOCKET, TOOL, place_for_tool, setting_of
from mjx_fit.types import Attempt, Rollout
from mjx_fit.types.physics import AS_CONFIGURED, Physics

ALL = "filter.coordinates=[x, y, z, yaw, roll, pitch]"
PLANE = read_config(None, ["scene.start_height_m=0.004"])
N, ACTIONS = 4, 30


def attempts_at_own_holes(seed: int = 0) -> Attempt:
    drawn = draw_attempts(jax.random.key(seed), N, config=PLANE)
    return replace(drawn, hole_type=drawn.peg_type)


def with_pose(estimate: np.ndarray, *rest: float) -> np.ndarray:
    return np.concatenate([estimate, np.tile(rest, (len(estimate), 1))], 1).astype(np.float32)


def run(
    name: str, attempts: Attempt, *keys: str, actions: int = ACTIONS, policy: Policy | None = None
) -> Rollout:
    config = read_config(None, ["scene.start_height_m=0.004", *keys])
    return make_engine(name, config, policy).run(attempts, actions)


def test_with_x_and_y_alone_a_policy_stays_as_it_is():
    policy = Policy(lambda start, key: (), lambda state, seen: (state, jnp.zeros(3)))
    assert framed(policy, PLANE) is policy


def test_upright_estimates_change_nothing_but_rounding():
    attempts = attempts_at_own_holes()
    plain = run("native", attempts)
    estimate = with_pose(np.asarray(attempts.estimate_world), 0, 0, 0, 0)
    same = run("native", replace(attempts, estimate_world=estimate), ALL)
    for name in ("tip_pos_world", "action_world"):
        one, other = (np.asarray(getattr(done.felt.trace, name))[:, :5] for done in (plain, same))
        np.testing.assert_allclose(one, other, atol=1e-5)
    assert plain.felt.length.tolist() == same.felt.length.tolist()


def turned_about_the_base(name: str, angle: float) -> tuple[Rollout, Rollout]:
    """Return attempts, and the same ones in a world that is turned about the arm's base."""
    attempts = attempts_at_own_holes()
    plain = run(name, attempts)
    turn = Rotation.from_rotvec([0, 0, angle]).as_matrix()[:2, :2]
    hole, estimate = (np.asarray(one) @ turn.T for one in (attempts.hole_pos_world, attempts.estimate_world))
    turned = replace(
        attempts, hole_pos_world=hole.astype(np.float32), estimate_world=with_pose(estimate, angle)
    )
    coordinates = "filter.coordinates=[x, y, yaw]"
    return plain, run(name, turned, coordinates, f"placement.socket_yaw_rad={angle}")


def require_turned_alike(plain: Rollout, turned: Rollout, angle: float) -> None:
    """The arm of seven joints has another posture, and so a slightly other inertia."""
    back = Rotation.from_rotvec([0, 0, -angle])
    places, commands = (
        back.apply(np.asarray(leaf).reshape(-1, 3)).reshape(np.shape(leaf))
        for leaf in (turned.felt.trace.tip_pos_world, turned.felt.trace.action_world)
    )
    np.testing.assert_allclose(places, plain.felt.trace.tip_pos_world, atol=3e-4)
    np.testing.assert_allclose(commands, plain.felt.trace.action_world, atol=3e-4)
    assert plain.felt.length.tolist() == turned.felt.length.tolist()
    force, other = (np.asarray(one.felt.trace.wrench_sensor).mean((1, 2)) for one in (plain, turned))
    np.testing.assert_allclose(force[:, :3], other[:, :3], atol=0.5)


@pytest.mark.parametrize("angle", [-0.4, 0.3])
def test_a_rotation_of_the_world_turns_traces_with_it(angle):
    require_turned_alike(*turned_about_the_base("native", angle), angle)


@pytest.mark.slow
def test_a_rotation_of_the_world_turns_traces_with_it_in_mjx():
    require_turned_alike(*turned_about_the_base("mjx", 0.3), 0.3)


@pytest.mark.parametrize("push", ["displacement", "force"])
def test_a_peg_goes_into_a_leaning_socket_whose_pose_is_known(push):
    """Spirals about the true pose: all go in; about the same place taken for upright, none."""
    pose = {"z": 0.003, "yaw": 0.15, "roll": 0.05, "pitch": 0.0}
    keys = [
        f"placement.socket_{name}_{'m' if name == 'z' else 'rad'}={value}" for name, value in pose.items()
    ]
    attempts = attempts_at_own_holes()
    hole = np.asarray(attempts.hole_pos_world)
    # Yaw after roll: the rotation vector differs from the angles.
    vector = Rotation.from_euler("xyz", [0.05, 0, 0.15]).as_rotvec()
    for rest, share in (((0.003, vector[2], vector[0], vector[1]), 1.0), ((0.0, 0.0, 0.0, 0.0), 0.0)):
        known = replace(attempts, estimate_world=with_pose(hole, *rest))
        done = run("native", known, ALL, *keys, f"control.push={push}", "spiral.radius_m=0.001", actions=60)
        assert done.truth.inserted.mean() == share


def test_a_peg_askew_is_in_its_hole_where_the_tool_has_to_be():
    """With sockets, pegs and tools askew, the peg is judged to be straight in its hole's mouth."""
    n, rng = 20, np.random.default_rng(2)
    most = {**dict.fromkeys((*SOCKET, *GRASP), 0.15), **dict.fromkeys(TOOL, 0.04)}
    most |= dict.fromkeys(("socket_z_m", "grasp_x_m", "grasp_y_m", "grasp_z_m"), 0.01)
    physics = Physics(**{name: rng.uniform(-size, size, n).astype(np.float32) for name, size in most.items()})
    hole, config = rng.uniform(0.3, 0.5, (n, 2)).astype(np.float32), read_config(None, [ALL])
    place, top = place_for_tool(hole, physics, config), plate_top_m(config.scene)
    here = frame.frame_of(place, config.filter.coordinates)
    tip = here.world(jnp.concatenate([place[:, :2], jnp.full((n, 1), top)], 1), top)
    quat = (here.rotation_world @ SO3(jnp.array([0.0, 1, 0, 0]))).wxyz
    reported = Tip(tip, quat, jnp.zeros((n, 3)), jnp.zeros((n, 3)))
    setting = setting_of(hole, physics, config)
    peg = jax.vmap(partial(peg_of, config=config))(reported, setting, physics)
    np.testing.assert_allclose(peg.pos_world, np.column_stack([hole, np.full(n, top)]), atol=1e-6)
    np.testing.assert_allclose(np.abs(peg.quat_world), np.tile([0, 1.0, 0, 0], (n, 1)), atol=1e-5)


def test_an_upright_socket_and_a_straight_peg_are_where_the_hole_is():
    hole = np.array([[0.5, 0.1]], np.float32)
    six = place_for_tool(hole, AS_CONFIGURED, read_config(None, [ALL]))
    np.testing.assert_array_equal(six, [[*hole[0], 0, 0, 0, 0]])
    np.testing.assert_array_equal(place_for_tool(hole, AS_CONFIGURED, PLANE), hole)


def test_a_policy_that_turns_asks_for_its_orientation_in_the_frame():
    def act(state, seen):
        return state, jnp.array([0, 0, 0, 0.05, 0, 0])

    leaning = Policy(lambda start, key: (), act, "leaning", turns=True)
    attempts = attempts_at_own_holes()
    estimate = with_pose(np.asarray(attempts.estimate_world), np.pi / 6)
    done = run(
        "native",
        replace(attempts, estimate_world=estimate),
        "filter.coordinates=[x, y, yaw]",
        actions=20,
        policy=leaning,
    )
    want = Rotation.from_rotvec([0, 0, np.pi / 6]) * Rotation.from_rotvec([0.05, 0, 0])
    assert done.felt.trace.turn_world is not None
    np.testing.assert_allclose(done.felt.trace.turn_world[:, 0], np.tile(want.as_rotvec(), (N, 1)), atol=1e-6)
    down = Rotation.from_quat([0, 1, 0, 0], scalar_first=True)
    reached = Rotation.from_quat(done.felt.trace.tip_quat_world[:, -1], scalar_first=True) * down.inv()
    np.testing.assert_allclose(reached.as_rotvec(), np.tile(want.as_rotvec(), (N, 1)), atol=0.01)
