"""Motion of the goal during an action."""

import dataclasses

import numpy as np

from mjx_fit.config.sections.world import ControlConfig
from mjx_fit.control.goals import goal_during
from mjx_fit.types import SUBSTEPS

BEFORE, AFTER = np.array([0.5, 0.1, 0.04]), np.array([0.51, 0.1, 0.03])
RAMP = dataclasses.replace(ControlConfig(), goal="ramp")


def test_a_step_is_the_goal_at_once():
    step = dataclasses.replace(RAMP, goal="step")
    assert all((goal_during(BEFORE, AFTER, i, step) == AFTER).all() for i in range(SUBSTEPS))


def test_a_ramp_moves_evenly_and_arrives_with_the_last_step():
    goals = np.array([BEFORE, *[goal_during(BEFORE, AFTER, i, RAMP) for i in range(SUBSTEPS)]])
    np.testing.assert_allclose(np.diff(goals, axis=0), np.tile((AFTER - BEFORE) / SUBSTEPS, (SUBSTEPS, 1)))
    np.testing.assert_allclose(goals[-1], AFTER)


def test_worlds_are_independent():
    both = goal_during(np.stack([BEFORE, AFTER]), np.stack([AFTER, AFTER]), 9, RAMP)
    np.testing.assert_allclose(both, [BEFORE + 0.2 * (AFTER - BEFORE), AFTER])
