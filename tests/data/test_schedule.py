"""Schedule of the episodes of a data set."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import draw_attempts, draw_later_attempts, pair_of, policy_of
from mjx_fit.utils.randomness import root_key

CONFIG = Config()


def test_pairs_are_balanced_and_half_matched():
    peg, hole = pair_of(np.arange(36), 3)
    assert (peg == hole).mean() == 0.5
    counts = {(p, h): int(((peg == p) & (hole == h)).sum()) for p in range(3) for h in range(3)}
    assert {counts[p, p] for p in range(3)} == {6}
    assert {counts[p, h] for p in range(3) for h in range(3) if p != h} == {3}


@pytest.mark.parametrize("number", [0, 1])
def test_mixed_policies_are_balanced_in_every_pair(number):
    ids = np.arange(48)
    policy = policy_of("mixed", ids, number, 3)
    pair = np.stack(pair_of(ids, 3))
    for one in np.unique(pair, axis=1).T:
        own = policy[(pair == one[:, None]).all(0)]
        assert (own == 0).sum() == (own == 1).sum()
    assert (policy_of("mixed", ids, 1, 3) != policy_of("mixed", ids, 0, 3)).all()
    assert set(policy_of("random", ids, number, 3)) == {1}


def test_draws_depend_on_the_sequence_alone():
    def both(ids):
        root, ids = jax.random.key(3), jnp.asarray(ids)
        later = draw_later_attempts(root, ids, "mixed", 2, CONFIG)
        return draw_attempts(root, ids, "mixed", CONFIG), later

    picked = jax.tree.map(lambda leaf: leaf[np.array([11, 4])], both(np.arange(20)))
    for a, b in zip(jax.tree.leaves(both([11, 4])), jax.tree.leaves(picked), strict=True):
        assert (a == b).all()


def test_draws_tell_nothing_of_each_other():
    """The policy of an episode must not show where its hole is: a key used twice would be a leak."""
    n = 4000
    root, ids = root_key(0, "collect"), jnp.arange(n)
    drawn = draw_attempts(root, ids, "mixed", CONFIG)
    later = [draw_later_attempts(root, ids, "mixed", number, CONFIG) for number in (1, 2)]
    columns = [drawn.policy, drawn.hole_pos_world, drawn.peg_type]
    for attempt in (drawn, *(attempt for attempt, _ in later)):
        wiggle = jax.vmap(lambda key: jax.random.normal(jax.random.fold_in(key, 0), (3,)))(attempt.key)
        columns += [attempt.estimate_world - attempt.hole_pos_world, wiggle]
    columns += [jnp.log(jnp.linalg.det(cov)) for _, cov in later]
    correlation = np.corrcoef(np.column_stack(columns), rowvar=False)
    assert np.abs(correlation - np.eye(len(correlation))).max() < 4.5 / np.sqrt(n)


def test_uses_of_one_seed_share_no_episode():
    collected = draw_attempts(root_key(0, "collect"), jnp.arange(50), "spiral", CONFIG)
    evaluated = draw_attempts(root_key(0, "attempt"), jnp.arange(50), "spiral", CONFIG)
    assert np.abs(np.asarray(collected.estimate_world - evaluated.estimate_world)).min(1).max() > 1e-4
    assert not (jax.random.key_data(collected.key) == jax.random.key_data(evaluated.key)).all(-1).any()


def test_later_estimates_are_as_good_as_their_covariance_says():
    ids = jnp.arange(3000)
    first = draw_attempts(jax.random.key(0), ids, "spiral", CONFIG)
    later, cov = draw_later_attempts(jax.random.key(0), ids, "spiral", 1, CONFIG)
    for name in ("hole_pos_world", "peg_type", "hole_type"):
        assert (getattr(first, name) == getattr(later, name)).all()
    error = np.asarray(later.estimate_world - later.hole_pos_world, np.float64)
    distance = np.einsum("ni,nij,nj->n", error, np.linalg.inv(np.asarray(cov, np.float64)), error)
    assert stats.kstest(distance, stats.chi2(2).cdf).pvalue > 1e-3
    std = np.sqrt(np.linalg.eigvalsh(np.asarray(cov, np.float64)))
    assert std.min() >= CONFIG.sequence.min_std_m * 0.999
    assert std.max() <= CONFIG.sequence.max_std_m * 1.001
    assert np.median(std) == pytest.approx(np.sqrt(0.001 * 0.008), rel=0.05)
    tilted = np.asarray(cov[:, 0, 1]) / np.sqrt(np.asarray(cov[:, 0, 0] * cov[:, 1, 1]))
    assert np.abs(tilted).max() > 0.9
    assert abs(tilted.mean()) < 0.05
