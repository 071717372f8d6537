"""One action of a block of worlds: 50 steps of control and physics towards a commanded goal."""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Float

from mjx_fit.control.goals import Goal, after, goal_during
from mjx_fit.engines.native.block import Block
from mjx_fit.engines.native.controller import Brain
from mjx_fit.engines.policy_runner import Memory
from mjx_fit.utils.rates import SUBSTEPS


def driven(
    brain: Brain,
    block: Block,
    memory: Memory,
    wanted_world: Float[np.ndarray, "rows k"],
    on_step: Callable[[], None] | None = None,
) -> Goal:
    """Drive the TCPs to the next commanded goals and return the goals at the end of the action.

    Args:
        brain: Control.
        block: Simulations, which hold the wrenches of the action afterwards.
        memory: Goals at the end of the previous action, and the physics of the worlds.
        wanted_world: Commanded goals, m and rad.
        on_step: Callback after every step.
    """
    goal, physics = jax.tree.map(np.asarray, (memory.goal, memory.physics))
    for substep in range(SUBSTEPS):
        goal, now = goal_during(goal, wanted_world, substep, brain.config.control, physics)
        block.step(np.asarray(brain.torque(block.packed(), now, physics)), substep)
        if on_step is not None:
            on_step()
    return after(goal, wanted_world)
