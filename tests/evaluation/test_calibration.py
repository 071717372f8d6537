"""Scores against scikit-learn's definitions, enumeration and simulation."""

import dataclasses
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal
from synthetic import PAPER_SENSOR, make_episodes, with_truth, with_unit_quaternions

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.learning import SensorConfig
from mjx_fit.evaluation import held_out, scores
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.types import Observation
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.randomness import root_key


@given(
    given_scores=st.lists(st.integers(0, 5), min_size=2, max_size=12),
    seed=st.integers(0, 1000),
)
def test_auroc_is_the_share_of_pairs_in_the_right_order(given_scores, seed):
    score = np.array(given_scores, float)
    positive = np.random.default_rng(seed).uniform(size=len(score)) < 0.5
    pairs = [(a > b) + 0.5 * (a == b) for a in score[positive] for b in score[~positive]]
    got = scores.auroc(score, positive)
    assert np.isnan(got) if not pairs else got == pytest.approx(np.mean(pairs))


def test_an_honest_covariance_has_its_coverage_and_a_nees_of_one():
    rng = np.random.default_rng(0)
    cov = np.array([[4.0, 1.5], [1.5, 1.0]]) * 1e-6
    error = rng.multivariate_normal([0, 0], cov, 20_000)
    squared = scores.squared_mahalanobis(error, np.broadcast_to(cov, (len(error), 2, 2)))
    assert squared.mean() / 2 == pytest.approx(1, abs=0.02)
    for level in (0.5, 0.9):
        assert scores.inside(squared, level).mean() == pytest.approx(level, abs=0.01)
    sure = scores.squared_mahalanobis(error, np.broadcast_to(cov / 4, (len(error), 2, 2)))
    assert scores.inside(sure, 0.9).mean() < 0.5
    density = multivariate_normal(cov=cov.tolist()).logpdf(error[:50])
    constant = -np.log(2 * np.pi) - 0.5 * np.log(np.linalg.det(cov))
    np.testing.assert_allclose(constant - 0.5 * squared[:50], density, rtol=1e-6)


def test_thresholds_are_the_ones_of_two_degrees_of_freedom():
    for level, threshold in ((0.5, 1.386), (0.9, 4.605)):
        around = threshold + np.array([-1e-3, 1e-3])
        assert scores.inside(around, level).tolist() == [True, False]


def test_reliability_of_honest_and_of_boasting_probabilities():
    rng = np.random.default_rng(1)
    probability = rng.uniform(size=50_000)
    happened = rng.uniform(size=50_000) < probability
    mean, frequency, n = scores.reliability(probability, happened)
    assert n.sum() == 50_000
    np.testing.assert_allclose(frequency, mean, atol=0.02)
    boast = np.clip(1.6 * (probability - 0.5) + 0.5, 0, 1)
    mean, frequency, _ = scores.reliability(boast, happened)
    assert mean[-1] - frequency[-1] > 0.05
    mean, _, n = scores.reliability(np.array([0.0, 1.0, 1.0]), np.array([False, True, False]))
    assert (mean.tolist(), n.tolist()) == ([0, 1], [1, 2])


def test_brier_and_balanced_accuracy_of_small_cases():
    probability = np.array([[1.0, 0, 0], [0, 1.0, 0], [1 / 3, 1 / 3, 1 / 3]])
    np.testing.assert_allclose(scores.brier(probability, np.array([0, 0, 2])), [0, 2, 2 / 3])
    positive = np.array([True, True, False, False, False, False])
    predicted = np.array([True, False, False, False, False, True])
    assert scores.balanced_accuracy(predicted, positive) == pytest.approx((0.5 + 0.75) / 2)
    assert np.isnan(scores.balanced_accuracy(predicted, np.ones(6, bool)))


@pytest.mark.parametrize("actions", [5, pytest.param(16, marks=pytest.mark.slow)])
def test_an_observation_is_of_the_first_actions_with_the_noise_of_the_episode(actions):
    """Against readings that are cut, one by one: other actions, and other episodes, make no difference."""
    data, config = make_episodes(20, actions=16, min_length=16), Config()
    data = dataclasses.replace(data, rollout=with_unit_quaternions(data.rollout))
    sensor = ContactSensor(
        SensorConfig(width=8, layers=1, feedforward=8, conv_channels=(4, 4, 4, 4, 4), **PAPER_SENSOR),
        nnx.Rngs(0),
    )
    say = nnx.jit(lambda sensor, reading: sensor(reading))
    ids, root = np.array([7, 3, 12]), root_key(5, "held out")

    def alone(i, actions):
        one = jax.tree.map(lambda leaf: leaf[i], data)
        key = jax.random.fold_in(root, one.episode)
        return say(sensor, read_window(one.rollout.felt, key, config, Window(actions))).innovation

    seen = held_out.observe(sensor, data, ids, actions, config, seed=5)
    want = np.array([alone(i, actions) for i in ids])
    assert np.ptp(want, axis=0).min() > 1e-5
    np.testing.assert_allclose(seen.innovation, want, atol=1e-7)


