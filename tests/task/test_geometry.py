"""Beliefs from the geometry of contact: what is read of an attempt, and what is learnt from it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mjx_fit as mf
from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.filters import chart
from mjx_fit.filters.updates import detected_belief
from mjx_fit.scene.placement import place_for_tool
from mjx_fit.sensors.contact_rows import every, rows_of, with_world_poses
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.task.after_attempts import after_failures
from mjx_fit.task.attempt_loop import Try, attempt_rounds
from mjx_fit.task.estimator import filter_update
from mjx_fit.task.seek import seek_by_geometry

N = 8


@pytest.fixture(scope="module")
def config():
    whole = read_config(world_file("bench"), ["control.push=force"])
    return replace(whole, particles=replace(whole.particles, count=512, moves=4))


@pytest.fixture(scope="module")
def tried(config):
    attempts = mf.draw_attempts(jax.random.key(5), N, config=config)
    return attempts, mf.make_engine("native", config).run(attempts)


def errors(config, beliefs, attempts):
    places = place_for_tool(attempts.hole_pos_world, attempts.physics, config)
    names = config.filter.coordinates
    return np.asarray(chart.step_between(jnp.asarray(beliefs.mean_world), places, names))


def test_contact_tells_where_the_hole_is(config, tried):
    """Of rocking spirals: position, height and tilt come nearer, and the truth is where it is believed."""
    attempts, done = tried
    before = jax.tree.map(np.asarray, detected_belief(attempts.estimate_world, config))
    update = filter_update(config, None)
    after = jax.tree.map(np.asarray, update(before, done.felt, jax.random.split(jax.random.key(1), N)))
    old, new = (errors(config, beliefs, attempts) for beliefs in (before, after))
    distance = [np.median(np.hypot(*one[:, :2].T)) for one in (old, new)]
    assert distance[1] < 0.6 * distance[0]
    assert np.median(np.abs(new[:, 2])) < 0.4 * np.median(np.abs(old[:, 2]))
    assert np.median(np.abs(new[:, 4:])) < 0.6 * np.median(np.abs(old[:, 4:]))
    squared = np.einsum("ni,nij,nj->n", new[:, :2], np.linalg.inv(after.cov[:, :2, :2]), new[:, :2])
    assert np.median(squared) < 4.6
    np.testing.assert_allclose(np.exp(after.type_logp).sum(1), 1, atol=1e-5)


def test_traits_say_what_is_learnt(config, tried):
    attempts, done = tried
    before = detected_belief(attempts.estimate_world, config)
    keys, half = jax.random.split(jax.random.key(1), N), np.arange(N) < N // 2
    after = filter_update(config, None, learns_position=half, learns_type=~half)(before, done.felt, keys)
    outcome = filter_update(replace(config, filter=replace(config.filter, reads="sensor")), None)
    alone = outcome(before, done.felt, keys)
    np.testing.assert_array_equal(after.mean_world[~half], np.asarray(before.mean_world)[~half])
    assert (np.abs(after.mean_world[half] - np.asarray(before.mean_world)[half]).max(1) > 1e-4).all()
    np.testing.assert_allclose(after.type_logp[half], alone.type_logp[half], atol=1e-6)
    assert (np.abs(after.type_logp[~half] - alone.type_logp[~half]).max(1) > 1e-3).any()


def test_an_attempt_in_progress_is_read_as_the_whole_one(config):
    """Without errors: the rows that a policy gathers are those of the trace that it leaves."""
    exact = replace(
        config, wrist=config.wrist.without_errors(), pose=config.pose.without_errors(),
        randomize=type(config.randomize)(socket_roll_rad=config.randomize.socket_roll_rad),
        particles=replace(config.particles, think_every=1000),
    )  # fmt: skip
    policy = seek_by_geometry(exact)._replace(report=lambda thought: thought.past.rows)
    attempts = mf.draw_attempts(jax.random.key(7), 2, config=exact)
    done = mf.make_engine("native", exact, policy).run(attempts, 20)
    posed, rows = with_world_poses(exact), exact.particles.every
    for i in range(2):
        felt = jax.tree.map(lambda leaf, i=i: jnp.asarray(leaf[i]), done.felt)
        want = every(rows_of(read_window(felt, jax.random.key(0), posed, Window(20)), exact), exact)
        known = 19 // rows  # the last action is over before it is read
        for name in ("tip", "turn", "press", "pressure", "weight"):
            got = np.asarray(getattr(done.report, name))[i, -1, :known]
            np.testing.assert_allclose(got, getattr(want, name)[:known], atol=2e-5, err_msg=name)


def test_a_belief_by_geometry_outlives_a_search_in_vain(config):
    """A whole attempt refutes what a sensor believed; the geometry knows what was searched."""
    attempts = mf.draw_attempts(jax.random.key(8), 2, config=config)
    before = jax.tree.map(np.asarray, detected_belief(attempts.estimate_world, config))
    engine = mf.make_engine("native", config, seek_by_geometry(config))
    keys, asked = jax.random.split(jax.random.key(0), 2), iter([True])
    once = Try(attempts, np.ones(2, bool), before, keys)
    rounds = attempt_rounds(lambda: once if next(asked, False) else None, engine, lambda *given: given[0], 12)
    (tried,) = list(rounds)
    done, kept = tried.rollouts, tried.beliefs
    refuted = after_failures(lambda *given: given[0], before, done, keys)
    np.testing.assert_array_equal(refuted.mean_world, before.mean_world)
    np.testing.assert_array_equal(kept.mean_world, np.asarray(done.report.mean_world)[:, -1])
    assert np.abs(kept.mean_world - before.mean_world).max() > 1e-4
