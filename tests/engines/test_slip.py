"""Pegs that slip in the hand: the law, both engines, and what goes on with the grasp that is left."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxlie import SE3, SO3

from mjx_fit.api import draw_attempts
from mjx_fit.config.files import read_config
from mjx_fit.config.sections.placement import PlacementConfig
from mjx_fit.data.collect import collect
from mjx_fit.data.plan import Plan
from mjx_fit.data.reader import load
from mjx_fit.data.schedule import draw_places
from mjx_fit.engines.mjx.engine import MjxEngine
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.evaluation.single_hole_runner import holes_at
from mjx_fit.scene.placement import GRASP, place_for_tool
from mjx_fit.scene.scenarios import draw_trials
from mjx_fit.scene.slip import slip_velocity, slipped, with_grasp
from mjx_fit.task import methods, single_hole
from mjx_fit.task.assembly_state import Table
from mjx_fit.types.physics import Physics

KEYS = ["control.push=force", "filter.coordinates=[x, y, z, yaw, roll, pitch]"]
WEAK, STRONG, FIRM = (
    read_config(None, [*KEYS, f"placement.grip_n={n}", f"placement.grip_nm={nm}"])
    for n, nm in ((4, 0.3), (900, 90), (0, 1))
)
GRIP = PlacementConfig(grip_n=8.0, grip_nm=0.4, slip_mps=0.02)
SCALE = np.array([8.0] * 3 + [0.4] * 3)
N = 4


def grasps(physics: Physics) -> np.ndarray:
    return np.stack([np.asarray(getattr(physics, name)) for name in GRASP], -1)


@given(st.lists(st.floats(-3, 3), min_size=12, max_size=12))
@settings(deadline=None)
def test_the_peg_slips_along_the_normal_of_the_limit_surface(numbers):
    """Maximum dissipation: no wrench that the grip holds does more work on the slip than the one it meets."""
    load, other = np.reshape(numbers, (2, 6))
    held = other / max(1.0, float(np.linalg.norm(other)))
    velocity = -np.asarray(slip_velocity(jnp.asarray(load * SCALE), GRIP), float)
    s = np.linalg.norm(load)
    if s <= 1 - 1e-6:
        assert not velocity.any()
    elif s >= 1 + 1e-3:
        at_limit = load / s
        assert velocity @ ((at_limit - held) * SCALE) >= -1e-5 * np.abs(velocity @ (at_limit * SCALE))


def test_twice_the_force_slips_at_the_given_speed_against_the_hand():
    velocity = slip_velocity(jnp.array([0.0, 0.0, 16.0, 0, 0, 0]), GRIP)
    np.testing.assert_allclose(velocity, [0, 0, -0.02, 0, 0, 0], atol=1e-7)


def test_the_peg_turns_about_the_fingers():
    """Against composition by jaxlie in the frame of the hand, for a grasp that is askew."""
    rng = np.random.default_rng(0)
    before = Physics(**{name: jnp.float32(x) for name, x in zip(GRASP, rng.normal(0, 0.01, 6), strict=True)})
    wrench, tare = rng.normal(0, 1, 6) * 4 * SCALE, rng.normal(0, 1, 6)
    config = replace(WEAK, placement=GRIP)
    after = slipped(before, jnp.asarray(np.tile(wrench + tare, (50, 1))), jnp.asarray(tare), config)
    tip = SE3.from_translation(jnp.array([0, 0, config.scene.peg_length_m]))

    def hand(physics: Physics) -> SE3:
        *shift, roll, pitch, yaw = grasps(physics)
        grasp = SE3.from_rotation_and_translation(SO3.from_rpy_radians(roll, pitch, yaw), jnp.array(shift))
        return tip @ grasp @ tip.inverse()

    moved = hand(after) @ hand(before).inverse()
    want = SE3.exp(0.1 * slip_velocity(jnp.asarray(wrench), GRIP))
    np.testing.assert_allclose(moved.as_matrix(), want.as_matrix(), atol=2e-5)


@pytest.fixture(scope="module")
def rollouts():
    """Attempts of 1.5 s with a weak grip, one that always holds, and none."""
    attempts = draw_attempts(jax.random.key(3), N, config=FIRM)
    return {
        name: NativeEngine(config, 1).run(attempts, 15)
        for name, config in (("weak", WEAK), ("strong", STRONG), ("firm", FIRM))
    }


def test_a_grip_that_holds_changes_nothing(rollouts):
    strong, firm = rollouts["strong"], rollouts["firm"]
    np.testing.assert_array_equal(grasps(strong.truth.physics), 0)
    np.testing.assert_allclose(strong.felt.trace.wrench_sensor, firm.felt.trace.wrench_sensor, atol=1e-5)


@pytest.mark.slow
def test_both_engines_slip_alike(rollouts):
    native = rollouts["weak"]
    mjx = MjxEngine(WEAK, 1).run(draw_attempts(jax.random.key(3), N, config=FIRM), 15)
    one, other = grasps(native.truth.physics), grasps(mjx.truth.physics)
    far = np.linalg.norm(one[:, :3], axis=1)
    assert far.max() > 5e-4
    np.testing.assert_allclose(other[:, :3], one[:, :3], atol=0.3 * far.max())
    np.testing.assert_array_equal(mjx.felt.length, native.felt.length)


def test_the_grasp_is_the_sum_of_the_slips_of_all_actions(rollouts):
    """The trace alone tells it: each action's mean wrench, in turn."""
    felt = rollouts["weak"].felt
    physics = with_grasp(Physics(), WEAK, N)
    step = jax.jit(jax.vmap(partial(slipped, config=WEAK)))
    for j in range(15):
        physics = step(physics, felt.trace.wrench_sensor[:, j], felt.tare_sensor)
    np.testing.assert_allclose(grasps(physics), grasps(rollouts["weak"].truth.physics), atol=1e-5)


