"""Searches in yaw and tilt: their amplitudes, and that without one nothing changes."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mjx_fit.config.files import read_config
from mjx_fit.control.open_loop import random, random_turn, shipped, spiral_turn
from mjx_fit.control.policies import Policy, by_name, stateless

SEARCHES = read_config(
    None, ["spiral.yaw_rad=0.2", "spiral.tilt_rad=0.05", "random.yaw_rad=0.3", "random.tilt_rad=0.1"]
)
STEPS = jnp.arange(400)


def test_a_spiral_swings_in_yaw_and_leans_all_around():
    turns = np.asarray(jax.vmap(lambda step: spiral_turn(step, SEARCHES.spiral))(STEPS))
    np.testing.assert_allclose(turns[0], 0, atol=1e-7)
    assert 0.19 < turns[:, 2].max() <= 0.2
    assert -0.2 <= turns[:, 2].min() < -0.19
    lean = np.hypot(turns[:, 0], turns[:, 1])
    np.testing.assert_allclose(lean[20:], 0.05, rtol=1e-5)
    # Yaw and tilt are not tied to each other: all signs meet.
    signs = {tuple(row) for row in np.sign(np.round(turns[20:100], 3)).tolist()}
    assert {(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)} <= signs


def test_random_turns_lead_evenly_between_way_points_within_their_bounds():
    key = jax.random.key(0)
    turns = np.asarray(jax.vmap(lambda step: random_turn(step, key, SEARCHES.random))(STEPS))
    most = np.array([0.1, 0.1, 0.3])
    assert (np.abs(turns) <= most).all()
    assert (np.abs(turns).max(0) > 0.8 * most).all()
    sweep = SEARCHES.random.actions_per_sweep
    bends = np.abs(np.diff(turns, 2, axis=0)).max(1) > 1e-5
    assert (np.flatnonzero(bends) % sweep == sweep - 2).all()
    other = np.asarray(random_turn(jnp.array(50), jax.random.key(1), SEARCHES.random))
    assert not np.allclose(turns[50], other)


def test_without_a_search_commands_have_three_components():
    assert not shipped(read_config(None, [])).turns
    assert shipped(SEARCHES).turns
    assert not random(read_config(None, []).random).turns


def test_a_policy_among_others_that_turn_stays_straight_down():
    still = stateless(lambda seen: jnp.array([1.0, 2, 3]))
    turned = stateless(lambda seen: jnp.arange(6.0), turns=True)
    both: Policy = by_name(still, turned)

    def command(choice: int) -> list[float]:
        seen: Any = SimpleNamespace(start=SimpleNamespace(policy=jnp.array(choice)))
        return both.act(((), ()), seen)[1].tolist()

    assert command(0) == [1, 2, 3, 0, 0, 0]
    assert command(1) == [0, 1, 2, 3, 4, 5]
