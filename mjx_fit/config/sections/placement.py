"""Configuration section of poses: how the socket stands, and how the hand holds the peg."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import STRICT

Height = Annotated[float, Field(ge=-0.02, le=0.02)]
Shift = Annotated[float, Field(ge=-0.01, le=0.01)]
Yaw = Annotated[float, Field(ge=-0.6, le=0.6)]
Lean = Annotated[float, Field(ge=-0.2, le=0.2)]


@dataclass(frozen=True, config=STRICT)
class PlacementConfig:
    """Poses of socket and peg that the robot does not know; by default upright and straight.

    Rotations are by yaw about z, after pitch about y, after roll about x. The socket turns about the centre
    of its hole, in the world's axes. The peg turns about the centre of its lower face, in the axes of the
    nominal TCP, whose z axis points down: the TCP that the robot's kinematics report.

    Attributes:
        socket_z_m: Socket's height. It adds to that of the plate.
        socket_roll_rad: Socket's roll.
        socket_pitch_rad: Socket's pitch.
        socket_yaw_rad: Socket's yaw.
        grasp_x_m: Peg's shift in the hand. Along x.
        grasp_y_m: Peg's shift. Along y.
        grasp_z_m: Peg's shift. Along z.
        grasp_roll_rad: Peg's roll.
        grasp_pitch_rad: Peg's pitch.
        grasp_yaw_rad: Peg's yaw.
        grip_n: Force at which the peg slips. In the hand, during attempts (``mjx_fit.scene.slip``); 0: it
            never does.
        grip_nm: Torque at which it slips. About the fingers.
        slip_mps: Speed at twice the grip. The peg slips at this speed under twice the force that is held.
    """

    socket_z_m: Height = 0.0
    socket_roll_rad: Lean = 0.0
    socket_pitch_rad: Lean = 0.0
    socket_yaw_rad: Yaw = 0.0
    grasp_x_m: Shift = 0.0
    grasp_y_m: Shift = 0.0
    grasp_z_m: Shift = 0.0
    grasp_roll_rad: Lean = 0.0
    grasp_pitch_rad: Lean = 0.0
    grasp_yaw_rad: Yaw = 0.0
    grip_n: Annotated[float, Field(ge=0, le=1000)] = 0.0
    grip_nm: Annotated[float, Field(ge=0.01, le=100)] = 1.0
    slip_mps: Annotated[float, Field(ge=0.0001, le=0.1, json_schema_extra={"unit": "m/s"})] = 0.01

    @property
    def slips(self) -> bool:
        """Whether pegs can slip in the hand."""
        return self.grip_n > 0
