"""Correlated readings, against a dense Gaussian."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.filters import kalman
from mjx_fit.filters.updates import NONE, initial_belief, update_position
from mjx_fit.types import Observation

STD_M = 0.01
NOISE = 1e-6 * np.array([[4.0, 1.0], [1.0, 2.0]])


def reading(innovation=(0.0, 0.0), noise=NOISE) -> Observation:
    return Observation(jnp.asarray(innovation), jnp.asarray(noise), jnp.zeros(2), jnp.zeros((3, 2)))


def dense(count: int, correlation: float) -> np.ndarray:
    """The posterior of a place read this many times, with this correlation of the errors, as one Gaussian."""
    between = (1 - correlation) * np.eye(count) + correlation
    stacked = np.kron(np.ones((count, 1)), np.eye(2))
    precision = stacked.T @ np.linalg.solve(np.kron(between, NOISE), stacked)
    return np.linalg.inv(precision + np.eye(2) / STD_M**2)


@given(st.floats(0.001, 0.9))
def test_the_covariance_is_that_of_correlated_readings(correlation):
    belief = initial_belief(jnp.zeros(2), STD_M, 3)
    for count in range(1, 8):
        belief = update_position(belief, reading(), replace(NONE, correlation=correlation), STD_M)
        np.testing.assert_allclose(belief.pos_cov, dense(count, correlation), rtol=2e-3)


def test_the_first_reading_counts_in_full_and_later_ones_less_and_less():
    belief, shares = initial_belief(jnp.zeros(2), STD_M, 3), []
    for _ in range(4):
        widened = kalman.correlated(belief.pos_cov, jnp.asarray(NOISE), STD_M, 0.4)
        shares.append(float(NOISE[0, 0] / widened[0, 0]))
        belief = update_position(belief, reading(), replace(NONE, correlation=0.4), STD_M)
    assert shares[0] > 0.999
    assert np.all(np.diff(shares) < 0)


def test_without_correlation_nothing_changes():
    belief = initial_belief(jnp.zeros(2), STD_M, 3)
    plain = update_position(belief, reading((0.01, 0.0)))
    same = update_position(belief, reading((0.01, 0.0)), NONE, STD_M)
    np.testing.assert_array_equal(plain.pos_cov, same.pos_cov)


def test_a_belief_that_knows_more_than_correlated_readings_can_tell_stays_finite():
    sure = replace(initial_belief(jnp.zeros(2), STD_M, 3), cov=1e-9 * jnp.eye(2))
    after = update_position(sure, reading((0.001, 0.0)), replace(NONE, correlation=0.5), STD_M)
    assert np.isfinite(after.pos_cov).all()
    np.testing.assert_allclose(after.pos_cov, sure.pos_cov, rtol=1e-2, atol=1e-15)


def test_rows_of_a_batch_are_independent():
    covs = jnp.stack([1e-4 * jnp.eye(2), 1e-6 * jnp.eye(2)])
    many = kalman.correlated(covs, jnp.asarray(NOISE), STD_M, 0.3)
    for i in range(2):
        np.testing.assert_allclose(
            many[i], kalman.correlated(covs[i], jnp.asarray(NOISE), STD_M, 0.3), rtol=1e-6
        )
