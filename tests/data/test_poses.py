"""Data, readings and losses of estimates that have height, yaw and tilt."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from mjx_fit.config.files import read_config
from mjx_fit.data.collect import collect
from mjx_fit.data.episode import Episode
from mjx_fit.data.mirror import mirror_place
from mjx_fit.data.plan import Plan
from mjx_fit.data.reader import load
from mjx_fit.data.schedule import draw_later_attempts
from mjx_fit.data.windows import sample_windows
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.filters import chart
from mjx_fit.scene.placement import place_for_tool
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.sensors.heads import PositionNoise
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.training.loss import filter_loss, place_terms
from mjx_fit.types import Belief, Felt

CONFIG = read_config(
    None,
    [
        "filter.coordinates=[x, y, z, yaw, roll, pitch]",
        "scene.start_height_m=0.012",
        "randomize.socket_yaw_rad={uniform: [-0.15, 0.15]}",
        "randomize.socket_roll_rad={uniform: [-0.05, 0.05]}",
        "randomize.socket_z_m={uniform: [-0.005, 0.005]}",
        "randomize.grasp_pitch_rad={uniform: [-0.05, 0.05]}",
        "randomize.grasp_x_m={uniform: [-0.003, 0.003]}",
        "sensor.width=16",
        "sensor.heads=2",
        "sensor.layers=1",
        "sensor.conv_channels=[4, 4, 4, 4, 4]",
        "train.mirror=true",
        "train.min_window=5",
        "train.max_window=8",
    ],
)
D, EPISODES = 6, 8
NAMES = CONFIG.filter.coordinates


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Episode:
    folder = tmp_path_factory.mktemp("poses") / "data"
    plan = Plan(episodes=EPISODES, actions=8, engine="native", batch=EPISODES, sequence=2, seed=3)
    collect(CONFIG, folder, plan, NativeEngine(CONFIG, 1))
    return load(folder)


def truth_of(data: Episode) -> np.ndarray:
    return np.asarray(place_for_tool(data.rollout.truth.hole_pos_world, data.rollout.truth.physics, CONFIG))


def test_first_estimates_are_upright_and_later_ones_near_the_truth(data):
    estimate, first = np.asarray(data.rollout.felt.estimate_world), np.asarray(data.number) == 0
    assert estimate.shape == (EPISODES, D)
    assert data.estimate_cov.shape == (EPISODES, D, D)
    assert (estimate[first, 2:] == 0).all()
    stds = [0.01, 0.01, 0.003, 0.1, 0.03, 0.03]
    np.testing.assert_allclose(
        data.estimate_cov[first], np.tile(np.diag(np.square(stds)), (4, 1, 1)), rtol=1e-5
    )
    later = ~first & (np.asarray(data.rollout.felt.length) > 0)
    assert np.abs(estimate[later, 2:]).min() > 0


def test_later_estimates_err_as_their_covariances_say():
    ids = jnp.arange(2000)
    drawn, cov = draw_later_attempts(jax.random.key(0), ids, "spiral", 1, CONFIG)
    true = place_for_tool(drawn.hole_pos_world, drawn.physics, CONFIG)
    error = chart.step_between(true, drawn.estimate_world, NAMES)
    whitened = np.linalg.solve(np.linalg.cholesky(np.asarray(cov)), np.asarray(error)[..., None])[..., 0]
    np.testing.assert_allclose(np.cov(whitened.T), np.eye(D), atol=0.12)


def test_the_first_command_turns_the_tool_as_the_estimate_is(data):
    turn = data.rollout.felt.trace.turn_world
    assert turn is not None
    want = np.asarray(data.rollout.felt.estimate_world)[:, [4, 5, 3]]
    happened = np.asarray(data.rollout.felt.length) > 0
    np.testing.assert_allclose(turn[happened, 0], want[happened], atol=1e-6)


def test_a_reading_is_the_one_of_an_upright_estimate_in_a_turned_world(data):
    """Turn trace and estimate about the base: the reading stays, relative to the estimate."""
    felt: Felt = jax.tree.map(lambda leaf: leaf[1], data.rollout.felt)
    turn = Rotation.from_rotvec([0, 0, 0.7])

    def turned_vector(vector: Any) -> np.ndarray:
        return turn.apply(np.asarray(vector)).astype(np.float32)

    trace, estimate = felt.trace, np.asarray(felt.estimate_world)
    quat = (turn * Rotation.from_quat(trace.tip_quat_world, scalar_first=True)).as_quat(scalar_first=True)
    rotation = (turn * Rotation.from_rotvec(estimate[[4, 5, 3]])).as_rotvec()
    place = turn.apply([*estimate[:2], 0])[:2]
    moved = replace(
        felt,
        trace=replace(
            trace,
            tip_quat_world=quat.astype(np.float32),
            **{
                name: turned_vector(getattr(trace, name))
                for name in ("tip_pos_world", "tip_linvel_world", "tip_angvel_world", "action_world")
            },
        ),
        estimate_world=np.array([*place, estimate[2], rotation[2], *rotation[:2]], np.float32),
    )
    window, key, exact = Window(8), jax.random.key(0), replace(CONFIG, pose=CONFIG.pose.without_errors())
    before, after = (read_window(one, key, exact, window) for one in (felt, moved))
    for name in ("tip_pos_estimate", "tip_linvel_world", "tip_angvel_world", "action_world", "wrench_sensor"):
        np.testing.assert_allclose(getattr(before, name), getattr(after, name), atol=2e-6)
    np.testing.assert_allclose(before.tip_quat_world, after.tip_quat_world, atol=2e-6)


def test_windows_carry_the_place_for_the_tool_and_mirror_it(data):
    episodes = jnp.tile(jnp.arange(EPISODES), 8)
    sample = sample_windows(data, episodes, jax.random.key(0), CONFIG)
    true = np.tile(truth_of(data), (8, 1))
    side = np.asarray(sample.place_world)[:, 1] * true[:, 1] > 0
    assert 0 < side.sum() < len(side)
    want = np.where(side[:, None], true, np.asarray(mirror_place(true, NAMES)))
    np.testing.assert_allclose(sample.place_world, want, atol=1e-6)


def test_mirrored_rotations_are_those_of_the_mirrored_frame():
    """Reflection conjugates a rotation: M R M with M = diag(1, -1, 1)."""
    place = np.array([0.4, 0.1, 0.003, 0.2, -0.1, 0.05])
    mirror = np.diag([1, -1, 1])
    want = Rotation.from_matrix(mirror @ Rotation.from_rotvec(place[[4, 5, 3]]).as_matrix() @ mirror)
    found = np.asarray(mirror_place(place, NAMES))
    np.testing.assert_allclose(found[[4, 5, 3]], want.as_rotvec(), atol=1e-12)
    np.testing.assert_allclose(found[:3], [0.4, -0.1, 0.003])


def test_noise_has_the_cholesky_factor_that_the_network_says():
    noise = PositionNoise(3, 4, False, nnx.Rngs(0), d=3)
    raw = np.array([0.1, -0.2, 0.3, 0.5, -0.6, 0.7], np.float32)
    noise.raw.embedding[...] = jnp.tile(raw, (3, 1))
    root = np.diag(np.logaddexp(0, raw[:3]) + 0.01)
    root[1, 0], root[2, 0], root[2, 1] = raw[3:]
    np.testing.assert_allclose(noise(jnp.array(0), jnp.zeros(4)), root @ root.T, rtol=1e-5)


def test_the_loss_is_the_density_per_centimetre_and_tenth_of_a_radian():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(D, D)) * 0.01
    unit = np.array([0.01, 0.01, 0.01, 0.1, 0.1, 0.1])
    mean, cov = rng.uniform(-0.2, 0.2, D), root @ root.T + 1e-4 * np.eye(D)
    belief = Belief(jnp.asarray(mean, jnp.float32), jnp.asarray(cov, jnp.float32), jnp.zeros(1))
    place = mean + rng.normal(0, 0.01, D)
    turn = Rotation.from_rotvec(place[[4, 5, 3]]) * Rotation.from_rotvec(mean[[4, 5, 3]]).inv()
    error = np.array([*(place - mean)[:3], *turn.as_rotvec()[[2, 0, 1]]])
    density = multivariate_normal.logpdf(error / unit, np.zeros(D), (cov / unit / unit[:, None]).tolist())
    found = sum(place_terms(belief, jnp.asarray(place, jnp.float32), NAMES))
    assert float(found) == pytest.approx(-density - D / 2 * np.log(2 * np.pi), rel=1e-3)


@pytest.mark.slow
def test_a_sensor_of_six_coordinates_learns(data):
    """The gradient of the loss is finite and reaches the heads of all coordinates."""
    sensor = ContactSensor.of(CONFIG, nnx.Rngs(0))
    sample = sample_windows(data, jnp.arange(EPISODES), jax.random.key(1), CONFIG)
    sensor.fit_input_scale(sample.reading)

    def loss(network):
        return filter_loss(network(sample.reading), sample, NAMES).total.mean()

    value, grad = nnx.value_and_grad(loss)(sensor)
    assert np.isfinite(value)
    last = np.asarray(grad.position.last.bias[...])
    assert last.shape == (D,)
    assert (np.abs(last) > 0).all()
    assert np.isfinite(np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(grad)])).all()
