"""Windows against the rows that they were cut from."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import make_episodes, with_truth

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.learning import SensorConfig, TrainConfig
from mjx_fit.config.sections.measurement import PoseConfig, WristConfig
from mjx_fit.data.split import split_sequences
from mjx_fit.data.windows import MIN_ACTIONS, chains, sample_windows, usable
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.utils.errors import RequestError

CLEAN = WristConfig().without_errors()
CONFIG = Config(
    wrist=CLEAN,
    pose=PoseConfig().without_errors(),
    sensor=SensorConfig(pose="world"),
    train=TrainConfig(min_window=4, max_window=10, mirror=False),
)
NOISE = {"force_noise_n": 0.1, "torque_xy_noise_nm": 0.005, "torque_z_noise_nm": 0.003}
WHITE = replace(CLEAN, **NOISE)
EPISODES = 24
DATA = make_episodes(EPISODES, actions=16, min_length=3)
ALL = jnp.arange(EPISODES)
COPIES = 60


@pytest.fixture(scope="module")
def many():
    """One noisy window from each of many copies of the episodes: leaves (copies, episodes, ...), NumPy."""
    config = replace(CONFIG, wrist=WHITE)
    copies = jax.tree.map(lambda x: jnp.concatenate([x] * COPIES), DATA)
    sample = sample_windows(copies, jnp.arange(COPIES * EPISODES), jax.random.key(5), config)
    return jax.tree.map(lambda x: np.asarray(x).reshape(COPIES, EPISODES, *x.shape[1:]), sample)


def starts_of(sample) -> np.ndarray:
    """Where each window begins, found by its first action among the source's."""
    first = np.asarray(sample.reading.action_world)[:, 0]
    actions = np.asarray(DATA.rollout.felt.trace.action_world)
    return np.array([np.flatnonzero((actions[i] == first[i]).all(-1))[0] for i in range(EPISODES)])


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31 - 1))
def test_windows_are_consecutive_rows_of_their_episode(seed):
    sample = jax.tree.map(np.asarray, sample_windows(DATA, ALL, jax.random.key(seed), CONFIG))
    reading, starts = sample.reading, starts_of(sample)
    data = jax.tree.map(np.asarray, DATA.rollout.felt)
    inserted = np.asarray(DATA.rollout.truth.inserted)
    lengths, mask = data.length, reading.mask
    for i in range(EPISODES):
        count, rows = mask[i].sum(), slice(starts[i], starts[i] + mask[i].sum())
        assert mask[i, :count].all()
        assert min(4, lengths[i]) <= count <= min(10, lengths[i])
        assert starts[i] + count <= lengths[i]
        assert bool(sample.inserted[i]) == (inserted[i] and starts[i] + count == lengths[i])
        assert bool(sample.judged[i]) == (not sample.inserted[i])
        wrench = data.trace.wrench_sensor[i, rows] - data.tare_sensor[i]
        np.testing.assert_allclose(reading.wrench_sensor[i, :count], wrench, rtol=1e-5, atol=1e-5)
        origin = np.append(data.estimate_world[i], plate_top_m(CONFIG.scene))
        relative = data.trace.tip_pos_world[i, rows] - origin
        np.testing.assert_allclose(reading.tip_pos_estimate[i, :count], relative, atol=1e-6)
        for name in ("tip_quat_world", "tip_linvel_world", "tip_angvel_world", "action_world"):
            source = getattr(data.trace, name)[i, rows]
            np.testing.assert_array_equal(getattr(reading, name)[i, :count], source)
    for name, x in vars(reading).items():
        if name not in ("mask", "peg_type"):
            assert not np.asarray(x)[~mask].any(), name
    np.testing.assert_array_equal(reading.peg_type, data.peg_type)
    np.testing.assert_array_equal(sample.hole_type, DATA.rollout.truth.hole_type)
    np.testing.assert_array_equal(sample.place_world, DATA.rollout.truth.hole_pos_world)


