"""Signals of a log in the library's units, frames and signs, as its map says."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from mjx_fit.config.schema import Config
from mjx_fit.control.operational_space import GRAVITY_MPS2
from mjx_fit.data.logs.arm import tool_poses
from mjx_fit.data.logs.log_map import FrameMap, LogMap
from mjx_fit.data.logs.raw_log import RawLog, Stream
from mjx_fit.scene.robot import ROBOTS
from mjx_fit.utils.errors import RequestError

FORCE_N = {"N": 1.0, "lbf": 4.4482216152605}
_TORQUE_NM = {"N m": 1.0, "N mm": 1e-3, "lbf in": 0.1129848290276167}
_METRES = {"m": 1.0, "mm": 1e-3}
LEAST_NORM, MOST_NORM = 0.98, 1.02
"""Range of a quaternion's norm, which is rounded where a log has few digits."""


@dataclass(frozen=True)
class Signals:
    """What a robot measured and commanded; times in s.

    Attributes:
        wrench_time_s: Times of wrenches (N,).
        wrench_sensor: Force (N) and torque (N m) of the arm on the peg (N, 6), as in ``SensorLog``.
        pose_time_s: Times of poses (M,).
        tip_pos_world: Position of the TCP (M, 3), m.
        turns: Orientation of the TCP, M rotations.
        command_time_s: Start times of the actions (J,); None: the log has no commands.
        command_world: Commanded displacements of the TCP (J, 3), m.
        linvel_world: Linear velocity of the TCP at the times of the poses (M, 3), m/s; None: not in the log.
        angvel_world: Angular velocity likewise, rad/s.
    """

    wrench_time_s: Float[np.ndarray, "N"]
    wrench_sensor: Float[np.ndarray, "N 6"]
    pose_time_s: Float[np.ndarray, "M"]
    tip_pos_world: Float[np.ndarray, "M 3"]
    turns: Rotation
    command_time_s: Float[np.ndarray, "J"] | None = None
    command_world: Float[np.ndarray, "J 3"] | None = None
    linvel_world: Float[np.ndarray, "M 3"] | None = None
    angvel_world: Float[np.ndarray, "M 3"] | None = None


def signals_of(raw: RawLog, said: LogMap, config: Config) -> Signals:
    """Convert a log.

    Args:
        raw: The log, with samples in order.
        said: Its map.
        config: Defines the arm, and the distance from the library's sensor to the TCP: torques are about that
            point.

    Raises:
        RequestError: A signal has another number of values, or a quaternion is none.
    """
    pose = raw.streams["pose"]
    position, turns = _poses(raw, said, config)
    wrench = raw.streams["wrench"]
    _require_width(raw, "wrench", wrench, (6,))
    here = Slerp(pose.time_s, turns)(np.clip(wrench.time_s, pose.time_s[0], pose.time_s[-1]))
    felt = _felt(wrench, said, here, config.scene.peg_length_m)
    commands = (None, None)
    if "command" in raw.streams:
        commands = raw.streams["command"].time_s, _commands(raw, said, Stream(pose.time_s, position))
    twist = _twist(raw, said, pose.time_s, turns) if "twist" in raw.streams else (None, None)
    return Signals(wrench.time_s, felt, pose.time_s, position, turns, *commands, *twist)


def _poses(raw: RawLog, said: LogMap, config: Config) -> tuple[Float[np.ndarray, "M 3"], Rotation]:
    """Return positions and orientations of the TCP in the world."""
    own = said.pose
    if own.rotation == "joints":
        stream = raw.streams["pose"]
        _require_width(raw, "pose", stream, (len(ROBOTS[config.scene.robot].joints),))
        angles = np.deg2rad(stream.values) if own.angle == "deg" else stream.values
        at, measured = tool_poses(angles, config)
    else:
        at, measured = _written_poses(raw, said)
    base, tool = (_rigid(one) for one in (own.base_in_world, own.tool_in_pose))
    return base[0] + base[1].apply(at + measured.apply(tool[0])), base[1] * measured * tool[1]