def test_type_probabilities_are_products_over_the_attempts_of_a_sequence_so_far():
    """Against a loop, episodes in no order."""
    rng = np.random.default_rng(0)
    data = make_episodes(30, actions=2, min_length=1, sequence=3)
    ids = rng.permutation(30)[:20]
    logp = np.log(rng.dirichlet([1, 1, 1], 20)).astype(np.float32)
    got = np.asarray(held_out._over_sequences(jnp.asarray(logp), data, ids))
    sequence, number = np.asarray(data.sequence)[ids], np.asarray(data.number)[ids]
    for k in range(20):
        product = np.ones(3)
        for j in range(20):
            if sequence[j] == sequence[k] and number[j] <= number[k]:
                product = product * np.exp(logp[j])
        np.testing.assert_allclose(np.exp(got[k]), product / product.sum(), rtol=1e-4)


def test_what_a_posterior_comes_to_by_hand():
    """One row at a time: the filter's update and the baseline's, their errors, probabilities and scores."""
    n, config = 4, Config()
    data = make_episodes(n, actions=6, min_length=6)
    rng = np.random.default_rng(2)
    factor = np.tril(rng.uniform(0.001, 0.004, (n, 2, 2)))
    observation = Observation(
        innovation=rng.normal(0, 0.01, (n, 2)).astype(np.float32),
        pos_noise_cov=(factor @ factor.swapaxes(1, 2)).astype(np.float32),
        match_logits=rng.normal(0, 2, (n, 2)).astype(np.float32),
        match_model_logp=np.log(rng.dirichlet([1, 1], (n, 3))).astype(np.float32),
    )
    ids, names = rng.permutation(n), config.scene.names
    held = jax.tree.map(np.asarray, data.rollout)
    for with_prior in (True, False):
        after = held_out.posterior(observation, data, ids, config, with_prior=with_prior)
        for k, row in enumerate(held_out.rows("full", 6, after, data, ids, config)):
            i, noise = ids[k], observation.pos_noise_cov[k].astype(float)
            truth, estimate = (
                held.truth.hole_pos_world[i].astype(float),
                held.felt.estimate_world[i].astype(float),
            )
            cov = np.asarray(data.estimate_cov[i], float)
            gain = cov @ np.linalg.inv(cov + noise) if with_prior else np.eye(2)
            error = truth - estimate - gain @ observation.innovation[k]
            cov = (np.eye(2) - gain) @ cov if with_prior else noise
            squared = error @ np.linalg.inv(cov) @ error
            odds = np.exp(observation.match_logits[k])
            assert row["prior_error_cm"] == pytest.approx(100 * np.linalg.norm(truth - estimate), rel=1e-4)
            assert row["error_cm"] == pytest.approx(100 * np.linalg.norm(error), rel=1e-2, abs=1e-4)
            assert row["squared_mahalanobis"] == pytest.approx(squared, rel=1e-2, abs=1e-3)
            nll = 0.5 * np.log(np.linalg.det(1e4 * cov)) + squared / 2
            assert row["nll"] == pytest.approx(nll, rel=1e-2, abs=1e-2)
            assert row["match_probability"] == pytest.approx(odds[1] / odds.sum(), rel=1e-3)
            assert row["pair"] == [names[held.felt.peg_type[i]], names[held.truth.hole_type[i]]]
            assert (row["trial"], row["attempt"], row["actions"]) == (i, 1, 6)


def test_only_whole_attempts_that_failed_are_looked_at():
    data = make_episodes(12, actions=6, min_length=4)
    inserted, valid = np.arange(12) % 3 == 0, np.arange(12) != 7
    data = replace(data, rollout=with_truth(data.rollout, inserted=inserted, valid=valid))
    want = [i for i in range(12) if data.rollout.felt.length[i] >= 5 and i % 3 and i != 7]
    assert 0 < len(want) < 7
    assert held_out.failed_attempts(data, 5).tolist() == want
    with pytest.raises(RequestError, match="no failed attempt of 7 actions"):
        held_out.failed_attempts(data, 7)
