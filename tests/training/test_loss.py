"""The loss against its equation in NumPy, and its gradient against finite differences in float64."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mjx_fit.config.schema import Config
from mjx_fit.data.windows import Sample
from mjx_fit.training.loss import (
    every_action_loss,
    filter_loss,
    frame_by_frame_loss,
    sequence_loss,
    weighted_sum,
)
from mjx_fit.types import Belief, Observation, Reading

B = 8


def make_problem(seed: int = 0) -> tuple[Observation, Sample]:
    """Observations and samples of all kinds: matched or not, failed or not. Float64 where that is enabled."""
    rng = np.random.default_rng(seed)

    def spd(scale):
        a = rng.normal(size=(B, 2, 2))
        return jnp.asarray(scale * (a @ np.swapaxes(a, 1, 2) + 0.2 * np.eye(2)))

    observation = Observation(
        innovation=jnp.asarray(rng.normal(0, 0.01, (B, 2))),
        pos_noise_cov=spd(1e-4),
        match_logits=jnp.asarray(rng.normal(0, 2, (B, 2))),
        match_model_logp=jnp.log(jnp.asarray(rng.dirichlet([1, 1], (B, 3)))),
    )
    empty = jnp.zeros((B, 0))
    reading = Reading(*[empty] * 9, peg_type=jnp.arange(B) % 3)
    prior = Belief(
        mean_world=jnp.asarray(rng.uniform(-0.3, 0.3, (B, 2))),
        cov=spd(1e-4),
        type_logp=jnp.log(jnp.asarray(rng.dirichlet([1, 1, 1], B))),
    )
    sample = Sample(
        reading=reading,
        prior=prior,
        hole_type=jnp.where(jnp.arange(B) < 4, jnp.arange(B) % 3, (jnp.arange(B) + 1) % 3),
        place_world=prior.pos_mean_world + jnp.asarray(rng.normal(0, 0.01, (B, 2))),
        inserted=jnp.asarray(np.arange(B) % 4 == 3),
        judged=jnp.asarray(np.arange(B) % 4 != 3),
    )
    return observation, sample


def loss_by_hand(o: Observation, s: Sample, i: int) -> dict[str, float]:
    """The paper's equation for one window, with textbook filters in cm."""
    o, s = (jax.tree.map(lambda x: np.asarray(x[i], float), tree) for tree in (o, s))
    cov, noise = 1e4 * s.prior.pos_cov, 1e4 * o.pos_noise_cov
    gain = cov @ np.linalg.inv(cov + noise)
    cov1 = (np.eye(2) - gain) @ cov
    prior_error = 100 * (s.place_world - s.prior.pos_mean_world)
    error = prior_error - gain @ (100 * o.innovation)
    p_match = np.exp(o.match_logits) / np.exp(o.match_logits).sum()
    prior_type, hole, peg = np.exp(s.prior.type_logp), int(s.hole_type), int(s.reading.peg_type)
    xi = prior_type * (np.exp(o.match_model_logp) @ p_match)
    xi /= xi.sum()
    failed, matches = bool(s.judged), hole == peg
    terms = {
        "pos_logdet": 0.5 * np.log(np.linalg.det(cov1)),
        "pos_mahalanobis": 0.5 * error @ np.linalg.inv(cov1) @ error,
        "type_nll": -np.log(xi[hole]) if failed else 0.0,
        "match_nll": -np.log(p_match[1]) if failed and matches else 0.0,
        "mismatch_nll": -np.log(p_match[0]) if failed and not matches else 0.0,
    }
    prior_pos = 0.5 * np.log(np.linalg.det(cov)) + 0.5 * prior_error @ np.linalg.inv(cov) @ prior_error
    total = sum(terms.values())
    return terms | {
        "total": total,
        "nll": total - terms["match_nll"] - terms["mismatch_nll"],
        "prior_nll": prior_pos + (-np.log(prior_type[hole]) if failed else 0.0),
    }


def test_every_term_is_the_papers():
    observation, sample = make_problem()
    losses = jax.jit(filter_loss)(observation, sample)
    matches = np.asarray(sample.hole_type == sample.reading.peg_type)
    kinds = set(zip(matches.tolist(), np.asarray(sample.judged).tolist(), strict=True))
    assert len(kinds) == 4
    for i in range(B):
        for name, value in loss_by_hand(observation, sample, i).items():
            assert getattr(losses, name)[i] == pytest.approx(value, rel=1e-3, abs=1e-4), (i, name)


