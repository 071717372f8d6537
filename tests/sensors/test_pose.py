"""Measured pose and twist, against SciPy's rotations."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from synthetic import make_rollouts

from mjx_fit.config.sections.measurement import PoseConfig
from mjx_fit.sensors.pose import canonical, from_down, is_exact, measured_trace, rotation_from_down, turned
from mjx_fit.types import Trace

EXACT = PoseConfig().without_errors()

KEYS = jax.random.split(jax.random.key(3))
vectors = st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).map(np.array)


def of_scipy(quat_wxyz) -> Rotation:
    return Rotation.from_quat(np.asarray(quat_wxyz), scalar_first=True)


def trace_of(n: int = 4, actions: int = 12) -> Trace:
    """Traces near straight down, as in attempts."""
    trace = make_rollouts(n, actions=actions).felt.trace
    small = 0.02 * np.random.default_rng(0).normal(size=trace.tip_pos_world.shape)
    return replace(trace, tip_quat_world=np.asarray(from_down(jnp.asarray(small, jnp.float32))))


def measure(trace: Trace, pose: PoseConfig, noise: int = 0) -> Trace:
    keys = jax.random.split(KEYS[0], len(trace.tip_pos_world))
    other = jax.random.split(jax.random.fold_in(KEYS[1], noise), len(trace.tip_pos_world))
    return jax.vmap(lambda row, offset, white: measured_trace(row, offset, white, pose))(trace, keys, other)


@given(vectors)
def test_a_rotation_vector_there_and_back(vector):
    np.testing.assert_allclose(rotation_from_down(from_down(jnp.asarray(vector))), vector, atol=2e-5)


@given(vectors, vectors)
def test_turning_is_scipys_product(first, second):
    quat = np.asarray(from_down(jnp.asarray(first)))
    both = Rotation.from_rotvec(second) * of_scipy(quat)
    away = of_scipy(turned(jnp.asarray(quat), jnp.asarray(second))) * both.inv()
    assert away.magnitude() < 1e-5


@given(vectors)
def test_a_negated_quaternion_changes_nothing(vector):
    quat = from_down(jnp.asarray(vector))
    np.testing.assert_array_equal(rotation_from_down(quat), rotation_from_down(-quat))
    np.testing.assert_array_equal(canonical(quat), canonical(-quat))


def test_the_gradient_at_straight_down_is_finite():
    grad = jax.grad(lambda quat: rotation_from_down(quat).sum())(jnp.array([0.0, 1.0, 0.0, 0.0]))
    assert jnp.isfinite(grad).all()


def test_without_errors_nothing_changes():
    assert is_exact(EXACT)
    trace = trace_of()
    seen = measure(trace, EXACT)
    np.testing.assert_array_equal(seen.tip_pos_world, trace.tip_pos_world)
    np.testing.assert_allclose(seen.tip_quat_world, canonical(trace.tip_quat_world), atol=1e-6)


@pytest.mark.parametrize(
    ("key", "field"),
    [
        ("position_noise_m", "tip_pos_world"),
        ("linear_noise_mps", "tip_linvel_world"),
        ("angular_noise_radps", "tip_angvel_world"),
    ],
)
def test_noise_is_white_with_its_sigma_and_in_its_field_alone(key, field):
    trace = trace_of(64, 20)
    pose = replace(EXACT, **{key: 0.004})
    assert not is_exact(pose)
    seen = measure(trace, pose)
    noise = np.asarray(getattr(seen, field) - getattr(trace, field))
    assert noise.std() == pytest.approx(0.004, rel=0.05)
    assert abs(np.corrcoef(noise[:, :-1].ravel(), noise[:, 1:].ravel())[0, 1]) < 0.05
    for other in {"tip_pos_world", "tip_linvel_world", "tip_angvel_world"} - {field}:
        np.testing.assert_allclose(getattr(seen, other), getattr(trace, other), atol=1e-6)


def test_orientation_noise_is_a_turn_of_its_sigma():
    trace = trace_of(64, 20)
    seen = measure(trace, replace(EXACT, orientation_noise_rad=0.003))
    away = of_scipy(seen.tip_quat_world.reshape(-1, 4)) * of_scipy(trace.tip_quat_world.reshape(-1, 4)).inv()
    assert away.as_rotvec().std() == pytest.approx(0.003, rel=0.05)


def test_offsets_are_constant_in_an_attempt_and_their_own_in_each():
    trace = trace_of(200)
    pose = replace(EXACT, position_offset_m=0.001, height_offset_m=0.002)
    offset = np.asarray(measure(trace, pose).tip_pos_world - trace.tip_pos_world)
    np.testing.assert_allclose(offset, offset[:, :1].repeat(offset.shape[1], 1), atol=1e-6)
    assert offset[:, 0, :2].std() == pytest.approx(0.001, rel=0.15)
    assert offset[:, 0, 2].std() == pytest.approx(0.002, rel=0.15)
    again = np.asarray(measure(trace, pose, noise=1).tip_pos_world - trace.tip_pos_world)
    np.testing.assert_array_equal(again, offset)


def test_a_delay_shows_where_the_tip_was():
    """A constant twist: position and orientation of τ ago, the same velocities."""
    time = 0.1 * np.arange(1, 11)
    velocity, spin = np.array([0.02, -0.01, 0.005]), np.array([0.1, 0.2, -0.05])

    def at(t):
        quat = (Rotation.from_rotvec(t[:, None] * spin) * of_scipy([0.0, 1.0, 0.0, 0.0])).as_quat(
            scalar_first=True
        )
        return t[:, None] * velocity, quat

    position, quat = at(time)
    trace = jax.tree.map(lambda leaf: leaf[0, :10], make_rollouts(1, actions=10).felt.trace)
    trace = replace(
        trace,
        tip_pos_world=jnp.asarray(position),
        tip_quat_world=jnp.asarray(quat),
        tip_linvel_world=jnp.tile(jnp.asarray(velocity), (10, 1)),
        tip_angvel_world=jnp.tile(jnp.asarray(spin), (10, 1)),
    )
    seen = measured_trace(trace, KEYS[0], KEYS[1], replace(EXACT, delay_s=0.02))
    before, turned_before = at(time - 0.02)
    np.testing.assert_allclose(seen.tip_pos_world, before, atol=1e-6)
    assert (of_scipy(seen.tip_quat_world) * of_scipy(turned_before).inv()).magnitude().max() < 1e-3
    np.testing.assert_allclose(seen.tip_linvel_world, trace.tip_linvel_world, atol=1e-7)


def test_a_delay_of_one_action_shows_the_row_before():
    trace = trace_of(3)
    seen = measure(trace, replace(EXACT, delay_s=0.1))
    np.testing.assert_allclose(seen.tip_pos_world[:, 1:], trace.tip_pos_world[:, :-1], atol=1e-5)
    np.testing.assert_allclose(seen.tip_linvel_world[:, 1:], trace.tip_linvel_world[:, :-1], atol=1e-5)
    before = of_scipy(canonical(trace.tip_quat_world)[:, :-1].reshape(-1, 4))
    assert (of_scipy(seen.tip_quat_world[:, 1:].reshape(-1, 4)) * before.inv()).magnitude().max() < 1e-4


def test_resolution_rounds():
    seen = measure(trace_of(), replace(EXACT, position_step_m=0.001, orientation_step_rad=0.005))
    steps = np.asarray(seen.tip_pos_world) / 0.001
    np.testing.assert_allclose(steps, steps.round(), atol=1e-2)
    turns = np.asarray(rotation_from_down(seen.tip_quat_world)) / 0.005
    np.testing.assert_allclose(turns, turns.round(), atol=1e-2)
