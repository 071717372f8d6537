"""A real attempt, as a robot logged it: plain arrays with sample times, and what they must be."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from mjx_fit.scene.robot import Robot
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.rates import ACTION_S

MOST_GAP_S = 0.1
"""Longest time between two samples over which a value is interpolated."""
MOST_ACTIONS = 1000
HEIGHT_M = (-0.1, 1.2)
"""Heights over the table at which a tip can be."""
MOST_OFF_UNIT = 0.01
"""Largest distance of a quaternion's length from 1."""
SLACK = 1e-6


@dataclass(frozen=True)
class SensorLog:
    """One attempt in arrays, each with the times of its samples, s, on one clock of any origin.

    Build it from keywords, or from a file: ``SensorLog(**np.load("attempt.npz"))``.

    Example:
        >>> import numpy as np, mjx_fit as mf
        >>> time = np.arange(0.0, 1.0, 0.01)
        >>> log = mf.SensorLog(
        ...     wrench_time_s=time,
        ...     wrench_sensor=np.zeros((100, 6)),
        ...     pose_time_s=time,
        ...     tip_pos_world=np.tile([0.5, 0.0, 0.05], (100, 1)),
        ...     tip_quat_world=np.tile([0.0, 1.0, 0.0, 0.0], (100, 1)),
        ...     command_time_s=np.arange(9) * 0.1,
        ...     command_world=np.zeros((9, 3)),
        ...     free_s=(0.0, 0.2),
        ... )

    Attributes:
        wrench_time_s: (N,).
        wrench_sensor: (N, 6), force (N) and torque (N·m) that the arm exerts on the peg, in the sensor's
            frame (z along the tool, towards the tip), not tared: to press down makes F_z positive.
        pose_time_s: (M,).
        tip_pos_world: (M, 3), centre of the peg's lower face in the frame of the robot's base, m.
        tip_quat_world: (M, 4), its orientation, w x y z.
        command_time_s: (J,), when each action began, 0.1 s after the one before.
        command_world: (J, 3), the displacement of the tip that the policy asked for in each action, m.
        tare_sensor: (6,), the reading in free space, at rest, just before the attempt; or give ``free_s``.
        free_s: (2,), begin and end of a stretch without contact; the mean of its samples is the tare.
        tip_linvel_world: (M, 3), m/s; None: differences of the positions.
        tip_angvel_world: (M, 3), rad/s; None: differences of the orientations.
    """

    wrench_time_s: Float[np.ndarray, "N"]
    wrench_sensor: Float[np.ndarray, "N 6"]
    pose_time_s: Float[np.ndarray, "M"]
    tip_pos_world: Float[np.ndarray, "M 3"]
    tip_quat_world: Float[np.ndarray, "M 4"]
    command_time_s: Float[np.ndarray, "J"]
    command_world: Float[np.ndarray, "J 3"]
    tare_sensor: Float[np.ndarray, "6"] | None = None
    free_s: Float[np.ndarray, "2"] | None = None
    tip_linvel_world: Float[np.ndarray, "M 3"] | None = None
    tip_angvel_world: Float[np.ndarray, "M 3"] | None = None


def require_log(log: SensorLog) -> SensorLog:
    """The log with NumPy arrays of floats, if their shapes, numbers and times are as they must be.

    Raises:
        RequestError: They are not; the message names the array.
    """
    log = SensorLog(**{field.name: _array(field.name, getattr(log, field.name)) for field in fields(log)})
    _require_shapes(log)
    return log


def _array(name: str, value: Any) -> Any:
    if value is None:
        return None
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise RequestError(f"log: {name}: {type(value).__name__} is invalid: it must hold numbers") from None
    return array


