"""Resampling of a robot's log to the library's sample times, and the inverse conversion.

The library uses wrenches at 500 Hz and everything else at 10 Hz, the format of ``Felt``. Logs may have other
rates: 100 Hz to 1 kHz for the wrench, 10 Hz or more for the pose.
"""

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from mjx_fit.config.schema import Config
from mjx_fit.scene.robot import PANDA, Robot
from mjx_fit.sensors.pose import start_of
from mjx_fit.sensors.sensor_log import (
    SLACK,
    SensorLog,
    action_times,
    require_covered,
    require_log,
    require_poses,
)
from mjx_fit.types import Felt, StartPose, Trace
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.rates import ACTION_S, STEP_S, SUBSTEPS

LEAST_TARE_SAMPLES = 10
_CONFIG = Config()


def felt_from_log(
    log: SensorLog, peg_type: int, estimate_world: Float[np.ndarray, "2"], robot: Robot = PANDA
) -> Felt:
    """Convert a robot's log to sensor input, resampled to the library's sample times.

    Action j starts at ``command_time_s[j]`` and lasts 0.1 s. Its 50 wrenches are sampled at 0, 2, ..., 98 ms
    after its start: by linear interpolation for logs up to 500 Hz, and for faster ones as the mean of the
    samples within 2 ms, with weights that decrease linearly to 0. Its pose and twist are taken at its end, by
    linear interpolation, and by spherical interpolation (slerp) for the orientation. If the poses begin
    before the first action, the one at its start is the start of the attempt. No noise is added.

    Args:
        log: Log of one attempt.
        peg_type: Index of the peg's shape.
        estimate_world: Estimate of the hole's centre, above which the attempt started, m.
        robot: Robot whose workspace bounds the positions.

    Returns:
        Measurements of one attempt, without batch axes.

    Raises:
        RequestError: An array has the wrong shape, a number is not finite, times do not increase, samples are
            more than 0.1 s apart, a quaternion is not normalised, or a position is outside the workspace (for
            example because it is in millimetres). The message names the array and the time.

    Example:
        >>> import jax, numpy as np, mjx_fit as mf
        >>> rollouts = mf.make_engine("native").run(mf.draw_attempts(jax.random.key(0), 2), actions=3)
        >>> felt = rollouts.felt[0]
        >>> again = mf.felt_from_log(mf.log_from_felt(felt), int(felt.peg_type), felt.estimate_world)
        >>> np.allclose(again.trace.wrench_sensor, felt.trace.wrench_sensor)
        True
    """
    log = require_log(log)
    begins = action_times(log.command_time_s)
    ends = begins + ACTION_S
    samples = (begins[:, None] + STEP_S * np.arange(SUBSTEPS)).ravel()
    for name, time, first, last in (
        ("wrench_time_s", log.wrench_time_s, samples[0], samples[-1]),
        ("pose_time_s", log.pose_time_s, ends[0], ends[-1]),
    ):
        require_covered(name, time, first, last)
    require_poses(log, robot)
    wrench = _resampled(log.wrench_time_s, log.wrench_sensor, samples)
    position = _interpolated(log.pose_time_s, log.tip_pos_world, ends)
    turns = Rotation.from_quat(log.tip_quat_world, scalar_first=True)
    quaternion = _orientations(log.pose_time_s, turns, ends)
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
    start = None
    if log.pose_time_s[0] <= begins[0] + SLACK * STEP_S:
        first = _interpolated(log.pose_time_s, log.tip_pos_world, begins[:1])[0]
        start = StartPose(_single(first), _single(_orientations(log.pose_time_s, turns, begins[:1])[0]))
    return Felt(trace, length, _tare(log), _single(estimate_world), peg, start)


def log_from_felt(felt: Felt, start_s: float = 0.0, config: Config = _CONFIG) -> SensorLog:
    """Convert a simulated attempt to a robot's log: 500 Hz wrenches, 10 Hz poses, no noise.

    Args:
        felt: Measurements of one attempt, without batch axes.
        start_s: Start time of the attempt, s.
        config: Defines the pose at the start.

    Example:
        >>> import jax, mjx_fit as mf
        >>> rollouts = mf.make_engine("native").run(mf.draw_attempts(jax.random.key(0), 2), actions=3)
        >>> mf.log_from_felt(rollouts.felt[0]).wrench_sensor.shape
        (150, 6)
    """
    length, trace, start = int(felt.length), felt.trace, start_of(felt, config)
    begins = start_s + ACTION_S * np.arange(length)

    def from_rest(first: Any, rows: Any) -> Any:
        return np.concatenate([np.asarray(first)[None], np.asarray(rows)[:length]])

    still = np.zeros(3, np.float32)
    return SensorLog(
        wrench_time_s=(begins[:, None] + STEP_S * np.arange(SUBSTEPS)).ravel(),
        wrench_sensor=np.asarray(trace.wrench_sensor)[:length].reshape(-1, 6),
        pose_time_s=start_s + ACTION_S * np.arange(length + 1),
        tip_pos_world=from_rest(start.pos_world, trace.tip_pos_world),
        tip_quat_world=from_rest(start.quat_world, trace.tip_quat_world),
        command_time_s=begins,
        command_world=np.asarray(trace.action_world)[:length],
        tare_sensor=np.asarray(felt.tare_sensor),
        tip_linvel_world=from_rest(still, trace.tip_linvel_world),
        tip_angvel_world=from_rest(still, trace.tip_angvel_world),
    )


def _resampled(
    time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n k"], at: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m k"]:
    """Average with triangular weights of half-width ``STEP_S``; interpolate linearly between sparse samples.

    For evenly spaced samples at 500 Hz these weights are those of linear interpolation.
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
    dense = weighted[:, :1] > 1 + SLACK
    mean = weighted[:, 1:] / np.where(dense, weighted[:, :1], 1)
    return np.where(dense, mean, _interpolated(time, values, at))


def _interpolated(
    time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n k"], at: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m k"]:
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def _orientations(
    time: Float[np.ndarray, "n"], turns: Rotation, at: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m 4"]:
    """Interpolate on the sphere; of q and -q, the same orientation, return the one with x >= 0."""
    quaternion = Slerp(time, turns)(np.clip(at, time[0], time[-1])).as_quat(scalar_first=True)
    return quaternion * np.where(quaternion[:, 1:2] < 0, -1, 1)


def _twist(log: SensorLog, turns: Rotation) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "M 3"]]:
    """Compute linear (m/s) and angular (rad/s) velocity at the times of the poses."""
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
            "log: tare_sensor: it is missing: expected the reading in free space, or free_s, an interval "
            "without contact"
        )
    begin, end = log.free_s
    free = (log.wrench_time_s >= begin) & (log.wrench_time_s <= end)
    if free.sum() < LEAST_TARE_SAMPLES:
        raise RequestError(
            f"log: free_s: [{begin:.3f}, {end:.3f}] s cannot be used: it contains {int(free.sum())} "
            f"wrenches, and a tare needs at least {LEAST_TARE_SAMPLES}"
        )
    return _single(log.wrench_sensor[free].mean(0))


def _single(array: Any) -> Any:
    return np.asarray(array, np.float32)
