"""The histogram filter against enumeration of the hypotheses in NumPy."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjx_fit.filters import histogram
from mjx_fit.filters.updates import initial_belief, update_position, update_type
from mjx_fit.types import Belief, Observation

SEEDS = st.integers(0, 2**32 - 1)


def draw(seed: int, n_types: int = 3):
    """A prior ξ, the sensor's p(o), a model H (C, 2), and α (C, C), all as probabilities in float64."""
    rng = np.random.default_rng(seed)
    prior = rng.dirichlet(np.ones(n_types))
    sensed, model = rng.dirichlet([1, 1]), rng.dirichlet([1, 1], n_types)
    return prior, sensed, model, rng.uniform(0, 0.95, (n_types, n_types))


def enumerate_posterior(prior, sensed, model, alpha, *, peg, hard):
    """Σ over every (type, o_match) of the joint probability with the failure, then normalised."""
    joint = np.zeros(len(prior))
    for c, o in itertools.product(range(len(prior)), range(2)):
        weight = float(o == int(np.argmax(sensed))) if hard else sensed[o]
        joint[c] += prior[c] * weight * model[c, o] * (1 - alpha[peg, c])
    return joint / joint.sum()


def as_inputs(prior, sensed, model) -> tuple[Belief, Observation]:
    belief = Belief(jnp.zeros(2), jnp.eye(2), jnp.log(jnp.asarray(prior, jnp.float32)))
    observation = Observation(
        innovation=jnp.zeros(2),
        pos_noise_cov=jnp.eye(2),
        # Logits are free up to a constant: the filter has to normalise them itself.
        match_logits=jnp.log(jnp.asarray(sensed, jnp.float32)) + 3.0,
        match_model_logp=jnp.log(jnp.asarray(model, jnp.float32)),
    )
    return belief, observation


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, n_types=st.sampled_from([1, 3, 12]), peg=st.integers(0, 11), hard=st.booleans())
def test_update_is_bayes_by_enumeration(seed, n_types, peg, hard):
    prior, sensed, model, alpha = draw(seed, n_types)
    peg %= n_types
    belief, observation = as_inputs(prior, sensed, model)
    got = update_type(belief, observation, jnp.asarray(peg), jnp.asarray(alpha, jnp.float32), hard=hard)
    want = enumerate_posterior(prior, sensed, model, alpha, peg=peg, hard=hard)
    np.testing.assert_allclose(np.exp(got.type_logp), want, atol=1e-5)
    assert np.exp(got.type_logp).sum() == pytest.approx(1, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(seeds=st.lists(SEEDS, min_size=3, max_size=3, unique=True), order=st.permutations(range(3)))
def test_attempts_in_any_order_agree(seeds, order):
    belief, _ = as_inputs(*draw(seeds[0])[:3])
    attempts = [(as_inputs(*draw(seed)[:3])[1], draw(seed)[3], k) for k, seed in enumerate(seeds)]

    def after(attempts):
        one = belief
        for observation, alpha, peg in attempts:
            one = update_type(one, observation, jnp.asarray(peg), jnp.asarray(alpha, jnp.float32), hard=False)
        return one.type_logp

    np.testing.assert_allclose(after(attempts), after([attempts[k] for k in order]), atol=1e-4)


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, peg=st.integers(0, 4), hard=st.booleans(), order=st.permutations(range(5)))
def test_renaming_the_types_renames_the_posterior(seed, peg, hard, order):
    prior, sensed, model, alpha = draw(seed, n_types=5)
    order = np.array(order)

    def posterior(prior, model, alpha, peg):
        belief, observation = as_inputs(prior, sensed, model)
        success = jnp.asarray(alpha, jnp.float32)
        return np.exp(update_type(belief, observation, jnp.asarray(peg), success, hard=hard).type_logp)

    renamed = posterior(prior[order], model[order], alpha[order][:, order], int(np.argmax(order == peg)))
    np.testing.assert_allclose(renamed, posterior(prior, model, alpha, peg)[order], atol=1e-6)


