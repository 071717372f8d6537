"""Bounds across configuration sections that keep the peg pressed on its socket, and upright.

They were measured with the native engine: a few dozen attempts of either policy for each of about a hundred
settings, at the ends of the ranges and of these rules, one at a time and combined.
"""

import math
from collections.abc import Iterator

from mjx_fit.config.sections.scene import LEAST_CONTACT_TIME_S, SceneConfig
from mjx_fit.config.sections.task import TaskConfig
from mjx_fit.config.sections.world import ControlConfig, RandomConfig, SpiralConfig
from mjx_fit.utils.errors import require, shown
from mjx_fit.utils.rates import STEP_S

MOST_DAMPING = 0.6
"""Largest share of a velocity that damping may remove in one simulation step."""
MOST_DRAG_NSPM = 800.0
"""Largest force of a push over its speed in free space, N·s/m: the force on a socket was steady up to it, for
contact times of 4 to 30 ms (tests/engines/test_press.py)."""
ABOVE_FLOOR_M = 0.001
"""Least distance between the depth of an insertion and the floor of the hole, m."""
MOST_PUSH_MPS2 = 10.0
"""Largest stiffness over inertia times push: four times the default, about 60 N."""
MOST_STICKING_S = 0.04
"""Largest friction times contact time constant: pegs tilted by 11° at 0.06, by 2° below 0.04."""
SAFE_PULL_MPS2, MOST_PULL_MPS2, MOST_PULL_BY_STICKING = 16.0, 30.0, 36.0
"""Limits of the pull: stiffness over inertia times the larger of a policy's reach and its step per action.

A peg held by friction or an edge is pulled until the joints' torque limits let it tilt. Up to the first limit
no peg tilted by more than 4°. Up to the second, pegs tilted under high friction and push: by 17° where the
product of pull, friction and push (also an acceleration) was 90, by 38° where it was 59."""


def require_steady(
    scene: SceneConfig, control: ControlConfig, spiral: SpiralConfig, random: RandomConfig, task: TaskConfig
) -> None:
    """Check that the controller is stable, pushes keep contact, spirals slide, and insertions end in time.

    Raises:
        RequestError: Values that are valid on their own are invalid in combination.
    """
    for field, value, most, because in _rules(scene, control, spiral, random):
        require(f"config: {field}", value, 0, round(most, 6), because)
    shortest = min(scene.contact_time_of(shape) for shape in scene.shapes)
    per_gap = scene.contact_time_per_gap
    least = round(per_gap * LEAST_CONTACT_TIME_S / shortest, 6)
    why = f"a contact time of {shortest:.6g} s must be at least {LEAST_CONTACT_TIME_S}"
    require("config: scene.contact_time_per_gap", per_gap, min(least, 100), 100, why)
    why = f"a contact time of {shortest:.6g} s must last two steps"
    require("config: scene.steps_per_torque", scene.physics_steps, scene.least_physics_steps, 20, why)
    most = round(scene.hole_depth_m - ABOVE_FLOOR_M, 6)
    why = f"with scene.hole_depth_m {scene.hole_depth_m} the peg stands on the floor"
    require("config: task.insertion_depth_m", task.insertion_depth_m, 0, most, why)
    if task.success == "sensed":
        why = f"with task.insertion_depth_m {task.insertion_depth_m} the peg stands on the floor"
        most = round(most - task.insertion_depth_m, 6)
        require("config: task.sensed_margin_m", task.sensed_margin_m, 0, most, why)
    leap = min(max(1.0, 2 * math.pi * spiral.turns / task.attempt_actions), 2.0)
    _require_upright(scene, control, spiral.push_m, "spiral.radius_m", spiral.radius_m, leap)


def require_random_upright(scene: SceneConfig, control: ControlConfig, random: RandomConfig) -> None:
    """Check that the sweeps of the random policy do not tip the peg over; for runs that use this policy.

    Raises:
        RequestError: The sweeps reach too far for this controller and this friction.
    """
    leap = max(1.0, 2 / random.actions_per_sweep)
    _require_upright(scene, control, random.push_m, "random.reach_m", random.reach_m, leap)


def require_one_for_each_shape(field: str, values: tuple, scene: SceneConfig) -> None:
    """Check that a list has one entry for each of ``scene.shapes``.

    Raises:
        ValueError: The list has more or fewer entries.
    """
    if len(values) != scene.n_types:
        raise ValueError(
            f"{field}: {shown(list(values))} is invalid: expected one entry for each of scene.shapes "
            f"({scene.n_types}), or null for the default"
        )


def _rules(
    scene: SceneConfig, control: ControlConfig, spiral: SpiralConfig, random: RandomConfig
) -> Iterator[tuple[str, float, float, str]]:
    """Yield the rules as tuples of field, value, largest allowed value, and reason."""
    if scene.friction > 0:
        most = MOST_STICKING_S / scene.friction
        why = f"with scene.friction {scene.friction} the peg sticks to a softer socket and tips over"
        yield "scene.contact_time_s", scene.contact_time_s, most, why
    for name in ("kp_position", "kp_orientation"):
        kp = getattr(control, name)
        most = MOST_DAMPING / (2 * math.sqrt(kp) * STEP_S)
        why = f"with control.{name} {kp} higher damping is unstable in steps of 2 ms"
        yield "control.damping_ratio", control.damping_ratio, most, why
    if control.push == "force":
        why = f"with control.press_speed_mps {control.press_speed_mps} a stronger push is unstable"
        yield "control.press_n", control.press_n, MOST_DRAG_NSPM * control.press_speed_mps, why
    kp = control.kp_position
    for name, policy in (("spiral", spiral), ("random", random)):
        why = f"with control.kp_position {kp} a stronger push may tilt the peg"
        yield f"{name}.push_m", policy.push_m, MOST_PUSH_MPS2 / kp, why
        why = f"noise above {name}.push_m lifts the peg off the socket"
        yield f"{name}.wiggle_m", policy.wiggle_m, policy.push_m, why


def _require_upright(
    scene: SceneConfig, control: ControlConfig, push_m: float, field: str, reach_m: float, leap: float
) -> None:
    """Check that the pull of a policy does not tip the peg over.

    Args:
        scene: Scene with the friction.
        control: Controller with the stiffness.
        push_m: Push depth of the policy, m.
        field: Key that sets the reach of the policy.
        reach_m: Largest distance of the policy's goal from the estimate, m.
        leap: Largest motion of the goal in one action, as a multiple of the reach; at least 1.
    """
    kp = control.kp_position
    sticking = scene.friction * kp * push_m
    pull = max(SAFE_PULL_MPS2, min(MOST_PULL_MPS2, MOST_PULL_BY_STICKING / max(sticking, 1e-3)))
    why = f"with control.kp_position {kp} and scene.friction {scene.friction} the peg tips over"
    require(f"config: {field}", reach_m, 0, round(pull / kp / leap, 6), why)