def test_a_window_with_the_insertion_trains_the_position_only():
    observation, sample = make_problem()
    sample = replace(sample, judged=jnp.zeros(B, bool))
    grad = jax.jit(jax.grad(lambda o: filter_loss(o, sample).total.sum()))(observation)
    assert not np.asarray(grad.match_logits).any()
    assert not np.asarray(grad.match_model_logp).any()
    assert np.abs(grad.innovation).min() > 0
    assert np.abs(grad.pos_noise_cov).max(axis=(1, 2)).min() > 0


def test_weights_leave_windows_out():
    observation, sample = make_problem()
    losses = jax.jit(filter_loss)(observation, sample)
    sums = weighted_sum(losses, (jnp.arange(B) < 3).astype(float))
    for name, term in vars(losses).items():
        assert getattr(sums, name) == pytest.approx(float(term[:3].sum()), rel=1e-5)


def test_gradient_is_that_of_finite_differences():
    with jax.enable_x64(True):
        observation, sample = make_problem()
        assert observation.innovation.dtype == jnp.float64
        leaves, structure = jax.tree.flatten(observation)

        @jax.jit
        def total(leaves):
            return filter_loss(jax.tree.unflatten(structure, leaves), sample).total.sum()

        grads = jax.jit(jax.grad(total))(leaves)
        rng = np.random.default_rng(3)
        for which, (leaf, grad) in enumerate(zip(leaves, grads, strict=True)):
            scale = float(jnp.abs(leaf).mean())
            for _ in range(4):
                direction = rng.normal(size=leaf.shape)
                step = 1e-5 * scale * direction
                up, down = (
                    total([x + sign * step if i == which else x for i, x in enumerate(leaves)])
                    for sign in (1, -1)
                )
                want = float((up - down) / (2e-5 * scale))
                got = float(jnp.sum(grad * direction))
                assert got == pytest.approx(want, rel=1e-5, abs=1e-7 * float(jnp.abs(grad).sum()))


def test_a_chain_is_one_big_gaussian_and_one_product_of_likelihoods():
    """Three attempts at each of B holes, updated one after the other, against all of them at once."""
    problems = [make_problem(seed) for seed in range(3)]
    observation, sample = jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=1), *problems)
    hole = sample.prior.pos_mean_world[:, :1] + jnp.array([0.004, -0.003])
    starts = hole + jnp.asarray(np.random.default_rng(5).normal(0, 0.004, (B, 3, 2)), jnp.float32)
    starts = starts.at[:, 0].set(sample.prior.pos_mean_world[:, 0])
    # The last attempt at every other hole ends with the peg in it, as when it enters holes of other types.
    inserted = jnp.zeros((B, 3), bool).at[::2, 2].set(True)
    alpha = ((0.3, 0.1, 0.0), (0.0, 0.3, 0.2), (0.1, 0.2, 0.3))
    config = replace(Config(), task=replace(Config().task, success_by_error=None, success_probability=alpha))
    sample = replace(
        sample,
        place_world=jnp.broadcast_to(hole, (B, 3, 2)),
        hole_type=jnp.broadcast_to(sample.hole_type[:, :1], (B, 3)),
        prior=replace(sample.prior, mean_world=starts),
        inserted=inserted,
        judged=jnp.ones((B, 3), bool),
    )
    losses = jax.jit(partial(sequence_loss, config=config))(observation, sample)
    for i in range(B):
        o, s = (jax.tree.map(lambda x, i=i: np.asarray(x[i], float), tree) for tree in (observation, sample))
        information = np.linalg.inv(s.prior.pos_cov[0] * 1e4)
        vector = information @ s.prior.pos_mean_world[0] * 100
        xi = np.exp(s.prior.type_logp[0])
        for k in range(3):
            precision = np.linalg.inv(o.pos_noise_cov[k] * 1e4)
            information = information + precision
            vector = vector + precision @ (s.prior.pos_mean_world[k] + o.innovation[k]) * 100
            cov = np.linalg.inv(information)
            error = s.place_world[k] * 100 - cov @ vector
            p = np.exp(o.match_logits[k]) / np.exp(o.match_logits[k]).sum()
            xi = xi * (np.exp(o.match_model_logp[k]) @ p)
            enters = np.array(alpha[int(s.reading.peg_type[k])])
            xi = xi * (np.maximum(enters, 1e-9) if s.inserted[k] else 1 - enters)
            xi = xi / xi.sum()
            assert losses.pos_logdet[i, k] == pytest.approx(0.5 * np.log(np.linalg.det(cov)), abs=1e-3)
            mahalanobis = 0.5 * error @ information @ error
            assert losses.pos_mahalanobis[i, k] == pytest.approx(mahalanobis, rel=2e-3, abs=1e-3)
            assert losses.type_nll[i, k] == pytest.approx(-np.log(xi[int(s.hole_type[k])]), abs=1e-4)


