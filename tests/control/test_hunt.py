"""Where to search next: played out as tries that end after a radius, and against the rule for one mode."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from fakes import seen

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.seek import SeekConfig
from mjx_fit.control import hunt, search
from mjx_fit.filters.updates import detected_belief
from mjx_fit.task.seek import Thought, decided

CONFIG = SeekConfig()
REACH_M = np.sqrt(CONFIG.feel_s * CONFIG.speed_mps * CONFIG.pitch_m / np.pi)
PER_AREA = np.pi / (CONFIG.speed_mps * CONFIG.pitch_m)


def cloud(*modes, n=200, std=0.0006, seed=0):
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.normal(mode, std, (n, 2)) for mode in modes])


def tries(holes, centre, here, rng, most=200_000):
    """Mean time until a try about this centre succeeds, each with a hole drawn anew."""
    overhead = CONFIG.change_s + np.linalg.norm(here - centre) / CONFIG.slide_mps
    squared = np.square(rng.choice(holes, most) - centre).sum(1)
    took = overhead + PER_AREA * np.minimum(squared, REACH_M**2)
    return took.sum() / (squared < REACH_M**2).sum()


def test_the_time_is_that_of_tries_played_out():
    holes, here = cloud((0, 0), (0.012, 0.002), std=0.002), np.array([0.003, 0.0])
    centre, took = hunt.best_new(jnp.asarray(here), jnp.asarray(holes), CONFIG)
    want = tries(holes, np.asarray(centre), here, np.random.default_rng(1))
    assert float(took) == pytest.approx(want, rel=0.02)
    # No place that is offered takes less.
    for other in holes[:: len(holes) // hunt.CANDIDATES]:
        assert tries(holes, other, here, np.random.default_rng(1)) > 0.97 * want


def test_of_two_modes_the_nearer_one_is_searched_and_not_the_mean():
    holes = cloud((-0.01, 0), (0.01, 0))
    for here in (-0.004, 0.004):
        centre, _ = hunt.best_new(jnp.array([here, 0.0]), jnp.asarray(holes), CONFIG)
        assert float(centre[0]) == pytest.approx(np.sign(here) * 0.01, abs=0.001)


def test_one_narrow_mode_has_the_times_of_one_gaussian():
    holes, here = jnp.asarray(cloud((0.002, 0.001))), jnp.array([0.0, 0.0])
    centre, took = hunt.best_new(here, holes, CONFIG)
    np.testing.assert_allclose(centre, holes.mean(0), atol=3e-4)
    cov = jnp.asarray(np.cov(holes.T, bias=True))
    assert float(took) == pytest.approx(float(search.new_s(here, holes.mean(0), cov, CONFIG)), rel=0.02)
    begun = search.begin(jnp.zeros(2))
    want = search.remaining_s(begun, holes, jnp.asarray(1.0), CONFIG)
    assert float(hunt.remaining_s(begun, holes, CONFIG)) == pytest.approx(float(want), rel=1e-4)


def test_a_search_that_has_missed_all_places_is_given_up():
    holes = jnp.asarray(cloud((0.0, 0.0)))
    swept = replace(search.begin(jnp.zeros(2)), path_m=jnp.asarray(0.1))
    assert float(hunt.remaining_s(swept, holes, CONFIG)) > 100
    ahead = replace(search.begin(jnp.zeros(2)), path_m=jnp.asarray(0.0))
    assert float(hunt.remaining_s(ahead, holes, CONFIG)) < 1


def test_seek_goes_where_its_places_are():
    config = Config()
    belief = detected_belief(jnp.zeros(2), config)
    begun = search.begin(jnp.zeros(2))
    begun = replace(begun, touched=jnp.asarray(True), path_m=jnp.asarray(0.05))
    thought = Thought(None, belief, belief, begun, jnp.zeros((), bool), None, jnp.asarray(cloud((0.015, 0))))
    after = decided(thought, seen((0.0, 0.0, 0.045)), config)
    assert float(after.search.centre_world[0]) == pytest.approx(0.015, abs=0.001)
    assert float(after.search.path_m) == 0
