"""Draws of randomised worlds: distributions, and independence of batch and order."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from mjx_fit.config.files import read_config
from mjx_fit.config.quantities import MEASURED, QUANTITIES
from mjx_fit.config.randomized import distributions
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.randomize import RandomizeConfig
from mjx_fit.config.worlds import world_file
from mjx_fit.data.schedule import draw_attempts, draw_later_attempts, draw_places
from mjx_fit.scene.randomization import draw_errors, draw_physics
from mjx_fit.scene.scenarios import draw_trials
from mjx_fit.sensors.distortion import is_undistorted
from mjx_fit.sensors.pose import is_exact
from mjx_fit.types.physics import AS_CONFIGURED, Physics, drawn

FORGE = read_config(world_file("forge")[0], ())
N = 2000


def randomized(**named) -> Config:
    return read_config(None, tuple(f"randomize.{name}={words}" for name, words in named.items()))


def draws(name: str, words: str) -> np.ndarray:
    config = randomized(**{name: words})
    keys = jax.random.split(jax.random.key(0), N)
    return np.asarray(getattr(jax.vmap(lambda key: draw_physics(key, config.randomize))(keys), name))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("{uniform: [0.25, 1.25]}", stats.uniform(0.25, 1.0)),
        ("{log_uniform: [0.25, 1.25]}", stats.loguniform(0.25, 1.25)),
        ("{normal: [0.5, 0.1]}", stats.norm(0.5, 0.1)),
    ],
)
def test_draws_have_the_distribution(words, expected):
    values = draws("friction", words)
    assert stats.kstest(values, expected.cdf).pvalue > 0.001
    assert not np.isclose(values.mean(), values.min())


def test_a_normal_distribution_is_clipped_and_a_choice_is_even():
    assert abs(draws("tilt_x_rad", "{normal: [0, 0.01]}")).max() <= 0.03 + 1e-7
    values, counts = np.unique(draws("friction", "{choice: [0.25, 0.5, 1.0]}"), return_counts=True)
    np.testing.assert_allclose(values, [0.25, 0.5, 1.0])
    assert stats.chisquare(counts).pvalue > 0.001


def test_the_draw_of_a_quantity_does_not_depend_on_the_others():
    one = draws("friction", "{uniform: [0.25, 1.25]}")
    config = randomized(friction="{uniform: [0.25, 1.25]}", kp_position="{uniform: [500, 700]}")
    keys = jax.random.split(jax.random.key(0), N)
    both = jax.vmap(lambda key: draw_physics(key, config.randomize))(keys)
    np.testing.assert_array_equal(both.friction, one)
    assert abs(np.corrcoef(one, drawn(both)["kp_position"])[0, 1]) < 0.1


def test_constant_quantities_are_none():
    assert draw_physics(jax.random.key(0), RandomizeConfig()) == AS_CONFIGURED
    assert drawn(AS_CONFIGURED) == {}
    assert set(drawn(draw_physics(jax.random.key(0), FORGE.randomize))) == set(distributions(FORGE.randomize))


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=12, unique=True), st.randoms())
def test_draws_depend_on_the_id_alone(ids, random):
    shuffled = random.sample(ids, len(ids))
    root = jax.random.key(7)
    in_order, other = (draw_places(root, jnp.asarray(rows), FORGE).physics for rows in (ids, shuffled))
    alone = draw_places(root, jnp.asarray(ids[:1]), FORGE).physics
    place = [shuffled.index(i) for i in ids]
    for name, values in drawn(in_order).items():
        np.testing.assert_array_equal(values, np.asarray(getattr(other, name))[place])
        assert values[0] == getattr(alone, name)[0]


def test_all_attempts_at_a_hole_share_its_world():
    ids = jnp.arange(6)
    first = draw_attempts(jax.random.key(1), ids, "spiral", FORGE)
    later, _ = draw_later_attempts(jax.random.key(1), ids, "spiral", 2, FORGE)
    for name, values in drawn(first.physics).items():
        np.testing.assert_array_equal(values, getattr(later.physics, name))
    assert len(np.unique(drawn(first.physics)["friction"])) == len(ids)


def test_every_hole_of_an_assembly_has_a_world_and_other_draws_stay():
    trials, plain = (draw_trials(config, 0, np.arange(4)) for config in (FORGE, Config()))
    friction = drawn(trials.physics)["friction"]
    assert friction.shape == trials.hole_type.shape
    assert len(np.unique(friction)) == trials.hole_type.size
    np.testing.assert_array_equal(trials.estimate_world, plain.estimate_world)
    fewer = draw_trials(FORGE, 0, np.array([2]))
    np.testing.assert_array_equal(drawn(fewer.physics)["friction"][0], friction[2])


def test_randomising_does_not_change_places_and_keys():
    one, other = (draw_places(jax.random.key(0), jnp.arange(5), config) for config in (FORGE, Config()))
    np.testing.assert_array_equal(one.estimate_world, other.estimate_world)
    assert (jax.random.key_data(one.key) == jax.random.key_data(other.key)).all()


def test_sizes_of_errors_are_drawn_for_each_reading():
    wrist, pose = draw_errors(jax.random.key(0), FORGE)
    assert 0.1 <= float(wrist.force_noise_n) <= 1.0
    assert 0 <= float(pose.delay_s) <= 0.02
    assert FORGE.wrist.force_noise_n == Config().wrist.force_noise_n  # the configuration stays as it is
    assert draw_errors(jax.random.key(0), Config()) == (Config().wrist, Config().pose)
    paper = read_config(world_file("paper"))
    plain = draw_errors(jax.random.key(0), paper)
    assert plain == (paper.wrist, paper.pose)
    assert is_exact(plain[1])
    assert is_undistorted(plain[0])
    assert not is_exact(pose)


def test_the_section_names_every_quantity_once():
    names = [field.name for field in dataclasses.fields(RandomizeConfig)]
    assert names == [*QUANTITIES, *MEASURED]
    assert [field.name for field in dataclasses.fields(Physics)] == list(QUANTITIES)