def test_every_length_and_every_start_is_drawn(many):
    counts, lengths = many.reading.mask.sum(-1), np.asarray(DATA.rollout.felt.length)
    long = lengths >= 10
    drawn, times = np.unique(counts[:, long], return_counts=True)
    np.testing.assert_array_equal(drawn, np.arange(4, 11))
    np.testing.assert_allclose(times / times.sum(), 1 / 7, atol=0.04)
    first = many.reading.action_world[:, :, 0, 0]
    starts = (first[..., None] == np.asarray(DATA.rollout.felt.trace.action_world)[..., 0]).argmax(-1)
    left = lengths - counts
    assert (starts <= left).all()
    np.testing.assert_allclose((starts[left > 5] / left[left > 5]).mean(), 0.5, atol=0.05)
    assert (starts == 0).any()
    assert ((starts == left) & (left > 0)).any()


def test_both_kinds_of_windows_come_from_inserted_interactions(many):
    inserted = np.asarray(DATA.rollout.truth.inserted)
    assert inserted.sum() >= 2
    assert 0 < many.judged[:, inserted].mean() < 1
    assert many.judged[:, ~inserted].all()


def test_draws_depend_on_key_and_episode_and_not_on_the_batch(many):
    config = replace(CONFIG, wrist=WHITE)
    some = sample_windows(DATA, jnp.array([7, 2]), jax.random.key(5), config)
    # To the last bit but for what is computed from the draws, where rounding depends on the batch's shape.
    same = replace(some, reading=replace(some.reading, pressure_tip=many.reading.pressure_tip[0, [7, 2]]))
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a, b[0, [7, 2]]), same, many)
    np.testing.assert_allclose(some.reading.pressure_tip, same.reading.pressure_tip, atol=1e-6)
    other = sample_windows(DATA, jnp.array([7, 2]), jax.random.key(6), config)
    assert not np.array_equal(other.reading.wrench_sensor, some.reading.wrench_sensor)
    assert not np.array_equal(other.prior.type_logp, some.prior.type_logp)


def test_noise_has_the_sensors_sigmas_and_the_tare_its_share():
    wrist = replace(WHITE, tare_samples=4)
    # The window is the whole episode, so that it is known which clean rows it shows.
    config = replace(CONFIG, wrist=wrist, train=TrainConfig(min_window=16, max_window=16, mirror=False))
    copies = jax.tree.map(lambda x: jnp.concatenate([x] * 40), DATA)
    reading = sample_windows(copies, jnp.arange(40 * EPISODES), jax.random.key(1), config).reading
    clean = np.asarray(
        copies.rollout.felt.trace.wrench_sensor - copies.rollout.felt.tare_sensor[:, None, None]
    )
    mask = np.asarray(reading.mask)[..., None, None]
    np.testing.assert_array_equal(mask.sum(1).ravel(), copies.rollout.felt.length)
    error = np.asarray(reading.wrench_sensor) - clean
    samples = np.broadcast_to(mask, error.shape)
    sigma = np.array([0.1, 0.1, 0.1, 0.005, 0.005, 0.003])
    offset = error.mean((1, 2), where=samples)
    np.testing.assert_allclose(offset.std(0), sigma / 2, rtol=0.1)
    np.testing.assert_allclose(offset.mean(0) / sigma, 0, atol=0.1)
    within = (error - offset[:, None, None]).std((0, 1, 2), where=samples)
    np.testing.assert_allclose(within, sigma, rtol=0.02)


def test_prior_is_the_estimate_with_types_at_random(many):
    np.testing.assert_array_equal(many.prior.pos_mean_world[5], DATA.rollout.felt.estimate_world)
    np.testing.assert_array_equal(many.prior.pos_cov[0], DATA.estimate_cov)
    types = np.exp(many.prior.type_logp.astype(float)).reshape(-1, 3)
    np.testing.assert_allclose(types.sum(-1), 1, rtol=1e-5)
    np.testing.assert_allclose(types.mean(0), 1 / 3, atol=0.03)
    # Three uniforms over their sum spread less than a flat Dirichlet.
    uniform = np.random.default_rng(0).uniform(size=(100_000, 3))
    want = (uniform / uniform.sum(-1, keepdims=True)).std()
    np.testing.assert_allclose(types.std(), want, rtol=0.05)


