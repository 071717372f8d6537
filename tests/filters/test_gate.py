"""The gate of the position filter, against dense Gaussians and SciPy's quantiles."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2
from synthetic import make_rollouts

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.learning import SensorConfig
from mjx_fit.filters import kalman
from mjx_fit.filters.updates import NONE, initial_belief, update_position
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.task.estimator import filter_update, posterior
from mjx_fit.types import Belief, Observation

GATE = 0.99
SMALL = SensorConfig(width=8, conv_channels=(2, 2, 2, 2, 2), layers=1, heads=1, feedforward=8)
DOWN = np.tile(np.array([0.0, 1.0, 0.0, 0.0], np.float32), (3, 8, 1))
SIGMA, NOISE = 1e-4 * np.array([[2.0, 0.6], [0.6, 1.0]]), 1e-5 * np.array([[1.0, -0.3], [-0.3, 2.0]])
places = st.lists(st.floats(-0.1, 0.1), min_size=2, max_size=2).map(np.array)


def distance(innovation, cov) -> float:
    return float(innovation @ np.linalg.solve(cov, innovation))


@given(places)
def test_a_reading_ends_inside_the_gate_and_the_gain_stays(innovation):
    gated = kalman.gated(jnp.asarray(SIGMA), jnp.asarray(innovation), jnp.asarray(NOISE), GATE)
    cov, noise = map(np.asarray, gated)
    limit = chi2.ppf(GATE, 2)
    before = distance(innovation, SIGMA + NOISE)
    assert distance(innovation, cov + noise) <= max(limit, before) * 1.001
    assert distance(innovation, cov + noise) <= limit * 1.001
    gain = SIGMA @ np.linalg.inv(SIGMA + NOISE)
    np.testing.assert_allclose(cov @ np.linalg.inv(cov + noise), gain, rtol=1e-3, atol=1e-4)
    if before < 0.999 * limit:
        np.testing.assert_allclose(cov, SIGMA, rtol=1e-6)


def observed(innovation) -> Observation:
    zero = jnp.zeros(2)
    return Observation(jnp.asarray(innovation), jnp.asarray(NOISE), zero, jnp.zeros((3, 2)))


@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_the_limit_is_that_of_the_number_of_coordinates(d, seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, d, d))
    cov, noise = a @ a.T + np.eye(d), b @ b.T + np.eye(d)
    innovation = 30 * rng.normal(size=d)
    gated = kalman.gated(jnp.asarray(cov), jnp.asarray(innovation), jnp.asarray(noise), GATE)
    wide, noisy = map(np.asarray, gated)
    scale = max(1, distance(innovation, cov + noise) / chi2.ppf(GATE, d))
    np.testing.assert_allclose(wide, scale * cov, rtol=1e-3)
    np.testing.assert_allclose(noisy, scale * noise, rtol=1e-3)


def test_an_improbable_reading_widens_the_belief():
    belief = replace(initial_belief(jnp.zeros(2), 0.01, 3), cov=jnp.asarray(1e-2 * SIGMA))
    reading = observed([0.05, 0.0])
    plain, cautious = (update_position(belief, reading, replace(NONE, gate=gate)) for gate in (0.0, GATE))
    np.testing.assert_allclose(plain.pos_mean_world, cautious.pos_mean_world, rtol=1e-4)
    assert np.linalg.det(plain.pos_cov) < np.linalg.det(belief.pos_cov)
    assert np.linalg.det(cautious.pos_cov) > np.linalg.det(belief.pos_cov)
    scale = distance(np.array([0.05, 0.0]), 1e-2 * SIGMA + NOISE) / chi2.ppf(GATE, 2)
    np.testing.assert_allclose(cautious.pos_cov, scale * plain.pos_cov, rtol=1e-3)


def test_a_probable_reading_is_kalmans():
    belief = replace(initial_belief(jnp.zeros(2), 0.01, 3), cov=jnp.asarray(SIGMA))
    reading = observed([0.005, 0.002])
    plain, gated = (update_position(belief, reading, replace(NONE, gate=gate)) for gate in (0.0, GATE))
    np.testing.assert_allclose(plain.pos_cov, gated.pos_cov, rtol=1e-5)


def test_rows_of_a_batch_are_independent():
    innovations = jnp.array([[0.001, 0.0], [0.2, 0.0], [0.0, -0.1]])
    many = kalman.gated(jnp.asarray(SIGMA), innovations, jnp.asarray(NOISE), GATE)
    for i, one in enumerate(innovations):
        single = kalman.gated(jnp.asarray(SIGMA), one, jnp.asarray(NOISE), GATE)
        for a, b in zip(many, single, strict=True):
            np.testing.assert_allclose(a[i], b, rtol=1e-6)


def test_a_temperature_flattens_the_match_classification_in_the_estimator():
    """At a high one the trace says nothing about the type, and the failure alone is left."""
    felt = make_rollouts(3, actions=8).felt
    felt = replace(felt, trace=replace(felt.trace, tip_quat_world=DOWN))
    beliefs = initial_belief(jnp.asarray(felt.estimate_world), 0.01, 3)
    keys = jax.random.split(jax.random.key(0), 3)

    def types(temperature, *, learns=True):
        config = Config(sensor=SMALL, filter=replace(NONE, match_temperature=temperature))
        sensor = ContactSensor(SMALL, nnx.Rngs(0))
        update = filter_update(config, sensor, learns_position=False, learns_type=learns)
        return np.asarray(update(beliefs, felt, keys).type_logp)

    alone = types(1.0, learns=False)
    warm, hot = (np.abs(types(temperature) - alone).max() for temperature in (1.0, 100.0))
    assert hot < warm


def test_a_temperature_of_the_position_widens_r():
    """Against the information form: the inverse of Σ0⁻¹ + (T R)⁻¹."""
    cov, noise = np.diag([1e-4, 4e-5]), np.array([[3e-5, 1e-5], [1e-5, 2e-5]])
    prior = Belief(jnp.zeros(2), jnp.asarray(cov, jnp.float32), jnp.log(jnp.full(3, 1 / 3)))
    seen = Observation(
        jnp.array([0.002, -0.001]),
        jnp.asarray(noise, jnp.float32),
        jnp.zeros(2),
        jnp.log(jnp.full((3, 2), 0.5)),
    )
    for temperature in (1.0, 3.0):
        config = Config(filter=replace(NONE, position_temperature=temperature))
        after = posterior(prior, seen, jnp.int32(0), jnp.zeros((3, 3)), config)
        want = np.linalg.inv(np.linalg.inv(cov) + np.linalg.inv(temperature * noise))
        np.testing.assert_allclose(after.pos_cov, want, rtol=1e-4)
        mean = want @ np.linalg.inv(temperature * noise) @ np.array([0.002, -0.001])
        np.testing.assert_allclose(after.pos_mean_world, mean, rtol=1e-4)
