"""Log of an attempt on a real robot: plain arrays with sample times, and their validation."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from mjx_fit.scene.robot import Robot
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.rates import ACTION_S

MOST_GAP_S = 0.1
"""Longest gap between two samples that is bridged by interpolation, s."""
MOST_ACTIONS = 1000
HEIGHT_M = (-0.1, 1.2)
"""Range of possible TCP heights above the table, m."""
MOST_OFF_UNIT = 0.01
"""Largest deviation of a quaternion's norm from 1."""
SLACK = 1e-6


@dataclass(frozen=True)
class SensorLog:
    """Log of one attempt as arrays with sample times in s, on a common clock with any origin.

    Build it from keyword arguments, or from a file: ``SensorLog(**np.load("attempt.npz"))``.

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
        wrench_time_s: Sample times of the wrenches (N,), s.
        wrench_sensor: Force (N) and torque (N·m) that the arm exerts on the peg (N, 6), in the sensor frame
            (z along the tool, towards the TCP), not tared; pressing down makes F_z positive.
        pose_time_s: Sample times of the poses (M,), s.
        tip_pos_world: Position of the tool centre point (TCP), the centre of the peg's lower face, in the
            robot's base frame (M, 3), m.
        tip_quat_world: Orientation of the TCP (M, 4), w x y z.
        command_time_s: Start time of each action (J,), 0.1 s apart, s.
        command_world: Displacement of the TCP commanded by the policy in each action (J, 3), m.
        tare_sensor: F/T sensor reading in free space, at rest, just before the attempt (6,), N and N·m;
            alternatively give ``free_s``.
        free_s: Start and end of an interval without contact (2,), s; the mean of its samples is the tare.
        tip_linvel_world: Linear velocity of the TCP (M, 3), m/s; None: differentiated from the positions.
        tip_angvel_world: Angular velocity of the TCP (M, 3), rad/s; None: differentiated from the
            orientations.
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
    """Convert a log to NumPy float arrays and check their shapes, values and times.

    Raises:
        RequestError: A check fails; the message names the array.
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
        raise RequestError(f"log: {name}: {type(value).__name__} is invalid: expected numbers") from None
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
            raise RequestError(f"log: {name}: row {row} is invalid: expected finite numbers")
    for name, least in (("wrench", 2), ("pose", 2), ("command", 1)):
        if rows[name] < least:
            raise RequestError(
                f"log: {name}_time_s: too few samples ({rows[name]}): expected at least {least}"
            )
    for name in ("wrench_time_s", "pose_time_s"):
        time = getattr(log, name)
        back = np.flatnonzero(np.diff(time) <= 0)
        if len(back):
            i = int(back[0])
            raise RequestError(
                f"log: {name}: {time[i + 1]:.6f} s after {time[i]:.6f} s is invalid: times must increase"
            )


def action_times(command_time_s: Float[np.ndarray, "J"]) -> Float[np.ndarray, "J"]:
    """Return the start times of the actions on a 0.1 s grid, which commands must match within 0.02 s."""
    if len(command_time_s) > MOST_ACTIONS:
        raise RequestError(
            f"log: command_time_s: {len(command_time_s)} actions are too many: expected at most "
            f"{MOST_ACTIONS}"
        )
    grid = command_time_s[0] + ACTION_S * np.arange(len(command_time_s))
    off = np.abs(command_time_s - grid)
    if off.max() > ACTION_S / 5:
        i = int(off.argmax())
        raise RequestError(
            f"log: command_time_s: {command_time_s[i]:.4f} s of action {i} is invalid: expected "
            f"{grid[i]:.4f} s, since actions start every {ACTION_S} s"
        )
    return grid


def require_covered(name: str, time: Float[np.ndarray, "n"], first: float, last: float) -> None:
    """Check that samples from ``first`` to ``last`` (s) have no gap too long to interpolate."""
    slack = SLACK * ACTION_S  # clocks of logs are rounded
    inside = time[(time > first + slack) & (time < last - slack)]
    before, after = time[time <= first + slack][-1:], time[time >= last - slack][:1]
    ends = (before if len(before) else [first]), (after if len(after) else [last])
    marks = np.concatenate([ends[0], inside, ends[1]])
    gap = np.diff(marks)
    if len(gap) and gap.max() > MOST_GAP_S + SLACK:
        i = int(gap.argmax())
        raise RequestError(
            f"log: {name}: no sample for {gap[i]:.3f} s after {marks[i]:.3f} s: at most {MOST_GAP_S} s can "
            "be interpolated"
        )


def require_poses(log: SensorLog, robot: Robot) -> None:
    size = np.linalg.norm(log.tip_quat_world, axis=1)
    wrong = np.abs(size - 1) > MOST_OFF_UNIT
    if wrong.any():
        i = int(wrong.argmax())
        raise RequestError(
            f"log: tip_quat_world: a quaternion of norm {size[i]:.4g} at {log.pose_time_s[i]:.3f} s is "
            f"invalid: expected a norm of 1 within {MOST_OFF_UNIT:.0%}"
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
            f"workspace: expected metres, {low} to {high} from the base of {robot.name} and {HEIGHT_M[0]} to "
            f"{HEIGHT_M[1]} above the table"
        )
