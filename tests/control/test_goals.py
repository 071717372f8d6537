"""Motion of the goal during an action."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from mjx_fit.config.sections.world import ControlConfig
from mjx_fit.control.goals import after, after_actions, at_rest, commanded, goal_during
from mjx_fit.types.physics import AS_CONFIGURED, Physics
from mjx_fit.utils.rates import STEP_S, SUBSTEPS

BEFORE, AFTER = np.array([0.5, 0.1, 0.04]), np.array([0.51, 0.1, 0.03])
RAMP = dataclasses.replace(ControlConfig(), goal="ramp")


def goals_during(control, physics=AS_CONFIGURED, goal=None, wanted=AFTER):
    """The goals of all steps of an action."""
    goal, goals = at_rest(BEFORE, RAMP) if goal is None else goal, []
    for i in range(SUBSTEPS):
        goal, now = goal_during(goal, wanted, i, control, physics)
        goals.append(now)
    return np.array(goals)


def test_a_step_is_the_goal_at_once():
    step = dataclasses.replace(RAMP, goal="step")
    assert all((goals_during(step)[i] == AFTER).all() for i in range(SUBSTEPS))


def test_a_ramp_moves_evenly_and_arrives_with_the_last_step():
    goals = np.array([BEFORE, *goals_during(RAMP)])
    np.testing.assert_allclose(np.diff(goals, axis=0), np.tile((AFTER - BEFORE) / SUBSTEPS, (SUBSTEPS, 1)))
    np.testing.assert_allclose(goals[-1], AFTER)


def test_worlds_are_independent():
    _, both = goal_during(at_rest(np.stack([BEFORE, AFTER]), RAMP), np.stack([AFTER, AFTER]), 9, RAMP)
    np.testing.assert_allclose(both, [BEFORE + 0.2 * (AFTER - BEFORE), AFTER])


def test_a_delay_shifts_the_motion_across_actions():
    later = np.array([0.52, 0.1, 0.03])
    wanted = np.concatenate([goals_during(RAMP), goals_during(RAMP, goal=at_rest(AFTER, RAMP), wanted=later)])
    for steps in (1, 20, SUBSTEPS):
        slow = dataclasses.replace(RAMP, goal_delay_s=steps * STEP_S)
        first = goals_during(slow)
        second = goals_during(slow, goal=after(at_rest(BEFORE, RAMP), AFTER), wanted=later)
        delayed = np.concatenate([first, second])
        np.testing.assert_allclose(delayed[steps:], wanted[:-steps], atol=1e-9)
        np.testing.assert_allclose(delayed[:steps], np.tile(BEFORE, (steps, 1)), atol=1e-9)


def test_a_delayed_step_comes_later():
    late = dataclasses.replace(RAMP, goal="step", goal_delay_s=0.03)
    goals = goals_during(late)
    assert (goals[:15] == BEFORE).all()
    assert (goals[15:] == AFTER).all()


def test_smoothing_is_a_first_order_low_pass():
    smooth = dataclasses.replace(RAMP, goal="step", smoothing_s=0.02)
    passed = scipy.signal.lfilter([STEP_S / (0.02 + STEP_S)], [1, -0.02 / (0.02 + STEP_S)], np.ones(SUBSTEPS))
    share = (goals_during(smooth) - BEFORE)[:, 0] / (AFTER - BEFORE)[0]
    np.testing.assert_allclose(share, passed, rtol=1e-9)


def test_each_world_has_its_own_delay_and_smoothing():
    smoothing, delay = np.array([0.02, 0.05]), np.array([0.01, 0.04])
    both = Physics(smoothing_s=smoothing, goal_delay_s=delay)
    starts, wanted = at_rest(np.stack([BEFORE, BEFORE]), RAMP), np.stack([AFTER, AFTER])
    together = goals_during(RAMP, both, starts, wanted)
    for i in range(2):
        own = dataclasses.replace(RAMP, smoothing_s=float(smoothing[i]), goal_delay_s=float(delay[i]))
        np.testing.assert_allclose(together[:, i], goals_during(own), rtol=1e-12)


@pytest.mark.parametrize("push", ["displacement", "force"])
def test_the_goal_after_recorded_actions_is_the_one_that_was_followed(push):
    """With a delay and a low pass it depends on all actions before; rows beyond the count are ignored."""
    control = dataclasses.replace(RAMP, goal_delay_s=0.02, smoothing_s=0.05, push=push)
    from_here = np.array([1, 1, push == "displacement"], np.float32)
    rng = np.random.default_rng(0)
    tips = np.cumsum(rng.normal(0, 0.004, (6, 3)), axis=0).astype(np.float32)
    actions = rng.normal(0, 0.004, (6, 3)).astype(np.float32)
    start = np.array(BEFORE, np.float32)
    for count in (0, 1, 4):
        goal = at_rest(start, control)
        for j in range(count):
            wanted = from_here * (start if j == 0 else tips[j - 1]) + actions[j]
            for i in range(SUBSTEPS):
                goal, _ = goal_during(goal, wanted, i, control)
            goal = after(goal, wanted)
        before = jnp.concatenate([start[None], tips])[:-1]
        goals = commanded(before, jnp.asarray(actions), control)
        found = after_actions(at_rest(jnp.asarray(start), control), goals, jnp.asarray(count), control)
        for name in ("now_world", "earlier_world", "smooth_world"):
            np.testing.assert_allclose(getattr(found, name), getattr(goal, name), atol=1e-6)
