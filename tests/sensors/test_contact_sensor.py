"""The learned sensor: padding, shapes, noise models, gradients, scaling."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import PAPER_SENSOR, make_rollouts

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.learning import SensorConfig
from mjx_fit.sensors.contact_sensor import MIN_INPUT_STD, ContactSensor, InputScale, final_position
from mjx_fit.sensors.encoder import TraceEncoder
from mjx_fit.sensors.features import MEASURABLE, contact_features, row_features
from mjx_fit.sensors.heads import PositionNoise
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.types import Observation, Reading
from mjx_fit.utils.errors import RequestError

SMALL = SensorConfig(
    width=16, conv_channels=(4, 4, 8, 8, 8), layers=1, heads=2, feedforward=16, **PAPER_SENSOR
)
ROWS = 12


def make_reading(episodes: int = 6, rows: int = ROWS, seed: int = 0) -> Reading:
    data = make_rollouts(episodes, actions=ROWS, seed=seed, min_length=3).felt
    keys = jax.random.split(jax.random.key(seed), episodes)
    return jax.vmap(lambda one, key: read_window(one, key, Config(), Window(rows)))(data, keys)


def make_sensor(config: SensorConfig = SMALL) -> ContactSensor:
    sensor = ContactSensor(config, nnx.Rngs(0))
    sensor.fit_input_scale(make_reading(32, seed=9))
    return sensor


PLAIN = make_sensor()
ORDERED = make_sensor(replace(SMALL, positional=True, causal=True))


@nnx.jit
def observe(sensor: ContactSensor, reading: Reading) -> Observation:
    return sensor(reading)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rubbish=st.sampled_from([1.0, 1e6, float("nan"), float("inf")]),
    sensor=st.sampled_from([PLAIN, ORDERED]),
)
def test_padding_never_changes_an_observation(seed, rubbish, sensor):
    reading = make_reading(seed=seed % 7)
    rng = np.random.default_rng(seed)

    def fill(x):
        if x.ndim < 2 or x.dtype == bool:
            return x
        mask = reading.mask.reshape(*reading.mask.shape, *[1] * (x.ndim - 2))
        return jnp.where(mask, x, jnp.asarray(rubbish * rng.normal(size=x.shape), x.dtype))

    want, got = observe(sensor, reading), observe(sensor, jax.tree.map(fill, reading))
    assert not bool(jnp.all(reading.mask))
    jax.tree.map(np.testing.assert_array_equal, got, want)


@pytest.mark.parametrize("sensor", [PLAIN, ORDERED])
def test_more_padding_never_changes_an_observation(sensor):
    short, long = make_reading(), make_reading(rows=ROWS + 5)
    # The draws of the noise belong to a number of rows: compare the same readings, padded further.
    padded = jax.tree.map(
        lambda x, y: jnp.zeros_like(y).at[:, :ROWS].set(x) if x.ndim > 1 else x,
        short,
        long,
    )
    got, want = observe(sensor, padded), observe(sensor, short)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=2e-4, atol=1e-5), got, want)


def test_real_rows_do_change_an_observation():
    reading = make_reading()
    changed = replace(reading, wrench_sensor=jnp.asarray(reading.wrench_sensor).at[:, 0].add(50.0))
    moved = observe(PLAIN, changed).innovation - observe(PLAIN, reading).innovation
    assert np.abs(moved).min() > 0


def test_only_positional_or_causal_sensors_know_the_order_of_rows():
    reading = make_reading()
    length = int(reading.mask.sum(1).min())
    reading = replace(reading, mask=jnp.tile(jnp.arange(ROWS) < length, (6, 1)))
    order = np.r_[np.arange(length)[::-1], np.arange(length, ROWS)]
    turned = jax.tree.map(lambda x: x[:, order] if x.ndim > 1 else x, reading)
    for sensor in (PLAIN, ORDERED):
        same = np.allclose(observe(sensor, turned).innovation, observe(sensor, reading).innovation, atol=1e-6)
        assert same == (sensor is PLAIN)


@pytest.mark.parametrize("batch", [(), (6,), (2, 3)])
def test_shapes_follow_the_batch(batch):
    reading = jax.tree.map(lambda x: x[: int(np.prod(batch))].reshape(*batch, *x.shape[1:]), make_reading())
    observation = observe(PLAIN, reading)
    assert observation.innovation.shape == (*batch, 2)
    assert observation.pos_noise_cov.shape == (*batch, 2, 2)
    assert observation.match_logits.shape == (*batch, 2)
    assert observation.match_model_logp.shape == (*batch, 3, 2)
    if batch == (2, 3):
        alone = observe(PLAIN, jax.tree.map(lambda x: x[1, 2], reading))
        jax.tree.map(
            lambda a, b: np.testing.assert_allclose(a, b[1, 2], rtol=1e-4, atol=1e-6), alone, observation
        )


def test_a_reading_without_rows_gives_finite_numbers():
    reading = replace(make_reading(), mask=jnp.zeros((6, ROWS), bool))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(observe(ORDERED, reading)))


@settings(max_examples=30, deadline=None)
@given(raw=st.lists(st.floats(-30, 30), min_size=9, max_size=9))
def test_noise_models_are_a_covariance_and_distributions_whatever_the_weights(raw):
    sensor = ContactSensor(SMALL, nnx.Rngs(0))
    sensor.position_noise.raw.embedding[...] = jnp.array(raw).reshape(3, 3)
    sensor.match_model.logits.embedding[...] = jnp.array([*raw, *raw]).reshape(3, 6)
    peg_type = jnp.arange(3)
    noise_cov = np.asarray(sensor.position_noise(peg_type, jnp.zeros((3, 32))), float)
    np.testing.assert_array_equal(noise_cov, np.swapaxes(noise_cov, -1, -2))
    # det(L Lᵀ) = det(L)², and the product of the diagonal has a floor; eigenvalues in float32 do not show it.
    assert (noise_cov[:, 0, 0] > 0).all()
    assert (noise_cov[:, 1, 1] >= (noise_cov[:, 0, 1] ** 2 / noise_cov[:, 0, 0]) * (1 - 1e-5)).all()
    np.testing.assert_allclose(np.exp(sensor.match_model(peg_type)).sum(-1), 1, rtol=1e-5)


def test_noise_models_belong_to_the_peg_and_start_sensible():
    model = np.exp(PLAIN.match_model(jnp.arange(3)))
    for peg in range(3):
        assert [row.argmax() for row in model[peg]] == [int(hole == peg) for hole in range(3)]
    observation = observe(PLAIN, make_reading())
    np.testing.assert_allclose(observation.pos_noise_cov[0], (0.0070**2) * np.eye(2), rtol=0.03, atol=1e-12)


def test_every_parameter_has_a_gradient():
    sensor, reading = ORDERED, make_reading()
    assert set(np.asarray(reading.peg_type)) == {0, 1, 2}
    graphdef, params, rest = nnx.split(sensor, nnx.Param, ...)
    weights = jax.tree.map(lambda x: jax.random.normal(jax.random.key(1), x.shape), observe(sensor, reading))

    def loss(params):
        observation = nnx.merge(graphdef, params, rest)(reading)
        return sum(jnp.sum(a * b) for a, b in zip(*map(jax.tree.leaves, (observation, weights)), strict=True))

    grads = jax.tree_util.tree_leaves_with_path(jax.jit(jax.grad(loss))(params))
    assert len(grads) > 25
    for path, grad in grads:
        assert np.isfinite(grad).all(), jax.tree_util.keystr(path)
        assert np.abs(grad).max() > 0, jax.tree_util.keystr(path)


def test_inputs_are_scaled_by_the_real_rows_only():
    sensor, reading = PLAIN, make_reading(32, seed=9)
    real = np.asarray(reading.mask)
    features = np.asarray(row_features(reading, as_vector=True))[real]
    for scale, rows, least in (
        (sensor.wrench_scale[...], np.asarray(reading.wrench_sensor)[real].reshape(-1, 6), MIN_INPUT_STD),
        (sensor.row_scale[...], features, MEASURABLE[: features.shape[1]]),
    ):
        np.testing.assert_allclose(scale[0], rows.mean(0), rtol=1e-3, atol=1e-4)
        np.testing.assert_allclose(scale[1], np.maximum(rows.std(0), least), rtol=1e-3)


def test_a_rotation_vector_does_not_depend_on_the_sign_of_a_quaternion():
    sensor, reading = make_sensor(replace(SMALL, pose="start")), make_reading()
    sensor.fit_input_scale(reading)
    negated = replace(reading, tip_quat_world=-reading.tip_quat_world)
    both = (jax.tree.leaves(observe(sensor, one)) for one in (reading, negated))
    for one, other in zip(*both, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)


def test_nothing_is_scaled_up_beyond_what_a_robot_measures():
    """A tilt of hundredths of a degree is a perfect torque sensor in a simulator, and noise on a robot."""
    sensor, reading = make_sensor(replace(SMALL, pose="start")), make_reading(32)
    quat = reading.tip_quat_world * 1e-5 + jnp.array([0.0, 1.0, 0.0, 0.0])
    flat = replace(reading, tip_quat_world=quat, tip_pos_estimate=reading.tip_pos_estimate * 1e-6)
    sensor.fit_input_scale(flat)
    scale = np.asarray(sensor.row_scale[...])[1]
    assert (scale[3:6] >= 2.5e-4).all()
    assert (scale[6:9] >= np.deg2rad(0.1)).all()


def test_scaling_is_stored_and_not_trained():
    _, params, scale = nnx.split(PLAIN, nnx.Param, InputScale)
    assert len(jax.tree.leaves(scale)) == 2
    assert len(jax.tree.leaves(params)) > 25


def test_dropout_is_off_without_rngs_and_random_with():
    sensor, reading = make_sensor(replace(SMALL, dropout=0.5)), make_reading()
    dropped = nnx.jit(lambda sensor, reading, key: sensor(reading, nnx.Rngs(dropout=key)).innovation)
    first, second = (dropped(sensor, reading, jax.random.key(seed)) for seed in (0, 1))
    still = observe(sensor, reading).innovation
    np.testing.assert_array_equal(still, observe(PLAIN, reading).innovation)
    assert not np.allclose(first, second)
    assert not np.allclose(first, still)


def test_heads_that_do_not_divide_the_width_are_refused():
    with pytest.raises(
        RequestError, match=r"sensor\.heads: 3 is invalid: expected a divisor of sensor\.width"
    ):
        make_sensor(replace(SMALL, heads=3))


def test_places_are_weighted_means_of_the_real_rows():
    """A place that all real rows share comes through as it is; others stay within their reach."""
    config = replace(SMALL, places=3)
    encoder = TraceEncoder(config, 5, nnx.Rngs(0))
    rng = np.random.default_rng(0)
    mask = np.arange(ROWS) < np.array([1, 4, ROWS])[:, None]
    wrench, rows = rng.normal(size=(3, ROWS, 50, 6)), rng.normal(size=(3, ROWS, 5))
    places = np.where(mask[..., None], np.array([0.3, -1.2, 0.7, 2.0]), 50.0)

    encode = nnx.jit(lambda encoder, *inputs: encoder(*inputs, None))

    def means(places):
        code = encode(encoder, *(np.asarray(x, np.float32) for x in (wrench, rows, places)), mask)
        return np.asarray(code)[:, config.width :].reshape(3, 3, 4)

    np.testing.assert_allclose(means(places), np.broadcast_to([0.3, -1.2, 0.7, 2.0], (3, 3, 4)), rtol=1e-5)
    apart = np.where(mask[..., None], rng.normal(size=(3, ROWS, 4)), 50.0)
    found, real = means(apart), np.where(mask[..., None], apart, np.nan)
    assert (found >= np.nanmin(real, 1)[:, None] - 1e-5).all()
    assert (found <= np.nanmax(real, 1)[:, None] + 1e-5).all()


def test_the_final_position_and_where_it_was_pressed():
    """Of the last real row; pressed where the tip is and from there on, not opposite to it."""
    rng = np.random.default_rng(1)
    tip, pressure, wrench = (rng.normal(size=(4, 5, *axes)) for axes in ((3,), (2,), (50, 6)))
    count = np.array([1, 3, 5, 4])
    reading = Reading(*[np.zeros(0)] * 10)
    reading = replace(reading, wrench_sensor=wrench, pressure_tip=pressure, tip_pos_estimate=tip)
    reading = replace(reading, mask=np.arange(5) < count[:, None])
    final, features = jax.jit(lambda one: (final_position(one), contact_features(one)))(reading)
    np.testing.assert_allclose(final, [tip[i, n - 1, :2] for i, n in enumerate(count)], rtol=1e-6)
    want = [wrench.mean(2), wrench.std(2), pressure, tip[..., :2] + pressure]
    np.testing.assert_allclose(features, np.concatenate(want, -1), atol=1e-5)


def test_the_noise_is_the_product_of_a_lower_triangle_with_a_floor():
    """Entry by entry, cm²: of each peg's three numbers two are made positive, the third is below them."""
    noise = PositionNoise(3, 4, False, nnx.Rngs(0))
    raw = np.array([[0.3, -0.7, 0.5], [-30.0, 1.0, -0.2], [2.0, -30.0, 0.0]])
    noise.raw.embedding[...] = jnp.asarray(raw, jnp.float32)
    xx, yy = (np.log1p(np.exp(raw[:, axis])) + 0.01 for axis in range(2))
    below = raw[:, 2]
    want = np.array([[xx**2, xx * below], [xx * below, below**2 + yy**2]]).transpose(2, 0, 1)
    np.testing.assert_allclose(noise(jnp.arange(3), jnp.zeros((3, 4))), want, rtol=1e-4, atol=1e-7)
