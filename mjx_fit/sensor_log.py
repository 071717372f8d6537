"""A real attempt, as a robot logged it: plain arrays with sample times become what the sensors read.

The library reads wrenches at 500 Hz and everything else at 10 Hz, as ``Felt`` has them. A log may have any
rate of its own: 100 Hz to 1 kHz for the wrench, 10 Hz and more for the pose.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from mjx_fit.errors import RequestError
from mjx_fit.rates import ACTION_S, STEP_S, SUBSTEPS
from mjx_fit.robot import PANDA, Robot
from mjx_fit.types import Felt, Trace

MOST_GAP_S = 0.1
"""Longest time between two samples over which a value is interpolated."""
MOST_ACTIONS = 1000
LEAST_TARE_SAMPLES = 10
HEIGHT_M = (-0.1, 1.2)
"""Heights over the table at which a tip can be."""
MOST_OFF_UNIT = 0.01
"""Largest distance of a quaternion's length from 1."""

_SLACK = 1e-6


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


def felt_from_log(
    log: SensorLog, peg_type: int, estimate_world: Float[np.ndarray, "2"], robot: Robot = PANDA
) -> Felt:
    """What the sensors read of a log: its values at the times at which the library has them.

    Action j lasts from ``command_time_s[j]`` for 0.1 s. Its 50 wrenches are those at 0, 2, ..., 98 ms from
    there: linear interpolation up to 500 Hz, and above it the mean of the samples within 2 ms, with weights
    that fall linearly to 0. Its pose and twist are those at its end, by linear interpolation, and for the
    orientation along the great circle. No noise is added.

    Args:
        log: The attempt.
        peg_type: Index of the peg's shape.
        estimate_world: Where the attempt started: the estimate of the hole's centre, m.
        robot: Gives the workspace.

    Returns:
        One attempt, without batch axes.

    Raises:
        RequestError: An array has another shape, a number is not finite, time does not ascend, samples are
            more than 0.1 s apart, an orientation has no direction, or a position is outside the workspace, as
            in millimetres it would be. The message names the array and the time.

    Example:
        >>> import jax, numpy as np, mjx_fit as mf
        >>> rollouts = mf.make_engine("native").run(mf.draw_attempts(jax.random.key(0), 2), actions=3)
        >>> felt = rollouts.felt[0]
        >>> again = mf.felt_from_log(mf.log_from_felt(felt), int(felt.peg_type), felt.estimate_world)
        >>> np.allclose(again.trace.wrench_sensor, felt.trace.wrench_sensor)
        True
    """
    log = SensorLog(**{field.name: _array(field.name, getattr(log, field.name)) for field in fields(log)})
    _require_shapes(log)
    begins = _action_times(log.command_time_s)
    ends = begins + ACTION_S
    samples = (begins[:, None] + STEP_S * np.arange(SUBSTEPS)).ravel()
    for name, time, first, last in (
        ("wrench_time_s", log.wrench_time_s, samples[0], samples[-1]),
        ("pose_time_s", log.pose_time_s, ends[0], ends[-1]),
    ):
        _require_covered(name, time, first, last)
    _require_poses(log, robot)
    wrench = _resampled(log.wrench_time_s, log.wrench_sensor, samples)
    position = _interpolated(log.pose_time_s, log.tip_pos_world, ends)
    turns = Rotation.from_quat(log.tip_quat_world, scalar_first=True)
    inside = np.clip(ends, log.pose_time_s[0], log.pose_time_s[-1])
    quaternion = Slerp(log.pose_time_s, turns)(inside).as_quat(scalar_first=True)
    quaternion *= np.where(quaternion[:, 1:2] < 0, -1, 1)  # q and -q are one orientation; x is not negative
    linvel, angvel = _twist(log, turns)
    trace = Trace(
        wrench_sensor=_single(wrench.reshape(-1, SUBSTEPS, 6)),
        tip_pos_world=_single(position),
        tip_quat_world=_single(quaternion),
        tip_linvel_world=_single(_interpolated(log.pose_time_s, linvel, ends)),
        tip_angvel_world=_single(_interpolated(log.pose_time_s, angvel, ends)),
        action_world=_single(log.command_world),
    )
    length, peg = (np.array(number, np.int32) for number in (len(begins), peg_type))
    return Felt(trace, length, _tare(log), _single(estimate_world), peg)


def log_from_felt(felt: Felt, start_s: float = 0.0) -> SensorLog:
    """The log that a robot would have of a simulated attempt: 500 Hz wrenches, 10 Hz poses, no noise.

    Args:
        felt: One attempt, without batch axes.
        start_s: Time at which it begins.

    Example:
        >>> import jax, mjx_fit as mf
        >>> rollouts = mf.make_engine("native").run(mf.draw_attempts(jax.random.key(0), 2), actions=3)
        >>> mf.log_from_felt(rollouts.felt[0]).wrench_sensor.shape
        (150, 6)
    """
    length, trace = int(felt.length), felt.trace
    begins = start_s + ACTION_S * np.arange(length)
    return SensorLog(
        wrench_time_s=(begins[:, None] + STEP_S * np.arange(SUBSTEPS)).ravel(),
        wrench_sensor=np.asarray(trace.wrench_sensor)[:length].reshape(-1, 6),
        pose_time_s=begins + ACTION_S,
        tip_pos_world=np.asarray(trace.tip_pos_world)[:length],
        tip_quat_world=np.asarray(trace.tip_quat_world)[:length],
        command_time_s=begins,
        command_world=np.asarray(trace.action_world)[:length],
        tare_sensor=np.asarray(felt.tare_sensor),
        tip_linvel_world=np.asarray(trace.tip_linvel_world)[:length],
        tip_angvel_world=np.asarray(trace.tip_angvel_world)[:length],
    )


