"""The Kalman filter against the joint Gaussian, conditioned by hand in float64, in up to six dimensions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjx_fit.filters import kalman


def spd(rng: np.random.Generator, scale: float, *batch: int, d: int = 2) -> np.ndarray:
    """Random symmetric positive definite matrices with a condition number of up to about 100."""
    a = rng.normal(size=(*batch, d, d))
    return scale * (a @ np.swapaxes(a, -1, -2) + 0.05 * np.eye(d))


def condition_joint(mean, cov, observation, noise_cov):
    """N(x | o) from the joint Gaussian of (x, o = x + noise), through its dense precision matrix."""
    joint = np.block([[cov, cov], [cov, cov + noise_cov]])
    precision = np.linalg.inv(joint)
    d = len(mean)
    posterior_cov = np.linalg.inv(precision[:d, :d])
    return mean - posterior_cov @ precision[:d, d:] @ (observation - mean), posterior_cov


def f32(*arrays):
    return [jnp.asarray(a, jnp.float32) for a in arrays]


@settings(max_examples=60, deadline=None)
@given(
    d=st.integers(1, 6),
    seed=st.integers(0, 2**32 - 1),
    log_prior=st.floats(-7, -3),
    log_noise=st.floats(-7, -3),
)
def test_update_is_the_conditional_of_the_joint_gaussian(d, seed, log_prior, log_noise):
    rng = np.random.default_rng(seed)
    cov, noise_cov = spd(rng, 10**log_prior, d=d), spd(rng, 10**log_noise, d=d)
    mean, observation = rng.uniform(-1, 1, d), rng.uniform(-1, 1, d)
    got_mean, got_cov = kalman.update(*f32(mean, cov, observation - mean, noise_cov))
    want_mean, want_cov = condition_joint(mean, cov, observation, noise_cov)
    np.testing.assert_allclose(got_mean, want_mean, atol=1e-4)
    np.testing.assert_allclose(got_cov, want_cov, atol=3e-4 * np.abs(want_cov).max())


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), log_noise=st.floats(-8, -2))
def test_update_never_adds_uncertainty_and_stays_between_prior_and_observation(seed, log_noise):
    rng = np.random.default_rng(seed)
    cov, noise_cov, innovation = spd(rng, 1e-4), spd(rng, 10**log_noise), rng.normal(0, 0.01, 2)
    mean, new_cov = kalman.update(*f32(np.zeros(2), cov, innovation, noise_cov))
    gap = cov - np.asarray(new_cov, float)
    assert np.linalg.eigvalsh(gap).min() > -1e-5 * np.abs(cov).max()
    # Along the step the posterior mean lies between prior and observation in the prior's metric.
    metric = np.linalg.inv(cov + noise_cov)
    assert 0 <= innovation @ metric @ np.asarray(mean, float) <= innovation @ metric @ innovation * (1 + 1e-3)
    np.testing.assert_array_equal(new_cov, np.swapaxes(new_cov, -1, -2))


def test_two_updates_in_either_order_agree():
    rng = np.random.default_rng(0)
    mean, cov = f32(np.zeros(2), spd(rng, 1e-4))
    observations = f32(rng.normal(0, 0.01, (2, 2)))[0]
    noises = f32(spd(rng, 1e-4, 2))[0]
    results = []
    for order in ([0, 1], [1, 0]):
        m, c = mean, cov
        for i in order:
            m, c = kalman.update(m, c, observations[i] - m, noises[i])
        results.append((m, c))
    np.testing.assert_allclose(results[0][0], results[1][0], atol=1e-7)
    np.testing.assert_allclose(results[0][1], results[1][1], rtol=1e-4)


def test_without_noise_the_observation_is_believed():
    mean, cov = kalman.update(*f32([0.1, 0.2], 1e-4 * np.eye(2), [0.01, -0.02], np.zeros((2, 2))))
    np.testing.assert_allclose(mean, [0.11, 0.18], atol=1e-7)
    np.testing.assert_allclose(cov, 0, atol=1e-11)


def test_with_endless_noise_nothing_changes():
    before = f32([0.1, 0.2], 1e-4 * np.array([[2, 0.5], [0.5, 1]]))
    mean, cov = kalman.update(*before, *f32([0.01, -0.02], 1e25 * np.eye(2)))
    np.testing.assert_allclose(mean, before[0], rtol=1e-6)
    np.testing.assert_allclose(cov, before[1], rtol=1e-6)


def test_covariance_stays_positive_definite_over_1000_float32_updates():
    rng = np.random.default_rng(1)
    noises, innovations = f32(spd(rng, 1e-5, 1000, 16), rng.normal(0, 0.01, (1000, 16, 2)))

    def step(belief, seen):
        belief = kalman.update(*belief, *seen)
        return belief, belief

    start = (jnp.zeros((16, 2)), jnp.tile(1e-4 * jnp.eye(2), (16, 1, 1)))
    _, (means, covs) = jax.lax.scan(step, start, (innovations, noises))
    covs = np.asarray(covs, float)
    assert np.isfinite(means).all()
    assert np.linalg.eigvalsh(covs).min() > 0
    np.testing.assert_array_equal(covs, np.swapaxes(covs, -1, -2))
    # Precisions add up: the last covariance is known without filtering.
    precision = np.linalg.inv(start[1].astype(float)) + np.linalg.inv(np.asarray(noises, float)).sum(0)
    np.testing.assert_allclose(covs[-1], np.linalg.inv(precision), rtol=1e-2, atol=1e-10)


def test_one_bad_member_does_not_poison_the_batch():
    cov = jnp.stack([1e-4 * jnp.eye(2), -jnp.eye(2), 2e-4 * jnp.eye(2)])
    mean, new_cov = kalman.update(jnp.zeros((3, 2)), cov, jnp.ones((3, 2)) * 0.01, 1e-5 * jnp.eye(2))
    assert np.isnan(mean[1]).all()
    assert np.isfinite(mean[jnp.array([0, 2])]).all()
    alone = kalman.update(jnp.zeros(2), cov[2], jnp.ones(2) * 0.01, 1e-5 * jnp.eye(2))
    np.testing.assert_allclose(mean[2], alone[0], rtol=1e-6)
    np.testing.assert_allclose(new_cov[2], alone[1], rtol=1e-6)


def test_likelihood_is_the_density_per_square_centimetre():
    from scipy.stats import multivariate_normal

    rng = np.random.default_rng(2)
    target, mean, cov = rng.normal(0, 0.01, 2), rng.normal(0, 0.01, 2), spd(rng, 1e-4)
    logdet, mahalanobis = kalman.gaussian_nll_terms(*f32(target, mean, cov))
    nll = -multivariate_normal.logpdf(100 * target, 100 * mean, (1e4 * cov).tolist()) - np.log(2 * np.pi)
    assert logdet + mahalanobis == pytest.approx(nll, rel=1e-4)
    assert kalman.gaussian_nll(*f32(target, mean, cov)) == pytest.approx(nll, rel=1e-4)
    assert logdet == pytest.approx(0.5 * np.log(np.linalg.det(1e4 * cov)), rel=1e-4, abs=1e-5)


@given(d=st.integers(1, 6), seed=st.integers(0, 2**32 - 1), log_scale=st.floats(-9, 0))
def test_scale_tril_is_lapacks_cholesky_factor(d, seed, log_scale):
    cov = spd(np.random.default_rng(seed), 10**log_scale, 4, d=d)
    with jax.enable_x64(True):
        got = kalman.scale_tril(jnp.asarray(cov))
    np.testing.assert_allclose(got, np.linalg.cholesky(cov), rtol=1e-9, atol=1e-12 * cov.max())
