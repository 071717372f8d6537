"""Beliefs from the geometry of contact: what is read of an attempt, and what is learnt from it."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

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
from mjx_fit.task import geometry
from mjx_fit.task.attempt_loop import Try, attempt_rounds
from mjx_fit.task.estimator import filter_update
from mjx_fit.task.seek import GEOMETRIC, NAME, seek, seek_by_geometry
from mjx_fit.utils.errors import RequestError

N, PLACED, TYPED = 10, slice(0, 8), slice(4, None)
"""Attempts, those whose contact tells the place, and those whose contact tells the type."""


@pytest.fixture(scope="module")
def config():
    whole = read_config(world_file("bench"), ["control.push=force"])
    return replace(whole, particles=replace(whole.particles, count=512, moves=4))


def errors(config, beliefs, attempts):
    places = place_for_tool(attempts.hole_pos_world, attempts.physics, config)
    return np.asarray(chart.step_between(jnp.asarray(beliefs.mean_world), places, config.filter.coordinates))


def test_contact_tells_where_the_hole_is(config):
    """Rocking spirals: position, height and tilt come nearer, and the truth is where it is believed."""
    attempts = mf.draw_attempts(jax.random.key(5), N, config=config)
    done = mf.make_engine("native", config).run(attempts)
    places, types = np.arange(N) < PLACED.stop, np.arange(N) >= TYPED.start
    before = jax.tree.map(np.asarray, detected_belief(attempts.estimate_world, config))
    keys = jax.random.split(jax.random.key(1), N)
    after = jax.tree.map(np.asarray, filter_update(config, None, places, types)(before, done.felt, keys))
    old, new = (errors(config, beliefs, attempts)[PLACED] for beliefs in (before, after))
    distance = [np.median(np.hypot(*one[:, :2].T)) for one in (old, new)]
    assert distance[1] < 0.6 * distance[0]
    assert np.median(np.abs(new[:, 2])) < 0.4 * np.median(np.abs(old[:, 2]))
    assert np.median(np.abs(new[:, 4:])) < 0.6 * np.median(np.abs(old[:, 4:]))
    squared = np.einsum("ni,nij,nj->n", new[:, :2], np.linalg.inv(after.cov[PLACED, :2, :2]), new[:, :2])
    assert np.median(squared) < 4.6

    outcome = filter_update(replace(config, filter=replace(config.filter, reads="sensor")), None)
    alone = outcome(before, done.felt, keys)
    np.testing.assert_array_equal(after.mean_world[~places], before.mean_world[~places])
    np.testing.assert_allclose(after.type_logp[~types], alone.type_logp[~types], atol=1e-6)
    assert (np.abs(after.type_logp[types] - alone.type_logp[types]).max(1) > 1e-3).any()
    np.testing.assert_allclose(np.exp(after.type_logp).sum(1), 1, atol=1e-5)


@pytest.fixture(scope="module")
def sought(config):
    """Two attempts without errors of measurement, and all that the policy thought."""
    exact = replace(
        config,
        wrist=config.wrist.without_errors(),
        pose=config.pose.without_errors(),
        randomize=type(config.randomize)(socket_roll_rad=config.randomize.socket_roll_rad),
        particles=replace(config.particles, count=64, moves=1, think_every=16),
    )
    policy = seek_by_geometry(exact)._replace(report=lambda thought: (thought.belief, thought.past.rows))
    attempts = mf.draw_attempts(jax.random.key(7), 2, config=exact)
    return exact, attempts, mf.make_engine("native", exact, policy).run(attempts, 20)


def test_an_attempt_in_progress_is_read_as_the_whole_one(sought):
    """The rows that the policy gathers are those of the trace that it leaves."""
    exact, _, done = sought
    posed, known = with_world_poses(exact), 19 // exact.particles.every  # the last action is not read
    for i in range(2):
        felt = jax.tree.map(lambda leaf, i=i: jnp.asarray(leaf[i]), done.felt)
        want = every(rows_of(read_window(felt, jax.random.key(0), posed, Window(20)), exact), exact)
        for name in ("tip", "turn", "press", "pressure", "weight"):
            got = np.asarray(getattr(done.report[1], name))[i, -1, :known]
            np.testing.assert_allclose(got, getattr(want, name)[:known], atol=2e-5, err_msg=name)


@pytest.mark.slow
def test_attempts_that_are_over_are_not_thought_about(sought):
    """Of two side by side, the one that goes on learns what it learns alone."""
    exact, _, done = sought
    first = jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), done.felt)
    reading = read_window(first, jax.random.key(0), with_world_poses(exact), Window(20))
    row = jax.tree.map(lambda leaf: leaf[15:16] if leaf.ndim else leaf, reading)
    begun = geometry.begin(
        detected_belief(jnp.zeros(2), exact), jnp.zeros(6), first.peg_type, jax.random.key(0), exact
    )

    @jax.jit
    def learn(contact, running):
        return geometry.add(contact, row, jnp.asarray(15), running, jax.random.key(1), exact)

    pair = jax.vmap(learn)(jax.tree.map(lambda leaf: jnp.stack([leaf] * 2), begun), jnp.array([True, False]))
    alone = learn(begun, jnp.asarray(True))
    assert pair.known.tolist() == [8, 0]
    np.testing.assert_array_equal(pair.particles.values[1], begun.particles.values)
    assert (pair.particles.values[0] != begun.particles.values).any()
    np.testing.assert_allclose(pair.particles.values[0], alone.particles.values, atol=1e-5)


def test_it_thinks_when_it_is_time(sought):
    exact, attempts, done = sought
    mean = np.asarray(done.report[0].mean_world)
    prior = detected_belief(attempts.estimate_world, exact).mean_world
    # Sixteen actions are read before the seventeenth; before that the belief is that of its first draw.
    assert (np.abs(np.diff(mean, axis=1)).max(2) > 1e-5).nonzero()[1].tolist() == [0, 15, 0, 15]
    np.testing.assert_array_equal(mean[:, 0], prior)


@pytest.mark.parametrize("name", [GEOMETRIC, f"{NAME}@1234"])
def test_a_belief_by_geometry_outlives_a_search_in_vain(sought, name):
    """A whole attempt refutes what a sensor believed; the geometry reads it anew."""
    exact, attempts, done = sought
    before = jax.tree.map(np.asarray, detected_belief(attempts.estimate_world, exact))
    keys, asked = jax.random.split(jax.random.key(0), 2), iter([True])
    once = Try(attempts, np.ones(2, bool), before, keys)
    engine: Any = SimpleNamespace(policy_name=name, run=lambda *_: replace(done, report=done.report[0]))
    anew = replace(before, mean_world=before.mean_world + 0.001)
    rounds = attempt_rounds(lambda: once if next(asked, False) else None, engine, lambda *_: anew, 20)
    (tried,) = list(rounds)
    want = anew if name == GEOMETRIC else before
    np.testing.assert_array_equal(tried.beliefs.mean_world, want.mean_world)


def test_a_sensor_beside_the_geometry_is_refused(config):
    """It would be named in data and results, and never read."""
    sensor: Any = object()
    for refused in (lambda: filter_update(config, sensor), lambda: seek(config, sensor)):
        with pytest.raises(RequestError, match=r"^config: filter\.reads: geometry cannot be combined"):
            refused()