def test_hard_takes_the_column_of_the_likelier_observation():
    model_logp = jnp.log(jnp.array([[0.9, 0.1], [0.3, 0.7], [0.5, 0.5]]))
    hard = histogram.match_logp(jnp.array([0.2, 0.1]), model_logp, hard=True)
    np.testing.assert_allclose(np.exp(hard), [0.9, 0.3, 0.5], rtol=1e-6)
    soft = histogram.match_logp(jnp.array([0.0, 0.0]), model_logp, hard=False)
    np.testing.assert_allclose(np.exp(soft), [0.5, 0.5, 0.5], rtol=1e-6)


def test_a_certain_sensor_makes_soft_and_hard_agree():
    _, _, model, _ = draw(7)
    model_logp = jnp.log(jnp.asarray(model))
    logits = jnp.array([-40.0, 40.0])
    soft, hard = (histogram.match_logp(logits, model_logp, hard=hard) for hard in (False, True))
    np.testing.assert_allclose(soft, hard, rtol=1e-5)


def test_without_observation_only_the_failure_counts():
    belief = initial_belief(jnp.zeros((4, 2)), 0.01, 3)
    success = jnp.array([[0.34, 0.1, 0.0], [0.0, 0.2, 0.5], [0.0, 0.0, 0.6]])
    got = update_type(belief, None, jnp.array([0, 1, 2, 2]), success, hard=True)
    for row, peg in zip(np.exp(got.type_logp), [0, 1, 2, 2], strict=True):
        want = 1 - success[peg]
        np.testing.assert_allclose(row, want / want.sum(), rtol=1e-5)
    np.testing.assert_array_equal(got.pos_mean_world, belief.pos_mean_world)


def test_failures_never_rule_a_type_out_and_stay_finite():
    def step(belief, _):
        return update_type(belief, None, jnp.asarray(0), 0.9 * jnp.eye(3), hard=True), None

    belief, _ = jax.lax.scan(step, initial_belief(jnp.zeros(2), 0.01, 3), None, length=1000)
    assert np.isfinite(belief.type_logp).all()
    np.testing.assert_allclose(np.exp(belief.type_logp), [0, 0.5, 0.5], atol=1e-4)


def test_initial_belief_and_position_update_on_a_batch():
    belief = initial_belief(jnp.full((2, 3, 2), 0.4), 0.01, 3)
    assert belief.pos_cov.shape == (2, 3, 2, 2)
    np.testing.assert_allclose(belief.pos_cov[1, 2], 1e-4 * np.eye(2), rtol=1e-6)
    np.testing.assert_allclose(np.exp(belief.type_logp).sum(-1), 1, rtol=1e-6)
    shape = (2, 3)
    observation = Observation(
        innovation=jnp.full((*shape, 2), 0.01),
        pos_noise_cov=jnp.broadcast_to(1e-4 * jnp.eye(2), (*shape, 2, 2)),
        match_logits=jnp.zeros((*shape, 2)),
        match_model_logp=jnp.log(jnp.full((*shape, 3, 2), 0.5)),
    )
    updated = update_position(belief, observation)
    np.testing.assert_allclose(updated.pos_mean_world, 0.405, rtol=1e-5)
    np.testing.assert_allclose(updated.pos_cov[0, 0], 0.5e-4 * np.eye(2), rtol=1e-4, atol=1e-11)
    np.testing.assert_array_equal(updated.type_logp, belief.type_logp)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, peg=st.integers(0, 2))
def test_a_diagonal_matrix_gives_the_papers_likelihood_bit_by_bit(seed, peg):
    alpha = np.random.default_rng(seed).uniform(0, 0.95, 3).astype(np.float32)
    got = histogram.failure_logp(jnp.asarray(peg), jnp.diag(jnp.asarray(alpha)))
    want = jnp.log1p(-jnp.asarray(alpha) * jax.nn.one_hot(peg, 3))
    assert np.asarray(got).tobytes() == np.asarray(want).tobytes()
