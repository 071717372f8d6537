"""Robot descriptions: everything the library needs to know about an arm. The Panda is included.

Add an arm as another ``Robot`` in ``ROBOTS``, its name in ``config.sections.scene.RobotName`` and its MJCF in
``models/``: a chain of hinges, each about its z axis, with torque motors, and a body ``peg`` that
starts at the face of the F/T sensor.
"""

from dataclasses import dataclass

Interval = tuple[float, float]


@dataclass(frozen=True)
class Robot:
    """Arm with a wrist force/torque (F/T) sensor.

    Attributes:
        name: Name in configurations.
        mjcf: File in ``models/`` with the arm on its table.
        joints: Names of the joints, from the base to the wrist.
        posture_rad: Joint angles with the tool straight down and the peg's sides along the world axes; target
            of the controller's null space and initial value of inverse kinematics.
        turns: Rotation of each joint of that posture per rotation of the TCP's bearing (rad/rad) that keeps
            the peg's sides along the world axes.
        torque_limit_nm: Torque limit of each joint.
        tool_site: Site in the centre of the peg's lower face, added to the body ``peg``.
        workspace_m: Region in which hole centres are drawn: x and y intervals, m from the base.
        hole_reach_m: Smallest and largest distance of a hole from the base at which the tool can point
            straight down.
        estimate_reach_m: Smallest and largest distance of an estimate, which may be wrong, from the base.
        home_m: Rest position of the TCP before an assembly, in renderings.
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
"""Franka Emika Panda with a Robotiq FT 300-S F/T sensor."""

ROBOTS = {robot.name: robot for robot in (PANDA,)}