def test_broken_and_short_interactions_are_not_usable():
    data = replace(DATA, rollout=with_truth(DATA.rollout, valid=np.arange(EPISODES) != 4))
    want = np.asarray(DATA.rollout.felt.length) >= MIN_ACTIONS
    want[4] = False
    assert not want.all()
    np.testing.assert_array_equal(usable(data), want)


@settings(max_examples=50, deadline=None)
@given(n=st.integers(2, 200), each=st.integers(1, 3), fraction=st.floats(0.01, 0.99), seed=st.integers(0, 99))
def test_split_is_a_partition_of_whole_sequences_with_something_on_both_sides(n, each, fraction, seed):
    sequences = np.arange(n * each) // each
    train, validation = split_sequences(sequences, fraction, seed)
    assert len(train)
    assert len(validation)
    np.testing.assert_array_equal(np.sort(np.r_[train, validation]), np.arange(n * each))
    assert not set(sequences[train]) & set(sequences[validation])
    assert abs(len(validation) / each - fraction * n) <= 1
    np.testing.assert_array_equal(split_sequences(sequences, fraction, seed)[1], validation)


def test_split_depends_on_the_seed_and_refuses_one_sequence():
    ids = np.arange(100)
    assert not np.array_equal(split_sequences(ids, 0.1, 0)[1], split_sequences(ids, 0.1, 1)[1])
    with pytest.raises(RequestError, match="at least 2"):
        split_sequences(np.zeros(5, int), 0.1, 0)


@settings(max_examples=50)
@given(each=st.integers(1, 5), length=st.integers(1, 4), left_out=st.sets(st.integers(0, 19)))
def test_chains_are_attempts_in_a_row(each, length, left_out):
    n = 20 // each * each
    data = make_episodes(n, actions=2, min_length=1, sequence=each)
    episodes = np.array([i for i in range(n) if i not in left_out], int)
    found = chains(data, episodes, length)
    assert found.shape[1] == length
    want = set()
    for i in episodes.tolist():
        place = i % each % length
        first = i - place
        if all(k in episodes for k in range(first, i)):
            want.add(i)
    assert sorted(found[found >= 0].tolist()) == sorted(want)
    for row in found:
        kept = row[row >= 0]
        assert (row[: len(kept)] == kept).all()
        assert kept.tolist() == list(range(kept[0], kept[0] + len(kept)))
        assert kept[0] % each % length == 0
        assert len({i // each for i in kept.tolist()}) == 1


def test_a_chain_is_mirrored_as_a_whole_and_its_windows_are_those_of_its_episodes():
    config = replace(CONFIG, train=replace(CONFIG.train, mirror=True))
    data = make_episodes(EPISODES, actions=16, sequence=3)
    rows = jnp.asarray(chains(data, np.arange(EPISODES), 3))
    chained = sample_windows(data, rows, jax.random.key(8), config)
    alone = sample_windows(data, ALL, jax.random.key(8), CONFIG)
    sign = np.sign(np.asarray(chained.place_world[..., 1] * alone.place_world[rows, 1]))
    assert (sign == sign[:, :1]).all()
    assert set(sign[:, 0]) == {-1.0, 1.0}
    np.testing.assert_allclose(
        chained.reading.tip_pos_estimate[..., 1] * sign[..., None],
        alone.reading.tip_pos_estimate[rows][..., 1],
        atol=1e-7,
    )


def test_the_mirror_tells_nothing_of_the_prior():
    """A key used twice would make the first type's probability tell whether a window is mirrored."""
    config = replace(CONFIG, train=replace(CONFIG.train, mirror=True))
    n = COPIES * EPISODES
    copies = jax.tree.map(lambda x: jnp.concatenate([x] * COPIES), DATA)
    sample = sample_windows(copies, jnp.arange(n), jax.random.key(9), config)
    mirrored = np.asarray(sample.place_world[:, 1] * copies.rollout.truth.hole_pos_world[:, 1] < 0)
    assert mirrored.mean() == pytest.approx(0.5, abs=0.05)
    first = np.exp(np.asarray(sample.prior.type_logp, float))
    columns = np.column_stack([mirrored, first[:, :2], np.asarray(sample.reading.mask.sum(1))])
    correlation = np.corrcoef(columns, rowvar=False)[0, 1:]
    assert np.abs(correlation).max() < 4.5 / np.sqrt(n)
