"""How far an attempt may go and still be believed; beyond, its world is stopped like one that diverged.

The physics is a model of a peg that stands nearly upright on its plate, and of an arm that has the torque it
needs. The bounds lie outside of what attempts with the default configuration meet. In 1,000 spirals the
largest tilt was 0.6 degrees, the tip kept 42 mm from the plate's edge and no joint met its limit. In 700
random attempts of 200 actions it kept 21 mm; four of them jammed at the edge of a hole, at a torque limit for
up to 6 actions, and one tilted by 28 degrees before it came free. That can happen, and is believed.
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.config.sections.world import SceneConfig
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.robot import Robot
from mjx_fit.types import Array, Rollout
from mjx_fit.utils.rates import ACTION_S

MOST_TILT_DEG = 45.0
"""Largest angle between the tip's orientation and straight down with its sides along the world's axes: up to
there, MJX takes boxes to touch as they do (``mjx_fit.engines.mjx.collision``)."""

BELOW_FLOOR_M = 0.002
"""How far below the floor of the hole the tip may be: contact yields, but not by more."""

LIMIT_ACTIONS = 20
"""Actions in a row, at the end of each of which some joint is at its torque limit, that are too many."""

# Straight down is the quaternion (0, 1, 0, 0), so x is the cosine of half the angle to it.
_LEAST_X = math.cos(math.radians(MOST_TILT_DEG) / 2)


def is_lost(
    tip_pos_world: Float[Array, "*n 3"],
    tip_quat_world: Float[Array, "*n 4"],
    hole_pos_world: Float[Array, "*n 2"],
    scene: SceneConfig,
) -> Bool[Array, "*n"]:
    """Whether pegs are tilted too far, beside their plate or below the floor of its hole.

    Args:
        tip_pos_world: Centre of the peg's lower face, m.
        tip_quat_world: Its orientation, with x not negative.
        hole_pos_world: True centre of the hole and of the plate, m.
        scene: Gives the plate's size.
    """
    tilted: Any = _is_tilted(tip_quat_world)
    return tilted | _has_left(tip_pos_world, hole_pos_world, scene)


def at_limit(torque: Float[Array, "*n joints"], robot: Robot) -> Bool[Array, "*n"]:
    """Whether some joint is given the largest torque (N·m) that it has."""
    limited: Any = abs(torque) >= np.array(robot.torque_limit_nm, np.float32)
    return limited.any(-1)


def actions_at_limit(before: Int[Array, "*n"], now: Bool[Array, "*n"]) -> Int[Array, "*n"]:
    """Number of actions in a row that ended at a torque limit, after one more action."""
    return (before + 1) * now


def reason(done: Rollout, i: int, scene: SceneConfig) -> str:
    """Says why interaction i of a batch is not valid: a clause that "in action 3" may follow."""
    trace, last = done.felt.trace, int(done.felt.length[i]) - 1
    position, quaternion = (np.asarray(leaf)[i, last] for leaf in (trace.tip_pos_world, trace.tip_quat_world))
    felt = position, quaternion, trace.wrench_sensor[i, last], trace.action_world[i, last]
    if not all(np.isfinite(leaf).all() for leaf in felt):
        return "the simulation turned non-finite"
    if _is_tilted(quaternion):
        angle = math.degrees(2 * math.acos(min(1.0, abs(float(quaternion[1])))))
        return f"the peg tilted by {angle:.1f} degrees (at most {MOST_TILT_DEG:.0f} are believed)"
    if _has_left(position, np.asarray(done.truth.hole_pos_world)[i], scene):
        return "the peg left the plate"
    if last + 1 >= LIMIT_ACTIONS:
        return f"a joint had been at its torque limit for {LIMIT_ACTIONS * ACTION_S:.1f} s"
    return "the simulation turned non-finite"


def _is_tilted(tip_quat_world: Float[Array, "*n 4"]) -> Bool[Array, "*n"]:
    return tip_quat_world[..., 1] < _LEAST_X


def _has_left(
    tip_pos_world: Float[Array, "*n 3"], hole_pos_world: Float[Array, "*n 2"], scene: SceneConfig
) -> Bool[Array, "*n"]:
    beside: Any = abs(tip_pos_world[..., :2] - hole_pos_world) > scene.plate_half_width_m
    return (
        beside[..., 0]
        | beside[..., 1]
        | (tip_pos_world[..., 2] < plate_top_m(scene) - scene.hole_depth_m - BELOW_FLOOR_M)
    )
