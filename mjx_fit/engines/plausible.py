"""Bounds of physical plausibility; a world beyond them is stopped like a diverged simulation.

The physics models a peg that stands nearly upright on its socket and an arm with sufficient torque. Attempts
with the default configuration stay within the bounds. In 1,000 spirals the largest tilt was 0.6 degrees, the
TCP kept 42 mm from the socket's edge and no joint reached its torque limit. In 700 random attempts of 200
actions the TCP kept 21 mm from the edge; four attempts jammed at the edge of a hole, at a torque limit for up
to 6 actions, and one tilted by 28 degrees before it came free. Such motion is plausible and accepted.
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.robot import Robot
from mjx_fit.types import Array, Rollout
from mjx_fit.utils.rates import ACTION_S

MOST_TILT_DEG = 45.0
"""Maximum rotation of the TCP frame, degrees, from straight down with its sides along the world axes.

The collision model of MJX holds up to this angle (``mjx_fit.engines.mjx.collision``).
"""

BELOW_FLOOR_M = 0.002
"""Maximum depth of the TCP below the floor of the hole, m: contact compliance never reaches it."""

LIMIT_ACTIONS = 20
"""Number of consecutive actions with a joint at its torque limit that makes an attempt invalid."""

# Straight down is the quaternion (0, 1, 0, 0), so x is the cosine of half the angle to it.
_LEAST_X = math.cos(math.radians(MOST_TILT_DEG) / 2)


def is_lost(
    tip_pos_world: Float[Array, "*n 3"],
    tip_quat_world: Float[Array, "*n 4"],
    hole_pos_world: Float[Array, "*n 2"],
    scene: SceneConfig,
) -> Bool[Array, "*n"]:
    """Check whether a peg is tilted too far, outside its socket or below the floor of its hole.

    Args:
        tip_pos_world: TCP, the centre of the peg's lower face, m.
        tip_quat_world: Orientation of the TCP, with nonnegative x.
        hole_pos_world: True centre of the hole and of the socket, m.
        scene: Defines the size of the socket.
    """
    tilted: Any = _is_tilted(tip_quat_world)
    return tilted | _has_left(tip_pos_world, hole_pos_world, scene)


def at_limit(torque: Float[Array, "*n joints"], robot: Robot) -> Bool[Array, "*n"]:
    """Check whether any joint is at its torque limit (N·m)."""
    limited: Any = abs(torque) >= np.array(robot.torque_limit_nm, np.float32)
    return limited.any(-1)


def actions_at_limit(before: Int[Array, "*n"], now: Bool[Array, "*n"]) -> Int[Array, "*n"]:
    """Update the number of consecutive actions that ended at a torque limit."""
    return (before + 1) * now


def reason(done: Rollout, i: int, scene: SceneConfig) -> str:
    """Explain why rollout i of a batch is invalid, as a clause to be followed by "in action 3"."""
    trace, last = done.felt.trace, int(done.felt.length[i]) - 1
    position, quaternion = (np.asarray(leaf)[i, last] for leaf in (trace.tip_pos_world, trace.tip_quat_world))
    felt = position, quaternion, trace.wrench_sensor[i, last], trace.action_world[i, last]
    if not all(np.isfinite(leaf).all() for leaf in felt):
        return "the simulation turned non-finite"
    if _is_tilted(quaternion):
        angle = math.degrees(2 * math.acos(min(1.0, abs(float(quaternion[1])))))
        return f"the peg tilted by {angle:.1f} degrees (at most {MOST_TILT_DEG:.0f} are plausible)"
    if _has_left(position, np.asarray(done.truth.hole_pos_world)[i], scene):
        return "the peg left the socket"
    if last + 1 >= LIMIT_ACTIONS:
        return f"a joint reached {LIMIT_ACTIONS * ACTION_S:.1f} s at its torque limit"
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
