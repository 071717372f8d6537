"""Spells of ``seek`` that are led astray, for data."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from fakes import seen
from thoughts import belief_of, thought

from mjx_fit.config.schema import Config
from mjx_fit.task.seek import SPELL_ACTIONS, Thought, decided_or_astray


def after_step(step: int, key, share: float) -> Thought:
    """The state after an action with a belief that asks for a new search at once: 5 mm away, and sure."""
    config = replace(Config(), seek=replace(Config().seek, astray_share=share))
    state = replace(thought(belief_of((0.005, 0.0), 0.0005), path_m=0.01), prior=belief_of((0.0, 0.01), 0.01))
    return decided_or_astray(state, replace(seen(), step=jnp.int32(step), attempt_key=key), config)


def test_a_spell_astray_begins_at_a_place_of_the_prior_and_lasts():
    keys = jax.random.split(jax.random.key(5), 1000)
    begun = jax.vmap(lambda key: after_step(3 * SPELL_ACTIONS, key, 1.0).search)(keys)
    assert (np.asarray(begun.path_m) == 0).all()
    # A normal distribution cut at two standard deviations has 0.774 of its variance.
    off = (np.asarray(begun.centre_world) - [0.0, 0.01]) / 0.01
    np.testing.assert_allclose(off.mean(0), 0, atol=0.1)
    np.testing.assert_allclose(np.cov(off.T), 0.774 * np.eye(2), atol=0.1)
    assert np.abs(off).max() <= 2
    within = jax.vmap(lambda key: after_step(3 * SPELL_ACTIONS + 1, key, 1.0).search)(keys[:5])
    np.testing.assert_allclose(within.path_m, 0.01)
    np.testing.assert_array_equal(within.centre_world, np.zeros((5, 2)))


def test_the_share_of_spells_is_led_astray_and_the_others_follow_the_belief():
    keys = jax.random.split(jax.random.key(6), 1000)
    centres = np.asarray(jax.vmap(lambda key: after_step(SPELL_ACTIONS, key, 0.3).search.centre_world)(keys))
    follows = np.isclose(centres, [0.005, 0.0], atol=1e-9).all(1)
    assert 0.65 < follows.mean() < 0.75
    assert np.isclose(after_step(SPELL_ACTIONS, keys[0], 0.0).search.centre_world, [0.005, 0.0]).all()
