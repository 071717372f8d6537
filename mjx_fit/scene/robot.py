"""Robots: all that the library needs to know of an arm, in one place. The Panda is the one that ships.

Another arm is another ``Robot`` in ``ROBOTS`` and its MJCF in ``models/``: hinges in a chain, each about the
z axis of its frame, with torque motors; a body ``peg`` that starts at the face of the force/torque sensor.
"""

from dataclasses import dataclass

Interval = tuple[float, float]


@dataclass(frozen=True)
class Robot:
    """An arm with a force/torque sensor at its wrist.

    Attributes:
        name: As in configurations.
        mjcf: File in ``models/``: the arm on its table.
        joints: Names of the joints, from the base to the wrist.
        posture_rad: Joint angles with the tool straight down and the peg's sides along the world's axes; the
            controller's null space goes to it, and inverse kinematics starts from it.
        turns: How many radians each joint of that posture turns for one of the bearing of the tip, so that
            the peg's sides stay along the world's axes.
        torque_limit_nm: Of each joint.
        tool_site: Site in the centre of the peg's lower face, added to the body ``peg``.
        workspace_m: Where hole centres are drawn: x and y, m from the base.
        hole_reach_m: Least and largest distance of a hole from the base: there the tip can be held straight
            down.
        estimate_reach_m: The same for an estimate, which may be wrong.
        home_m: Where the tip rests before an assembly, in pictures.
    """

    name: str
    mjcf: str
    joints: tuple[str, ...]
    posture_rad: tuple[float, ...]
    turns: tuple[float, ...]
    torque_limit_nm: tuple[float, ...]
    tool_site: str
    workspace_m: tuple[Interval, Interval]
    hole_reach_m: Interval
    estimate_reach_m: Interval
    home_m: tuple[float, float, float]


PANDA = Robot(
    name="panda",
    mjcf="table.xml",
    joints=tuple(f"joint{i}" for i in range(1, 8)),
    posture_rad=(0.0, 0.33, 0.0, -2.39, 0.0, 2.72, 0.0),
    turns=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    torque_limit_nm=(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0),
    tool_site="tip",
    workspace_m=((0.35, 0.65), (-0.3, 0.3)),
    hole_reach_m=(0.3, 0.82),
    estimate_reach_m=(0.2, 0.95),
    home_m=(0.45, 0.0, 0.28),
)
"""Franka Emika Panda with a Robotiq FT 300-S."""

ROBOTS = {robot.name: robot for robot in (PANDA,)}
