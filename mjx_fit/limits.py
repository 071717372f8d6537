"""How numbers of different sections bound each other, so that a peg stays pressed on its plate, and upright.

Measured with the native engine: attempts of both policies at the ends of the ranges and of these rules, one
at a time and together (tests/test_hostile_configs.py holds fifty of them).
"""

import math
from collections.abc import Iterator

from mjx_fit.errors import require
from mjx_fit.settings import ControlConfig, RandomConfig, SceneConfig, SpiralConfig

TORQUE_STEP_S = 0.002
MOST_DAMPING = 0.6
"""Share of a velocity that damping may take away in one such step."""
MOST_PUSH_MPS2 = 10.0
"""Stiffness over inertia times the push: four times the default, about 60 N."""
MOST_PULL_MPS2 = 36.0
"""Stiffness over inertia times how far a policy goes, or in one action if that is farther: pegs that were
caught on an edge tilted by 36° where it was 50, and by 3° at 36."""
MOST_STICKING_S = 0.04
"""Friction times the contact's time constant: pegs tilted by 11° where it was 0.06, by 2° below 0.04."""


def require_steady(
    scene: SceneConfig,
    control: ControlConfig,
    spiral: SpiralConfig,
    random: RandomConfig,
    attempt_actions: int,
) -> None:
    """Make sure that the controller is stable in steps of 2 ms, that a push is one, and that a peg slides.

    Raises:
        RequestError: Numbers that are allowed alone are not together.
    """
    for field, value, most, because in _rules(scene, control, spiral, random, attempt_actions):
        require(f"config: {field}", value, 0, round(most, 6), because)


def _rules(
    scene: SceneConfig,
    control: ControlConfig,
    spiral: SpiralConfig,
    random: RandomConfig,
    attempt_actions: int,
) -> Iterator[tuple[str, float, float, str]]:
    """Of each rule: the field, its value, the most that it may be, and why."""
    if scene.friction > 0:
        most = MOST_STICKING_S / scene.friction
        why = f"with scene.friction {scene.friction} a peg sticks to a softer plate and tips over"
        yield "scene.contact_time_s", scene.contact_time_s, most, why
    for name in ("kp_position", "kp_orientation"):
        kp = getattr(control, name)
        most = MOST_DAMPING / (2 * math.sqrt(kp) * TORQUE_STEP_S)
        why = f"with control.{name} {kp} more is unstable in steps of 2 ms"
        yield "control.damping_ratio", control.damping_ratio, most, why
    kp = control.kp_position
    for name, policy in (("spiral", spiral), ("random", random)):
        why = f"with control.kp_position {kp} more may press a peg askew"
        yield f"{name}.push_m", policy.push_m, MOST_PUSH_MPS2 / kp, why
        why = f"more than {name}.push_m lifts the peg off the plate"
        yield f"{name}.wiggle_m", policy.wiggle_m, policy.push_m, why
    # The goal may move by the diameter in a few actions, or even in one.
    leap = min(max(1.0, 2 * math.pi * spiral.turns / attempt_actions), 2.0)
    why = f"with control.kp_position {kp}, spiral.turns and the actions of an attempt a peg is pulled over"
    yield "spiral.radius_m", spiral.radius_m, MOST_PULL_MPS2 / kp / leap, why
    leap = max(1.0, 2 / random.actions_per_sweep)
    why = f"with control.kp_position {kp} and random.actions_per_sweep a peg is pulled over"
    yield "random.reach_m", random.reach_m, MOST_PULL_MPS2 / kp / leap, why