def test_a_shifted_peg_shifts_where_the_tool_has_to_be(rollouts):
    truth = rollouts["weak"].truth
    place = np.asarray(place_for_tool(truth.hole_pos_world, truth.physics, WEAK))
    upright = np.asarray(place_for_tool(truth.hole_pos_world, Physics(), WEAK))
    np.testing.assert_allclose(place[:, 2] - upright[:, 2], grasps(truth.physics)[:, 2], atol=5e-4)


def test_a_data_set_tells_the_grasp_and_later_attempts_begin_with_it(tmp_path):
    plan = Plan(4, 12, "spiral", seed=1, sequence=2)
    collect(WEAK, tmp_path / "data", plan, NativeEngine(WEAK, 1))
    data = load(tmp_path / "data")
    left = grasps(data.rollout.truth.physics)
    first, second = left[::2], left[1::2]
    assert np.abs(first).max() > 5e-4
    felt = data.rollout.felt[1::2]
    physics = Physics(**dict(zip(GRASP, jnp.asarray(first.T), strict=True)))
    step = jax.jit(jax.vmap(partial(slipped, config=WEAK)))
    for j in range(12):
        ran = (j < np.asarray(felt.length))[:, None]
        after = grasps(step(physics, felt.trace.wrench_sensor[:, j], felt.tare_sensor))
        now = np.where(ran, after, grasps(physics))
        physics = Physics(**dict(zip(GRASP, jnp.asarray(now.T), strict=True)))
    np.testing.assert_allclose(grasps(physics), second, atol=2e-5)


def test_attempts_in_a_row_go_on_with_the_grasp_and_the_oracle_knows_it():
    config = replace(WEAK, task=replace(WEAK.task, attempt_actions=12))
    places = draw_places(jax.random.key(0), jnp.arange(3), config)
    holes = holes_at(np.zeros(3, int), np.ones(3, int), places)
    picked = tuple(one for one in methods.INSERTION if one.name in ("no_update", "oracle"))
    table = single_hole.HoleTable(config, picked, holes, 2)
    for _ in single_hole.rounds(table, NativeEngine(config, 1), single_hole.update_of_rows(picked, {})):
        pass
    done = table.outcomes()["oracle"]
    moved = np.abs(np.diff(done.place_world, axis=1)).max(2)
    assert (moved[done.attempts >= 1, 0] > 1e-5).any()
    np.testing.assert_allclose(done.mean_world, done.place_world, atol=1e-6)


def test_a_new_peg_is_held_as_drawn():
    config = replace(WEAK, task=replace(WEAK.task, attempt_actions=8))
    table = Table(config, methods.ASSEMBLY[:1], draw_trials(config, 0, np.arange(2)), 0)
    tried = table.next_try()
    assert tried is not None
    left = with_grasp(Physics(), config, len(tried.active))
    left = replace(left, grasp_x_m=jnp.full(len(tried.active), 0.002))
    table._go_on_with(left)
    again = table.next_try()
    assert again is not None
    np.testing.assert_allclose(grasps(again.attempts.physics)[:, 0], 0.002)
    table.pegs_done[:] += 1
    after = table.next_try()
    assert after is not None
    np.testing.assert_array_equal(grasps(after.attempts.physics), 0)
