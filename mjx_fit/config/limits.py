"""How numbers of different sections bound each other, so that a peg stays pressed on its plate, and upright.

Measured with the native engine, a few dozen attempts of either policy for each of some hundred settings, at
the ends of the ranges and of these rules, one at a time and together.
"""

import math
from collections.abc import Iterator

from mjx_fit.config.sections.task import TaskConfig
from mjx_fit.config.sections.world import ControlConfig, RandomConfig, SceneConfig, SpiralConfig
from mjx_fit.utils.errors import require, shown
from mjx_fit.utils.rates import STEP_S

MOST_DAMPING = 0.6
"""Share of a velocity that damping may take away in one such step."""
MOST_PUSH_MPS2 = 10.0
"""Stiffness over inertia times the push: four times the default, about 60 N."""
MOST_STICKING_S = 0.04
"""Friction times the contact's time constant: pegs tilted by 11° where it was 0.06, by 2° below 0.04."""
SAFE_PULL_MPS2, MOST_PULL_MPS2, MOST_PULL_BY_STICKING = 16.0, 30.0, 36.0
"""Stiffness over inertia times how far a policy goes from the estimate, or in one action if that is farther:
it pulls at a peg that friction or an edge holds until the joints' torque limits let it tilt. Up to the first
none did by more than 4°; up to the second they did where much friction and push held them: 17° where the
product of pull, friction and push (an acceleration, too) was 90, 38° where it was 59."""


def require_steady(
    scene: SceneConfig, control: ControlConfig, spiral: SpiralConfig, random: RandomConfig, task: TaskConfig
) -> None:
    """Make sure that the controller is stable in steps of 2 ms, that a push is one, and that a spiral slides.

    Raises:
        RequestError: Numbers that are allowed alone are not together.
    """
    for field, value, most, because in _rules(scene, control, spiral, random):
        require(f"config: {field}", value, 0, round(most, 6), because)
    leap = min(max(1.0, 2 * math.pi * spiral.turns / task.attempt_actions), 2.0)
    _require_upright(scene, control, spiral.push_m, "spiral.radius_m", spiral.radius_m, leap)


def require_random_upright(scene: SceneConfig, control: ControlConfig, random: RandomConfig) -> None:
    """Make sure that the sweeps of the random policy, where it is used, pull no peg over.

    Raises:
        RequestError: They go too far for this controller and this friction.
    """
    leap = max(1.0, 2 / random.actions_per_sweep)
    _require_upright(scene, control, random.push_m, "random.reach_m", random.reach_m, leap)


def require_one_for_each_shape(field: str, values: tuple, scene: SceneConfig) -> None:
    """Make sure that a list has an entry for each of ``scene.shapes``.

    Raises:
        ValueError: It has more or fewer.
    """
    if len(values) != scene.n_types:
        raise ValueError(
            f"{field}: {shown(list(values))} is invalid: it must have an entry for each of scene.shapes "
            f"({scene.n_types}), or be null for the default"
        )


def _rules(
    scene: SceneConfig, control: ControlConfig, spiral: SpiralConfig, random: RandomConfig
) -> Iterator[tuple[str, float, float, str]]:
    """Of each rule: the field, its value, the most that it may be, and why."""
    if scene.friction > 0:
        most = MOST_STICKING_S / scene.friction
        why = f"with scene.friction {scene.friction} a peg sticks to a softer plate and tips over"
        yield "scene.contact_time_s", scene.contact_time_s, most, why
    for name in ("kp_position", "kp_orientation"):
        kp = getattr(control, name)
        most = MOST_DAMPING / (2 * math.sqrt(kp) * STEP_S)
        why = f"with control.{name} {kp} more is unstable in steps of 2 ms"
        yield "control.damping_ratio", control.damping_ratio, most, why
    kp = control.kp_position
    for name, policy in (("spiral", spiral), ("random", random)):
        why = f"with control.kp_position {kp} more may press a peg askew"
        yield f"{name}.push_m", policy.push_m, MOST_PUSH_MPS2 / kp, why
        why = f"more than {name}.push_m lifts the peg off the plate"
        yield f"{name}.wiggle_m", policy.wiggle_m, policy.push_m, why


def _require_upright(
    scene: SceneConfig, control: ControlConfig, push_m: float, field: str, reach_m: float, leap: float
) -> None:
    """Make sure that no peg is pulled over.

    Args:
        scene: Has the friction.
        control: Has the stiffness.
        push_m: Of the policy.
        field: What says how far it goes from the estimate.
        reach_m: How far that is.
        leap: How far its goal may move in one action, as a multiple of that; at least 1.
    """
    kp = control.kp_position
    sticking = scene.friction * kp * push_m
    pull = max(SAFE_PULL_MPS2, min(MOST_PULL_MPS2, MOST_PULL_BY_STICKING / max(sticking, 1e-3)))
    why = f"with control.kp_position {kp} and scene.friction {scene.friction} a peg is pulled over"
    require(f"config: {field}", reach_m, 0, round(pull / kp / leap, 6), why)