def _array(name: str, value: Any) -> Any:
    if value is None:
        return None
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise RequestError(
            f"log: {name}: {type(value).__name__} is not allowed: it must hold numbers"
        ) from None
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
            raise RequestError(f"log: {name}: shape {array.shape} is not allowed: it must be {shape}")
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
                f"log: {name}: {time[i + 1]:.6f} s after {time[i]:.6f} s is not allowed: times must ascend"
            )


def _action_times(command_time_s: Float[np.ndarray, "J"]) -> Float[np.ndarray, "J"]:
    """The begin of each action: on a grid of 0.1 s, within a fifth of which the commands must lie."""
    if len(command_time_s) > MOST_ACTIONS:
        raise RequestError(
            f"log: command_time_s: {len(command_time_s)} actions are not allowed: at most {MOST_ACTIONS}"
        )
    grid = command_time_s[0] + ACTION_S * np.arange(len(command_time_s))
    off = np.abs(command_time_s - grid)
    if off.max() > ACTION_S / 5:
        i = int(off.argmax())
        raise RequestError(
            f"log: command_time_s: {command_time_s[i]:.4f} s of action {i} is not allowed: actions begin "
            f"every {ACTION_S} s, this one at {grid[i]:.4f} s"
        )
    return grid


def _require_covered(name: str, time: Float[np.ndarray, "n"], first: float, last: float) -> None:
    """Make sure that no sample is missing for longer than can be interpolated, from first to last (s)."""
    inside = time[(time > first) & (time < last)]
    before, after = time[time <= first][-1:], time[time >= last][:1]
    ends = (before if len(before) else [first]), (after if len(after) else [last])
    marks = np.concatenate([ends[0], inside, ends[1]])
    gap = np.diff(marks)
    if len(gap) and gap.max() > MOST_GAP_S + _SLACK:
        i = int(gap.argmax())
        raise RequestError(
            f"log: {name}: no sample for {gap[i]:.3f} s from {marks[i]:.3f} s on: at most {MOST_GAP_S} s is "
            "interpolated"
        )


def _require_poses(log: SensorLog, robot: Robot) -> None:
    size = np.linalg.norm(log.tip_quat_world, axis=1)
    wrong = np.abs(size - 1) > MOST_OFF_UNIT
    if wrong.any():
        i = int(wrong.argmax())
        raise RequestError(
            f"log: tip_quat_world: a quaternion of length {size[i]:.4g} at {log.pose_time_s[i]:.3f} s is not "
            f"allowed: its length must be 1 within {MOST_OFF_UNIT:.0%}"
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


def _resampled(
    time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n k"], at: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m k"]:
    """Means with triangular weights that end a step away; linear interpolation where samples are rarer.

    The weights of evenly spaced samples at 500 Hz are those of linear interpolation.
    """
    origin = time[0]
    sums = np.cumsum(np.column_stack([np.ones_like(time), values]), axis=0)
    moments = np.cumsum((time - origin)[:, None] * np.column_stack([np.ones_like(time), values]), axis=0)
    sums, moments = (np.vstack([np.zeros((1, table.shape[1])), table]) for table in (sums, moments))
    first, middle, last = (np.searchsorted(time, at + shift) for shift in (-STEP_S, 0.0, STEP_S))
    offset = (at - origin)[:, None]
    rising = (moments[middle] - moments[first]) - (offset - STEP_S) * (sums[middle] - sums[first])
    falling = (offset + STEP_S) * (sums[last] - sums[middle]) - (moments[last] - moments[middle])
    weighted = (rising + falling) / STEP_S
    dense = weighted[:, :1] > 1 + _SLACK
    mean = weighted[:, 1:] / np.where(dense, weighted[:, :1], 1)
    return np.where(dense, mean, _interpolated(time, values, at))


def _interpolated(
    time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n k"], at: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m k"]:
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def _twist(log: SensorLog, turns: Rotation) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "M 3"]]:
    """Linear (m/s) and angular (rad/s) velocity at the times of the poses."""
    time, linear, angular = log.pose_time_s, log.tip_linvel_world, log.tip_angvel_world
    if linear is None:
        linear = np.gradient(log.tip_pos_world, time, axis=0)
    if angular is None:
        rates = (turns[1:] * turns[:-1].inv()).as_rotvec() / np.diff(time)[:, None]
        angular = _interpolated((time[1:] + time[:-1]) / 2, rates, time)
    return linear, angular


def _tare(log: SensorLog) -> Float[np.ndarray, "6"]:
    if log.tare_sensor is not None:
        return _single(log.tare_sensor)
    if log.free_s is None:
        raise RequestError(
            "log: tare_sensor: none is not allowed: give the reading in free space, or free_s, a stretch "
            "without contact"
        )
    begin, end = log.free_s
    free = (log.wrench_time_s >= begin) & (log.wrench_time_s <= end)
    if free.sum() < LEAST_TARE_SAMPLES:
        raise RequestError(
            f"log: free_s: [{begin:.3f}, {end:.3f}] s is not allowed: {int(free.sum())} wrenches are in "
            f"it, and a tare needs {LEAST_TARE_SAMPLES}"
        )
    return _single(log.wrench_sensor[free].mean(0))


def _single(array: Any) -> Any:
    return np.asarray(array, np.float32)
