"""How numbers of different sections bound each other, so that a peg stays pressed on its plate, and upright.

Measured with the native engine: attempts of both policies at the ends of the ranges and of these rules, one
at a time and together (tests/test_hostile_configs.py holds fifty of them).
"""

import math

from mjx_fit.errors import require
from mjx_fit.settings import ControlConfig, RandomConfig, SceneConfig, SpiralConfig

TORQUE_STEP_S = 0.002
MOST_DAMPING = 0.6
MOST_PUSH_MPS2 = 10.0
MOST_PULL_MPS2 = 36.0
"""Stiffness over inertia times how far a policy goes: pegs tilted by 36° where it was 50, by 3° at 36."""
MOST_STICKING_S = 0.04
"""Friction times the contact's time constant: pegs tilted by 11° where it was 0.06, by 2° below 0.04."""


def require_steady(
    scene: SceneConfig, control: ControlConfig, spiral: SpiralConfig, random: RandomConfig
) -> None:
    """Make sure that the controller is stable in steps of 2 ms, that a push is one, and that a peg slides.

    Raises:
        RequestError: Numbers that are allowed alone are not together.
    """
    if scene.friction > 0:
        require(
            "config: scene.contact_time_s",
            scene.contact_time_s,
            0,
            round(MOST_STICKING_S / scene.friction, 6),
            f"with scene.friction {scene.friction} a peg sticks to softer plates and tips over",
        )
    for name in ("kp_position", "kp_orientation"):
        kp = getattr(control, name)
        most = MOST_DAMPING / (2 * math.sqrt(kp) * TORQUE_STEP_S)
        require(
            "config: control.damping_ratio",
            control.damping_ratio,
            0,
            round(most, 3),
            f"with control.{name} {kp} more is unstable in steps of 2 ms",
        )
    for name, policy in (("spiral", spiral), ("random", random)):
        require(
            f"config: {name}.push_m",
            policy.push_m,
            0,
            round(MOST_PUSH_MPS2 / control.kp_position, 6),
            f"with control.kp_position {control.kp_position} more was not measured to be held upright",
        )
        require(
            f"config: {name}.wiggle_m",
            policy.wiggle_m,
            0,
            policy.push_m,
            f"more than {name}.push_m lifts the peg off the plate",
        )
    for key, reach_m in (("spiral.radius_m", spiral.radius_m), ("random.reach_m", random.reach_m)):
        require(
            f"config: {key}",
            reach_m,
            0,
            round(MOST_PULL_MPS2 / control.kp_position, 6),
            f"with control.kp_position {control.kp_position} a peg that is caught on an edge is pulled over",
        )
