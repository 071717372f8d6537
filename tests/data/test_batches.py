"""Passes over a data set."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from synthetic import PAPER_TRAINING, make_episodes

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.learning import TrainConfig
from mjx_fit.data.batches import batches, equal_batches, placed
from mjx_fit.data.windows import sample_windows

DATA = make_episodes(20, actions=12, min_length=6)
CHOSEN = np.arange(3, 20)
CONFIG = Config(train=TrainConfig(min_window=4, max_window=8, batch_size=5, **PAPER_TRAINING))


def one_pass(data, seed, config=CONFIG):
    """All windows of a pass with their weights, by the hole that they are at."""
    found = {}
    for sample, weight in batches(data, CHOSEN, jax.random.key(seed), config):
        assert isinstance(sample.place_world, jax.Array)
        for i, real in enumerate(np.asarray(weight)):
            if real:
                found[tuple(np.asarray(sample.place_world[i]).tolist())] = jax.tree.map(
                    lambda leaf, i=i: np.asarray(leaf[i]), sample
                )
    return found


def test_every_episode_comes_once_and_in_batches_of_one_shape():
    seen = list(batches(DATA, CHOSEN, jax.random.key(0), CONFIG))
    assert len(seen) == 4
    assert {sample.reading.mask.shape for sample, _ in seen} == {(5, 8)}
    assert sum(float(weight.sum()) for _, weight in seen) == 17
    holes = set(map(tuple, np.asarray(DATA.rollout.truth.hole_pos_world)[CHOSEN].tolist()))
    assert set(one_pass(DATA, 0)) == holes


def test_host_and_device_and_any_batch_size_give_the_same_windows():
    host = placed(DATA, free_bytes=1000)
    assert isinstance(host.episode, np.ndarray)
    assert isinstance(placed(DATA, free_bytes=10**9).episode, jax.Array)
    assert isinstance(placed(DATA).episode, jax.Array)
    first = one_pass(DATA, 0)
    larger = replace(CONFIG, train=replace(CONFIG.train, batch_size=9))
    for other in (one_pass(host, 0), one_pass(DATA, 0, larger)):
        assert other.keys() == first.keys()
        for hole, sample in first.items():
            jax.tree.map(np.testing.assert_array_equal, sample, other[hole])


def test_the_key_is_all_that_the_order_depends_on():
    def order(seed):
        passes = batches(DATA, CHOSEN, jax.random.key(seed), CONFIG)
        return np.concatenate([sample.place_world[:, 0] for sample, _ in passes])

    assert np.array_equal(order(0), order(0))
    assert not np.array_equal(order(0), order(1))


def test_windows_are_those_of_the_whole_set():
    key = jax.random.key(4)
    window_key = jax.random.split(key)[1]
    whole = sample_windows(DATA, jnp.arange(20), window_key, CONFIG)
    by_hole = one_pass(DATA, 4)
    for i in CHOSEN:
        hole = tuple(np.asarray(DATA.rollout.truth.hole_pos_world[i]).tolist())
        jax.tree.map(lambda a, b, i=i: np.testing.assert_array_equal(a, b[i]), by_hole[hole], whole)


@settings(max_examples=12)  # each compiles
@example(n=1, size=64)
@example(n=64, size=64)
@example(n=65, size=64)
@given(n=st.integers(1, 300), size=st.integers(1, 64))
def test_equal_batches_hold_everything_once(n, size):
    ids, weight = (np.asarray(x) for x in equal_batches(jnp.arange(n), size))
    assert ids.shape == weight.shape
    assert ids.shape[1] <= size
    assert len(ids) == -(-n // size)
    assert sorted(ids[weight > 0].tolist()) == list(range(n))
    assert (weight == 0).sum() < len(ids) or n == 1
    assert weight.sum() == pytest.approx(n)


def test_of_chains_every_attempt_counts_once_and_no_gap_counts():
    """Chains of up to three; a gap is filled with the chain's own first attempt, without weight."""
    chains = np.array([[0, 1, 2], [3, -1, -1], [4, 5, -1], [6, 7, 8], [9, -1, -1]])
    ids, weight = (np.asarray(x) for x in equal_batches(jnp.asarray(chains), 6))
    assert ids.shape == (3, 2, 3)
    assert sorted(ids[weight == 1].tolist()) == list(range(10))
    assert set(weight.ravel().tolist()) == {0, 1}
    firsts = np.broadcast_to(ids[..., :1], ids.shape)
    gaps = np.array([chains[np.flatnonzero(chains[:, 0] == row[0])[0]] < 0 for row in ids.reshape(-1, 3)])
    assert (ids.reshape(-1, 3)[gaps] == firsts.reshape(-1, 3)[gaps]).all()


def test_a_data_set_leaves_half_of_the_free_memory():
    size = sum(leaf.nbytes for leaf in jax.tree.leaves(DATA))
    assert isinstance(placed(DATA, free_bytes=2 * size).episode, jax.Array)
    assert isinstance(placed(DATA, free_bytes=2 * size - 2).episode, np.ndarray)