def test_a_chain_of_one_is_a_window_alone():
    observation, sample = make_problem()
    one_long = [jax.tree.map(lambda leaf: leaf[:, None], tree) for tree in (observation, sample)]
    chained = sequence_loss(one_long[0], one_long[1], Config())
    alone = filter_loss(observation, sample)
    for name in ("pos_logdet", "pos_mahalanobis", "match_nll", "mismatch_nll"):
        np.testing.assert_allclose(getattr(alone, name), getattr(chained, name)[:, 0], rtol=1e-4, atol=1e-5)


def test_the_baselines_loss_takes_the_observed_position_for_the_belief():
    observation, sample = make_problem()
    losses = jax.jit(frame_by_frame_loss)(observation, sample)
    for i in range(B):
        o, s = (jax.tree.map(lambda x, i=i: np.asarray(x[i], float), tree) for tree in (observation, sample))
        error, cov = 100 * (s.place_world - s.prior.pos_mean_world - o.innovation), 1e4 * o.pos_noise_cov
        logdet, mahalanobis = 0.5 * np.log(np.linalg.det(cov)), 0.5 * error @ np.linalg.inv(cov) @ error
        assert losses.pos_logdet[i] == pytest.approx(logdet, rel=1e-3, abs=1e-4)
        assert losses.pos_mahalanobis[i] == pytest.approx(mahalanobis, rel=1e-3, abs=1e-4)
        assert losses.total[i] == losses.nll[i] == pytest.approx(logdet + mahalanobis, rel=1e-3, abs=1e-4)
    for name in ("type_nll", "match_nll", "mismatch_nll"):
        assert not np.asarray(getattr(losses, name)).any()


def test_the_loss_after_every_action_is_the_mean_over_prefixes():
    """Each prefix as a window of its own; the insertion belongs to the last action alone."""
    rows, count = 5, 1 + np.arange(B) % 5
    mask = np.arange(rows) < count[:, None]
    _, sample = make_problem(1)
    sample = replace(sample, reading=replace(sample.reading, mask=jnp.asarray(mask)))
    each = [make_problem(10 + j)[0] for j in range(rows)]
    observation = jax.tree.map(lambda *leaves: jnp.stack(leaves, 1), *each)
    got = every_action_loss(observation, sample)
    for i in range(B):
        parts = []
        for j in range(count[i]):
            inserted = bool(sample.inserted[i]) and j == count[i] - 1
            judged = bool(sample.judged[i]) or not inserted
            one = replace(sample, inserted=jnp.full(B, inserted), judged=jnp.full(B, judged))
            parts.append(loss_by_hand(each[j], one, i))
        for name in (
            "total",
            "pos_logdet",
            "pos_mahalanobis",
            "type_nll",
            "match_nll",
            "mismatch_nll",
            "nll",
        ):
            want = np.mean([part[name] for part in parts])
            assert float(getattr(got, name)[i]) == pytest.approx(want, rel=1e-4, abs=1e-6), name


def test_padding_that_is_far_off_does_not_count_after_every_action():
    """Its loss overflows; the gradient stays finite."""
    _, sample = make_problem(1)
    mask = jnp.ones((B, 3), bool)
    sample = replace(sample, reading=replace(sample.reading, mask=mask))
    each = [make_problem(10 + j)[0] for j in range(3)]

    def total(off, rows=2):
        last = replace(each[2], innovation=each[2].innovation + off)
        seen = jax.tree.map(lambda *leaves: jnp.stack(leaves, 1), each[0], each[1], last)
        mask = jnp.broadcast_to(jnp.arange(3) < rows, sample.reading.mask.shape)
        masked = replace(sample, reading=replace(sample.reading, mask=mask))
        return every_action_loss(seen, masked).total.sum()

    far = 1e25
    assert not np.isfinite(float(total(far, rows=3)))
    assert float(total(0.0)) == float(total(far))
    assert float(jax.grad(total)(far)) == 0
