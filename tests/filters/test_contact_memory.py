"""What is remembered of attempts: against homogeneous matrices, and against reading all rows at once."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mjx_fit as mf
from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.filters import contact_memory
from mjx_fit.filters.updates import detected_belief
from mjx_fit.task.estimator import filter_update
from mjx_fit.types import Particles, Rows
from mjx_fit.utils.errors import RequestError

N_ROWS = 10


@pytest.fixture(scope="module")
def config():
    whole = read_config(world_file("bench"), ["control.push=force"])
    few = replace(whole.particles, count=64, moves=2, remember=2, remember_rows=4)
    return replace(whole, particles=few)


def some_rows(seed=0, press=5.0):
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(rng.normal(0, 0.1, (N_ROWS, 3))).as_matrix()
    tip, pressure = rng.normal(0, 0.01, (N_ROWS, 3)), rng.normal(0, 0.01, (N_ROWS, 2))
    every = np.ones(N_ROWS)
    leaves = tip, turn, press * every, pressure, 0.4 * every, 0 * every, jnp.zeros(N_ROWS, jnp.int32)
    return Rows(*(jnp.asarray(leaf) for leaf in leaves))


@pytest.fixture
def memory(config):
    return contact_memory.remembering(detected_belief(jnp.array([0.5, 0.1]), config), config).memory


def found(config, value):
    own = config.particles.count
    return Particles(jnp.full((own, 16), float(value)), jnp.full(own, value))


def test_rows_are_seen_from_another_estimate_as_matrices_say(config):
    rng, names = np.random.default_rng(1), config.filter.coordinates
    places = [np.append(rng.normal([0.5, 0, 0], 0.01), rng.normal(0, 0.1, 3)) for _ in range(2)]

    def rigid(place):
        whole = np.eye(4)
        yaw_roll_pitch = dict(zip(names, place, strict=True))
        vector = [yaw_roll_pitch[name] for name in ("roll", "pitch", "yaw")]
        whole[:3, :3], whole[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), place[:3]
        return whole

    rows = some_rows()
    here, there = (jnp.asarray(place) for place in places)
    got = contact_memory.seen_from(rows, here, there, names)
    change = np.linalg.inv(rigid(places[1])) @ rigid(places[0])
    for k in range(N_ROWS):
        tool = np.eye(4)
        tool[:3, :3], tool[:3, 3] = rows.turn[k], rows.tip[k]
        want = change @ tool
        np.testing.assert_allclose(got.tip[k], want[:3, 3], atol=1e-6)
        np.testing.assert_allclose(got.turn[k], want[:3, :3], atol=1e-6)
    np.testing.assert_array_equal(got.pressure, rows.pressure)


def test_contact_is_kept_evenly_and_the_oldest_attempt_makes_room(config, memory):
    in_air = some_rows(press=0.1)
    half = replace(some_rows(), press=jnp.where(jnp.arange(N_ROWS) % 2 == 1, 5.0, 0.1))
    few = replace(some_rows(1), press=jnp.where(jnp.arange(N_ROWS) == 7, 5.0, 0.1))
    memory = contact_memory.with_attempt(memory, half, found(config, 0), config)
    np.testing.assert_array_equal(memory.rows.tip[:4], half.tip[jnp.array([1, 3, 5, 7])])
    np.testing.assert_allclose(memory.rows.weight[:4], 0.4 * 5 / 4)  # of five rows, four are left
    assert memory.rows.weight[4:].tolist() == [0] * 4
    assert memory.rows.attempt.tolist() == [1, 1, 1, 1, 2, 2, 2, 2]
    np.testing.assert_allclose(memory.rows.noise[:4], 1.0)
    memory = contact_memory.with_attempt(memory, few, found(config, 1), config)
    np.testing.assert_allclose(memory.rows.weight[4:], [0.4, 0, 0, 0])
    np.testing.assert_array_equal(memory.rows.tip[4], few.tip[7])
    memory = contact_memory.with_attempt(memory, in_air, found(config, 2), config)
    np.testing.assert_array_equal(memory.rows.tip[0], few.tip[7])
    assert not memory.rows.weight[1:].any()
    assert int(memory.count) == 3
    assert (memory.particles.types == 2).all()
    assert memory.rows.attempt.tolist() == [1, 1, 1, 1, 2, 2, 2, 2]
    np.testing.assert_allclose(memory.rows.noise, 4 * [np.exp(0.6)] + 4 * [np.exp(1.2)], rtol=1e-6)


def test_an_error_of_heights_stays_with_its_attempt(config, memory):
    """Of three attempts two are remembered; an attempt begins with errors of its own."""
    drawn = Particles(jnp.full((64, 16), 9.0), jnp.zeros(64, jnp.int32))
    errors = []
    for k in range(3):
        before = contact_memory.resumed(memory, drawn, config).values
        after = Particles(jnp.asarray(before).at[:, 12].set(k + 1), drawn.types)
        memory = contact_memory.with_attempt(memory, some_rows(k), after, config)
        errors.append(contact_memory.resumed(memory, drawn, config).values[0, 12:].tolist())
    assert errors == [[9, 9, 1, 9], [9, 9, 1, 2], [9, 9, 2, 3]]


def test_an_attempt_begins_with_the_particles_of_the_last_one_and_errors_of_its_own(config, memory):
    drawn = found(config, 5)
    first = contact_memory.resumed(memory, drawn, config)
    assert (first.values == 5).all()
    later = contact_memory.with_attempt(memory, some_rows(), found(config, 1), config)
    resumed = contact_memory.resumed(later, drawn, config)
    assert (resumed.values[:, 12:14] == 5).all()
    assert (jnp.delete(resumed.values, jnp.array([12, 13]), axis=1) == 1).all()
    assert (resumed.types == 1).all()


def test_a_memory_of_another_configuration_is_refused(config):
    beliefs = contact_memory.remembering(detected_belief(jnp.zeros((3, 2)), config), config)
    contact_memory.require_memory(beliefs, config)
    contact_memory.require_memory(replace(beliefs, memory=None), config)
    other = replace(config, particles=replace(config.particles, count=128))
    with pytest.raises(RequestError, match=r"memory.particles.values: float32 \(3, 64, .* floats \(3, 128, "):
        contact_memory.require_memory(beliefs, other)
    assert beliefs.memory is not None
    halves = replace(beliefs.memory, count=jnp.full(3, 0.5))
    with pytest.raises(RequestError, match=r"memory.count: float32 \(3,\) is invalid: expected integers"):
        contact_memory.require_memory(replace(beliefs, memory=halves), config)


@pytest.mark.slow
def test_two_attempts_are_read_together(config):
    """Neither is forgotten: the second belief does not depend on what the first was summarised to."""
    whole = replace(config, particles=replace(config.particles, remember_rows=50, count=256))
    attempts = mf.draw_attempts(jax.random.key(5), 2, config=whole)
    felt = mf.make_engine("native", whole).run(attempts, 60).felt
    update, keys = filter_update(whole, None), jax.random.split(jax.random.key(1), 2)
    before = contact_memory.remembering(detected_belief(attempts.estimate_world, whole), whole)
    once = update(before, felt, keys)
    lied = replace(once, mean_world=once.mean_world + 0.05, cov=1e-4 * once.cov)
    again, misled = (update(belief, felt, keys) for belief in (once, lied))
    np.testing.assert_array_equal(again.mean_world, misled.mean_world)
    assert again.memory is not None
    assert once.memory is not None
    assert again.memory.count.tolist() == [2, 2]
    assert (np.linalg.det(again.cov) < np.linalg.det(once.cov)).all()
    assert np.isfinite(again.type_logp).all()
    # The outcome of the first attempt is remembered, too.
    assert (np.asarray(once.memory.before.type_logp) != np.asarray(before.type_logp)).any()


@pytest.mark.slow
def test_a_belief_that_is_far_off_finds_its_way_back_to_the_detection(config):
    """Where the detection is forgotten, a wrong belief goes on from where it is."""
    own = replace(config.particles, count=256, moves=4, remember=0)
    whole = replace(config, particles=own)
    attempts = mf.draw_attempts(jax.random.key(5), 2, config=whole)
    felt = mf.make_engine("native", whole).run(attempts, 60).felt
    update, keys = filter_update(whole, None), jax.random.split(jax.random.key(1), 2)
    detected = detected_belief(attempts.estimate_world, whole)
    off = jnp.array([0.05, 0, 0, 0, 0, 0])
    known = contact_memory.remembering(detected, whole)
    wrong = replace(known, mean_world=known.mean_world + off, cov=0.01 * known.cov)
    back, lost = (update(one, felt, keys) for one in (wrong, replace(wrong, memory=None)))
    distance = [np.linalg.norm((one.mean_world - detected.mean_world)[:, :2], axis=1) for one in (back, lost)]
    assert (distance[0] < 0.025).all()
    assert (distance[1] > 0.03).all()
    assert back.memory is not None
    np.testing.assert_array_equal(back.memory.before.mean_world, detected.mean_world)