def _written_poses(raw: RawLog, said: LogMap) -> tuple[Float[np.ndarray, "M 3"], Rotation]:
    """Return positions, m, and orientations as the log has them."""
    values, own = raw.streams["pose"].values, said.pose
    kind = "quat_xyzw" if raw.quaternions_xyzw else own.rotation
    quaternions = kind.startswith("quat")
    _require_width(raw, "pose", raw.streams["pose"], (7,) if quaternions else (6,))
    rest = values[:, 3:]
    if quaternions:
        norm = np.linalg.norm(rest, axis=1)
        wrong = (norm < LEAST_NORM) | (norm > MOST_NORM)
        if wrong.any():
            i = int(wrong.argmax())
            raise RequestError(
                f"{raw.name}: pose: a quaternion of norm {norm[i]:.3g} at "
                f"{raw.streams['pose'].time_s[i]:.3f} s is invalid: expected 1: are these its columns?"
            )
        measured = Rotation.from_quat(rest, scalar_first=kind == "quat_wxyz")
    else:
        angles = np.deg2rad(rest) if own.angle == "deg" else rest
        measured = Rotation.from_rotvec(angles) if kind == "rotvec" else Rotation.from_euler("xyz", angles)
    return _METRES[own.length] * values[:, :3], measured


def _rigid(one: FrameMap) -> tuple[Float[np.ndarray, "3"], Rotation]:
    return np.asarray(one.position_m), Rotation.from_euler("xyz", one.rpy_deg, degrees=True)


def _felt(wrench: Stream, said: LogMap, turns: Rotation, lever_m: float) -> Float[np.ndarray, "N 6"]:
    """Return wrenches of the arm on the peg, in the axes of the tool and about the library's sensor.

    ``turns`` are the tool's orientations at the times of the wrenches.
    """
    own = said.wrench
    sign = 1.0 if own.acts_on == "peg" else -1.0
    force = sign * FORCE_N[own.force] * wrench.values[:, :3]
    torque = sign * _TORQUE_NM[own.torque] * wrench.values[:, 3:]
    origin, in_tool = _rigid(own.sensor_in_tool)
    base = _rigid(said.pose.base_in_world)[1]
    world_to_tool = turns.inv()
    axes = world_to_tool * base if own.axes == "base" else in_tool
    force, torque = np.asarray(axes.apply(force)), np.asarray(axes.apply(torque))
    if said.load is not None:
        # The arm holds the load up; that is no contact.
        held = np.asarray(world_to_tool.apply([0.0, 0.0, said.load.mass_kg * GRAVITY_MPS2]))
        force = force - held
        torque = torque - np.cross(in_tool.apply(said.load.centre_m), held)
    # The same wrench about another point: the sensor of the library is lever_m above the TCP.
    away = origin - np.array([0.0, 0.0, -lever_m])
    return np.column_stack([force, torque + np.cross(away, force)])


def _commands(raw: RawLog, said: LogMap, at: Stream) -> Float[np.ndarray, "J 3"]:
    """Return the commanded displacements of the TCP in the world, m."""
    stream, own = raw.streams["command"], said.command
    assert own is not None
    _require_width(raw, "command", stream, (3,))
    origin, base = _rigid(said.pose.base_in_world)
    values = base.apply(_METRES[own.length] * stream.values)
    if own.kind == "displacement":
        return values
    here = np.column_stack([np.interp(stream.time_s, at.time_s, column) for column in at.values.T])
    return values + origin - here


def _twist(
    raw: RawLog, said: LogMap, time_s: Float[np.ndarray, "M"], turns: Rotation
) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "M 3"]]:
    """Return linear and angular velocity in the world at the times of the poses."""
    stream, own = raw.streams["twist"], said.twist
    assert own is not None
    _require_width(raw, "twist", stream, (6,))
    values = np.column_stack([np.interp(time_s, stream.time_s, column) for column in stream.values.T])
    axes = turns if own.axes == "tool" else _rigid(said.pose.base_in_world)[1]
    angular = np.deg2rad(values[:, 3:]) if own.angle == "deg" else values[:, 3:]
    return np.asarray(axes.apply(_METRES[own.length] * values[:, :3])), np.asarray(axes.apply(angular))


def _require_width(raw: RawLog, name: str, stream: Stream, widths: tuple[int, ...]) -> None:
    k = stream.values.shape[1]
    if k not in widths:
        expected = " or ".join(str(width) for width in widths)
        raise RequestError(f"{raw.name}: {name}: {k} values are invalid: expected {expected}")
