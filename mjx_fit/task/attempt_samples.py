"""Samples of an attempt as they come, and the log of the actions that are complete."""

import numpy as np
from jaxtyping import Float

from mjx_fit.sensors.resampling import LEAST_TARE_SAMPLES
from mjx_fit.sensors.sensor_log import SensorLog
from mjx_fit.task.sample_buffer import SampleBuffer
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.rates import ACTION_S, STEP_S, SUBSTEPS

REST_S = 0.5
"""Time at rest before the first command whose mean is the tare."""
MOST_HZ = 1200
"""Highest rate of wrenches, and of poses, for which there is memory."""
_BEFORE_S = 1e-5
_SLACK_S = 1e-7
_FORCE_SAMPLES = 10


class AttemptSamples:
    """Samples of one attempt at a time, as in ``SensorLog``; what comes late is left out.

    Attributes:
        tare_sensor: Mean wrench at rest before the first command; None before it.
    """

    def __init__(self, most_actions: int):
        """Reserve memory for attempts of so many actions."""
        most = round(MOST_HZ * (2 * REST_S + ACTION_S * (most_actions + 2)))
        self._wrench, self._pose = SampleBuffer("wrench", most, 6), SampleBuffer("pose", most, 7)
        self._twist = SampleBuffer("twist", most, 6)
        self._command = SampleBuffer("command", most_actions, 3)
        self.clear()

    def clear(self) -> None:
        """Forget all samples."""
        self.tare_sensor: Float[np.ndarray, "6"] | None = None
        for one in (self._wrench, self._pose, self._twist, self._command):
            one.clear()

    def add_wrench(self, time_s: float, wrench_sensor: Float[np.ndarray, "6"]) -> None:
        """Add a wrench."""
        self._wrench.add(time_s, wrench_sensor)
        self._keep_rest(self._wrench)

    def add_pose(
        self, time_s: float, pose: Float[np.ndarray, "7"], twist: Float[np.ndarray, "6"] | None
    ) -> None:
        """Add a pose, position before quaternion, and the twist at the same time."""
        count = len(self._pose)
        self._pose.add(time_s, pose)
        if len(self._pose) > count and twist is not None:
            self._twist.add(time_s, twist)
        for one in (self._pose, self._twist):
            self._keep_rest(one)

    def add_command(self, time_s: float, displacement_world: Float[np.ndarray, "3"]) -> None:
        """Add a command.

        Raises:
            RequestError: There are fewer wrenches before the first command than a tare needs.
        """
        if not len(self._command):
            rest = self._wrench.time_s >= time_s - REST_S
            if rest.sum() < LEAST_TARE_SAMPLES:
                raise RequestError(
                    f"online: {int(rest.sum())} wrenches in the {REST_S} s before the first command are not "
                    f"enough: a tare needs at least {LEAST_TARE_SAMPLES}"
                )
            self.tare_sensor = self._wrench.values[rest].mean(0)
        self._command.add(time_s, displacement_world)

    @property
    def place_world(self) -> Float[np.ndarray, "3"] | None:
        """Latest position of the TCP, m; None: there is none."""
        return self._pose.values[-1, :3].copy() if len(self._pose) else None

    @property
    def force_n(self) -> float:
        """Force, tared, the mean of the last samples, N; 0 before the first command."""
        if self.tare_sensor is None:
            return 0.0
        last = self._wrench.values[-_FORCE_SAMPLES:, :3].mean(0)
        return float(np.linalg.norm(last - self.tare_sensor[:3]))

    @property
    def actions(self) -> int:
        """Number of actions of which all samples are there."""
        if not len(self._command):
            return 0
        begins = self._command.time_s[0] + ACTION_S * np.arange(len(self._command))
        felt = self._wrench.last_s >= begins + (SUBSTEPS - 1) * STEP_S - _SLACK_S
        return int((felt & (self._pose.last_s >= begins + ACTION_S - _SLACK_S)).sum())

    @property
    def left_out(self) -> int:
        """Number of samples that were left out: late, or not finite."""
        return self._wrench.left_out + self._pose.left_out

    def log(self) -> SensorLog:
        """Return the log of the actions that are complete; there must be one."""
        n, begin = self.actions, self._command.time_s[0]
        end = begin + ACTION_S * n + _SLACK_S
        wrench = np.searchsorted(self._wrench.time_s, end, "right")
        pose = np.searchsorted(self._pose.time_s, end, "right") + 1  # one to interpolate to
        twist = self._twist.values[:pose].copy() if len(self._twist) == len(self._pose) else None
        return SensorLog(
            wrench_time_s=self._wrench.time_s[:wrench].copy(),
            wrench_sensor=self._wrench.values[:wrench].copy(),
            pose_time_s=self._pose.time_s[:pose].copy(),
            tip_pos_world=self._pose.values[:pose, :3].copy(),
            tip_quat_world=self._pose.values[:pose, 3:].copy(),
            command_time_s=self._command.time_s[:n].copy(),
            command_world=self._command.values[:n].copy(),
            free_s=np.array([begin - REST_S, begin - _BEFORE_S]),
            tip_linvel_world=None if twist is None else twist[:, :3],
            tip_angvel_world=None if twist is None else twist[:, 3:],
        )

    def _keep_rest(self, samples: SampleBuffer) -> None:
        """Before the first command, forget what is too old for the tare."""
        if not len(self._command) and len(samples) > 2 * REST_S * MOST_HZ:
            samples.forget_before(samples.last_s - REST_S)