def _require_shapes(log: SensorLog) -> None:
    rows = {"wrench": np.size(log.wrench_time_s), "pose": np.size(log.pose_time_s)}
    rows["command"] = np.size(log.command_time_s)
    shapes = {
        **{f"{name}_time_s": (count,) for name, count in rows.items()},
        "wrench_sensor": (rows["wrench"], 6),
        "tip_pos_world": (rows["pose"], 3),
        "tip_quat_world": (rows["pose"], 4),
        "command_world": (rows["command"], 3),
        "tare_sensor": (6,),
        "free_s": (2,),
        "tip_linvel_world": (rows["pose"], 3),
        "tip_angvel_world": (rows["pose"], 3),
    }
    for name, shape in shapes.items():
        array = getattr(log, name)
        if array is None:
            continue
        if array.shape != shape:
            raise RequestError(f"log: {name}: shape {array.shape} is invalid: expected {shape}")
        if not np.isfinite(array).all():
            row = int(np.argwhere(~np.isfinite(array))[0][0])
            raise RequestError(f"log: {name}: row {row} is not finite: all numbers must be")
    for name, least in (("wrench", 2), ("pose", 2), ("command", 1)):
        if rows[name] < least:
            raise RequestError(
                f"log: {name}_time_s: {rows[name]} samples are not enough: give {least} or more"
            )
    for name in ("wrench_time_s", "pose_time_s"):
        time = getattr(log, name)
        back = np.flatnonzero(np.diff(time) <= 0)
        if len(back):
            i = int(back[0])
            raise RequestError(
                f"log: {name}: {time[i + 1]:.6f} s after {time[i]:.6f} s cannot be used: times must ascend"
            )


def action_times(command_time_s: Float[np.ndarray, "J"]) -> Float[np.ndarray, "J"]:
    """The begin of each action: on a grid of 0.1 s, within a fifth of which the commands must lie."""
    if len(command_time_s) > MOST_ACTIONS:
        raise RequestError(
            f"log: command_time_s: {len(command_time_s)} actions cannot be used: at most {MOST_ACTIONS}"
        )
    grid = command_time_s[0] + ACTION_S * np.arange(len(command_time_s))
    off = np.abs(command_time_s - grid)
    if off.max() > ACTION_S / 5:
        i = int(off.argmax())
        raise RequestError(
            f"log: command_time_s: {command_time_s[i]:.4f} s of action {i} cannot be used: actions begin "
            f"every {ACTION_S} s, this one at {grid[i]:.4f} s"
        )
    return grid


def require_covered(name: str, time: Float[np.ndarray, "n"], first: float, last: float) -> None:
    """Make sure that no sample is missing for longer than can be interpolated, from first to last (s)."""
    inside = time[(time > first) & (time < last)]
    before, after = time[time <= first][-1:], time[time >= last][:1]
    ends = (before if len(before) else [first]), (after if len(after) else [last])
    marks = np.concatenate([ends[0], inside, ends[1]])
    gap = np.diff(marks)
    if len(gap) and gap.max() > MOST_GAP_S + SLACK:
        i = int(gap.argmax())
        raise RequestError(
            f"log: {name}: no sample for {gap[i]:.3f} s from {marks[i]:.3f} s on: at most {MOST_GAP_S} s is "
            "interpolated"
        )


def require_poses(log: SensorLog, robot: Robot) -> None:
    size = np.linalg.norm(log.tip_quat_world, axis=1)
    wrong = np.abs(size - 1) > MOST_OFF_UNIT
    if wrong.any():
        i = int(wrong.argmax())
        raise RequestError(
            f"log: tip_quat_world: a quaternion of length {size[i]:.4g} at {log.pose_time_s[i]:.3f} s cannot "
            f"be used: its length must be 1 within {MOST_OFF_UNIT:.0%}"
        )
    low, high = robot.estimate_reach_m
    distance = np.linalg.norm(log.tip_pos_world[:, :2], axis=1)
    height = log.tip_pos_world[:, 2]
    wrong = (distance < low) | (distance > high) | (height < HEIGHT_M[0]) | (height > HEIGHT_M[1])
    if wrong.any():
        i = int(wrong.argmax())
        x, y, z = log.tip_pos_world[i]
        raise RequestError(
            f"log: tip_pos_world: ({x:.4g}, {y:.4g}, {z:.4g}) at {log.pose_time_s[i]:.3f} s is outside the "
            f"workspace: it must be in metres, {low} to {high} from the base of {robot.name} and "
            f"{HEIGHT_M[0]} to {HEIGHT_M[1]} high"
        )
