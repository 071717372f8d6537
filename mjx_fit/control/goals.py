"""Motion of the controller's goal during an action.

If a push is a force (``ControlConfig.push``), the third component of a goal is no height: it is the vertical
command itself, which ``mjx_fit.control.force_control`` takes for a force. A policy that commands orientations
(``Policy.turns``) has goals of six components, k = 6: the last three are the rotation vector from straight
down, about the world's axes, rad. Else k = 3, and the TCP is held straight down.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from mjx_fit.config.sections.world import ControlConfig
from mjx_fit.types import Array, pytree
from mjx_fit.types.physics import AS_CONFIGURED, Physics
from mjx_fit.utils.arrays import is_off
from mjx_fit.utils.rates import ACTION_S, STEP_S, SUBSTEPS


@pytree
class Goal:
    """Goal of the TCP between actions, m and rad.

    Attributes:
        now_world: Commanded goal at the end of the previous action.
        earlier_world: The same, one action before; for delayed goals.
        smooth_world: Smoothed goal that the controller follows.
    """

    now_world: Float[Array, "*n k"]
    earlier_world: Float[Array, "*n k"]
    smooth_world: Float[Array, "*n k"]


def at_rest(
    tip_pos_world: Float[Array, "*n 3"],
    control: ControlConfig,
    turn_world: Float[Array, "*n 3"] | None = None,
) -> Goal:
    """Return the goal of a TCP that stays where it is and does not push.

    Args:
        tip_pos_world: Position of the TCP, m.
        control: As in ``goal_during``.
        turn_world: Its orientation, the rotation vector from straight down, rad; None: straight down, and the
            policy commands no orientations.
    """
    still = 0 * tip_pos_world
    command = still if turn_world is None else jnp.concatenate([still, turn_world], -1)
    here = commanded(tip_pos_world, command, control)
    return Goal(here, here, here)


def commanded(
    tip_pos_world: Float[Array, "*n 3"], command_world: Float[Array, "*n k"], control: ControlConfig
) -> Float[Array, "*n k"]:
    """Return the goal at the end of an action that starts at a position of the TCP, m and rad."""
    if control.push == "force":
        tip_pos_world = tip_pos_world * np.array([1, 1, 0], np.float32)
    if command_world.shape[-1] == tip_pos_world.shape[-1]:
        return tip_pos_world + command_world
    return jnp.concatenate([tip_pos_world + command_world[..., :3], command_world[..., 3:]], -1)


def after(goal: Goal, next_world: Float[Array, "*n k"]) -> Goal:
    """Return the goal at the end of an action with a new commanded goal, m and rad."""
    return replace(goal, now_world=next_world, earlier_world=goal.now_world)


def after_actions(
    begin: Goal,
    wanted_world: Float[Array, "n k"],
    count: Int[Array, ""],
    control: ControlConfig,
    physics: Physics = AS_CONFIGURED,
) -> Goal:
    """Reconstruct the goal after the first ``count`` of n recorded actions of one attempt.

    Args:
        begin: Goal before the first action.
        wanted_world: Goals that the actions commanded (``commanded``), m and rad.
        count: Number of actions; the other rows are ignored.
        control: As in ``goal_during``.
        physics: As in ``goal_during``.
    """

    def action(goal: Goal, row: tuple[Array, Array]) -> tuple[Goal, None]:
        number, next_world = row

        def step(substep: Array, goal: Goal) -> Goal:
            return goal_during(goal, next_world, substep, control, physics)[0]

        done = after(jax.lax.fori_loop(0, SUBSTEPS, step, goal), next_world)
        return jax.tree.map(partial(jnp.where, number < count), done, goal), None

    return jax.lax.scan(action, begin, (jnp.arange(len(wanted_world)), wanted_world))[0]


def goal_during(
    goal: Goal,
    next_world: Float[Array, "*n k"],
    substep: int | Int[Array, ""],
    control: ControlConfig,
    physics: Physics = AS_CONFIGURED,
) -> tuple[Goal, Float[Array, "*n k"]]:
    """Compute the goal of the TCP in one simulation step of an action, and update the smoothed one.

    Mode ``step`` is a jump by the whole command, which the arm answers with a torque step. Mode ``ramp``
    interpolates linearly at the rate of the torques, as the controllers of VICES (Martín-Martín et al., 2019)
    do. A delay shifts this motion in time; a low pass follows it: y += Δt / (τ + Δt) (x - y).

    Args:
        goal: Goal before the step.
        next_world: Goal commanded for this action, m and rad.
        substep: Index of the simulation step in the action, from 0.
        control: Defines the mode, and delay and smoothing of worlds that have none of their own.
        physics: Quantities of the worlds.
    """
    delay = _own(physics.goal_delay_s, control.goal_delay_s)
    time = _own(physics.smoothing_s, control.smoothing_s)
    wanted = _commanded(goal, next_world, substep, control.goal, delay)
    if is_off(time):
        return goal, wanted
    smooth = goal.smooth_world + STEP_S / (time + STEP_S) * (wanted - goal.smooth_world)
    return replace(goal, smooth_world=smooth), smooth


def _own(drawn: Any, constant: float) -> Any:
    """Return a world's own value with an axis for the components, or the constant."""
    return constant if drawn is None else drawn[..., None]


def _commanded(goal: Goal, next_world, substep, mode: str, delay_s: Any) -> Float[Array, "*n k"]:
    """Return the commanded goal as it was ``delay_s`` ago, at most one action."""
    if is_off(delay_s):
        if mode == "step":
            return next_world
        return goal.now_world + (substep + 1) / SUBSTEPS * (next_world - goal.now_world)
    share = (substep + 1) / SUBSTEPS - delay_s / ACTION_S
    of_this = share > 0
    if mode == "step":
        return next_world * of_this + goal.now_world * (1 - of_this)
    here = goal.now_world + share * (next_world - goal.now_world)
    before = goal.now_world + share * (goal.now_world - goal.earlier_world)
    return here * of_this + before * (1 - of_this)
