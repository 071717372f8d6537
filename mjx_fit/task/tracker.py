"""Online estimator: track the beliefs about the holes in front of a robot, attempt by attempt.

The tracker needs only what a robot has (detections, the peg in hand, a sensor log of each attempt) and no
ground truth. It calls the same update functions as the experiments.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.randomize import RandomizeConfig
from mjx_fit.engines.requests import require_count
from mjx_fit.filters.outcome_model import success_probability
from mjx_fit.filters.updates import initial_belief
from mjx_fit.scene.robot import ROBOTS
from mjx_fit.sensors.resampling import felt_from_log
from mjx_fit.sensors.sensor_log import SensorLog
from mjx_fit.sensors.trained_sensor import TrainedSensor
from mjx_fit.task import greedy
from mjx_fit.task.estimator import filter_update
from mjx_fit.task.estimator_input import require_beliefs, require_places
from mjx_fit.task.saved_beliefs import FORMAT, SavedBeliefs, read_beliefs, write_beliefs
from mjx_fit.types import Belief, Felt
from mjx_fit.utils import numerics
from mjx_fit.utils.errors import RequestError, shown

MOST_OFF_START_M = 1e-4
"""Largest offset of an attempt's start from the estimate, m: the innovation is relative to the start."""


class BeliefTracker:
    """Beliefs about n holes, updated from the measurements of a robot.

    Example:
        >>> import numpy as np
        >>> import mjx_fit as mf
        >>> tracker = mf.BeliefTracker(mf.load_sensor(), detections=np.array([[0.45, 0.10], [0.50, -0.12]]))
        >>> hole = tracker.choose(peg="cross")
        >>> tracker.estimate(hole)                      # start the attempt here
        array([0.45, 0.1 ], dtype=float32)

        After a failed attempt, ``tracker.update(hole, log)`` with a ``SensorLog`` computes the posterior.

    Attributes:
        belief: Current belief about each hole, (n,).
        filled: (n,), whether each hole is filled.
        tries: (n,), number of failed attempts at each hole with the peg in hand.
    """

    def __init__(
        self, sensor: TrainedSensor, detections: Float[np.ndarray, "n 2"], config: Config | None = None
    ):
        """Initialise the beliefs from detections.

        Args:
            sensor: The trained sensor.
            detections: Estimated hole centres in the robot base frame, m.
            config: Defines the outcome model and the detector accuracy; its network settings are ignored in
                favour of the sensor's. None: the configuration of the sensor's training run.

        Raises:
            RequestError: A detection is out of the robot's reach, or the configuration and the sensor have
                different shapes.
        """
        numerics.require()
        self._config = sensor.adapt(config or sensor.config)
        self._sensor = sensor
        self._robot = ROBOTS[self._config.scene.robot]
        places = require_places(detections, self._robot.estimate_reach_m)
        names, std = self._config.scene.names, self._config.detector.prior_std_m
        self.belief: Belief = jax.tree.map(np.array, initial_belief(jnp.asarray(places), std, len(names)))
        self.filled = np.zeros(len(places), bool)
        self.tries = np.zeros(len(places), np.int32)
        self._peg: int | None = None
        # A logged trace already contains the errors of the robot's own sensors.
        as_logged = replace(
            self._config,
            wrist=self._config.wrist.without_errors(),
            pose=self._config.pose.without_errors(),
            randomize=RandomizeConfig(),
        )
        self._update = filter_update(as_logged, sensor.network)

    def choose(self, peg: str) -> int:
        """Choose the empty hole with the highest insertion probability for this peg; ties: the least tried.

        Args:
            peg: Name of the peg's shape.

        Returns:
            Index of the hole.

        Raises:
            RequestError: The shape does not exist, or every hole is filled.
        """
        kind = self._type_of(peg)
        if kind != self._peg:
            self._peg, self.tries = kind, np.zeros_like(self.tries)
        if self.filled.all():
            raise RequestError(
                f"choose: peg {shown(peg)} cannot be used: all {len(self.filled)} holes are filled"
            )
        alpha = success_probability(self._config, jnp.asarray(self.belief.pos_cov))
        reward = greedy.expected_reward(jnp.asarray(self.belief.type_logp), jnp.asarray(kind), alpha)
        return int(greedy.greedy(reward, jnp.asarray(self.filled), jnp.asarray(self.tries)))

    def estimate(self, hole: int) -> Float[np.ndarray, "2"]:
        """Return the start position of an attempt at a hole: the mean of the belief about its centre, m."""
        return np.array(self.belief.pos_mean_world[self._require_hole(hole)])

    def update(self, hole: int, felt: Felt | SensorLog) -> Belief:
        """Update the belief about a hole after a failed attempt that started from ``estimate(hole)``.

        Args:
            hole: The hole that was tried.
            felt: Measurements of the attempt: the sensor log of a robot, recorded with the peg given to
                ``choose``, or one attempt (no batch axes) of a simulated rollout. No noise is added.

        Returns:
            The posterior about that hole.

        Raises:
            RequestError: The log is unusable (``felt_from_log``), no peg is in hand, or the attempt used
                another peg, another start position or a filled hole. The beliefs stay unchanged.
        """
        hole = self._require_hole(hole)
        if isinstance(felt, SensorLog):
            if self._peg is None:
                raise RequestError("update: no peg is in hand: call choose(peg=...) before the attempt")
            felt = felt_from_log(felt, self._peg, self.estimate(hole), self._robot)
            if felt.start is None and self._config.sensor.pose == "start":
                raise RequestError(
                    "log: pose_time_s: the poses cannot be used: expected one at rest in free space, before "
                    "the first command; this sensor reads poses relative to it"
                )
        self._require_own(hole, felt)
        before = jax.tree.map(lambda leaf: leaf[hole : hole + 1], self.belief)
        rows = max(self._config.task.attempt_actions, len(felt.trace.action_world))
        batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], _padded(felt, rows))
        after = jax.tree.map(np.asarray, self._update(before, batch, numerics.key(0)[None]))
        self.belief = jax.tree.map(lambda leaf, new: _with_row(leaf, hole, new[0]), self.belief, after)
        self.tries[hole] += 1
        return jax.tree.map(lambda leaf: leaf[0], after)

    def fill(self, hole: int) -> None:
        """Mark a hole as filled; ``choose`` excludes it from then on."""
        self.filled[self._require_hole(hole)] = True
        self._peg, self.tries = None, np.zeros_like(self.tries)

    def save(self, path: Path | str) -> None:
        """Write the beliefs to a JSON file that ``load`` reads."""
        names = self._config.scene.names
        write_beliefs(
            Path(path),
            SavedBeliefs(
                format=FORMAT,
                shapes=list(names),
                sensor=self._sensor.fingerprint,
                peg=None if self._peg is None else names[self._peg],
                filled=self.filled.tolist(),
                tries=self.tries.tolist(),
                **{name: np.asarray(leaf, float).tolist() for name, leaf in vars(self.belief).items()},
            ),
        )

    @classmethod
    def load(cls, path: Path | str, sensor: TrainedSensor, config: Config | None = None) -> "BeliefTracker":
        """Restore a tracker from a file that ``save`` wrote.

        Args:
            path: The JSON file.
            sensor: The same trained sensor as at saving.
            config: The same configuration as at saving.

        Raises:
            RequestError: ``save`` did not write this file, or it belongs to another sensor or other shapes.
        """
        path = Path(path)
        saved = read_beliefs(path)
        tracker = cls(sensor, np.asarray(saved.pos_mean_world), config)
        names = tracker._config.scene.names
        for word, there, here in (
            ("sensor", saved.sensor, sensor.fingerprint),
            ("shapes", saved.shapes, list(names)),
        ):
            if there != here:
                raise RequestError(
                    f"{path}: {word}: {shown(there)} cannot be used: this sensor has {shown(here)}"
                )
        leaves = (
            np.asarray(leaf, np.float32) for leaf in (saved.pos_mean_world, saved.pos_cov, saved.type_logp)
        )
        belief, n = Belief(*leaves), len(tracker.filled)
        require_beliefs(belief, n, len(names))
        if not len(saved.filled) == len(saved.tries) == n:
            raise RequestError(f"{path}: filled, tries: lengths are invalid: expected {n} entries each")
        tracker.belief = belief
        tracker.filled, tracker.tries = np.array(saved.filled), np.array(saved.tries, np.int32)
        tracker._peg = None if saved.peg is None else tracker._type_of(saved.peg)
        return tracker

    def _type_of(self, peg: str) -> int:
        names = self._config.scene.names
        if peg not in names:
            raise RequestError(f"peg: {shown(peg)} is invalid: expected one of {', '.join(names)}")
        return names.index(peg)

    def _require_hole(self, hole: int) -> int:
        return require_count("hole", hole, 0, len(self.filled) - 1)

    def _require_own(self, hole: int, felt: Felt) -> None:
        """Check that an attempt belongs to this hole; any other would silently corrupt the belief."""
        names, peg = self._config.scene.names, int(felt.peg_type)
        if self._peg not in (None, peg):
            raise RequestError(f"update: peg_type: {peg} cannot be used: {names[self._peg]} is in hand")
        if self.filled[hole]:
            raise RequestError(f"update: hole {hole} cannot be used: it is filled")
        start, estimate = np.asarray(felt.estimate_world), self.estimate(hole)
        if not np.linalg.norm(start - estimate) <= MOST_OFF_START_M:
            raise RequestError(
                f"update: estimate_world: {np.round(start, 5).tolist()} cannot be used: an attempt at hole "
                f"{hole} must start from {np.round(estimate, 5).tolist()}"
            )


def _padded(felt: Felt, rows: int) -> Felt:
    """Pad the attempt to a fixed number of rows, so that most attempts share one compilation."""

    def pad(leaf: Any) -> np.ndarray:
        leaf = np.asarray(leaf)
        return np.pad(leaf, [(0, rows - len(leaf)), *[(0, 0)] * (leaf.ndim - 1)])

    return replace(felt, trace=jax.tree.map(pad, felt.trace))


def _with_row(leaf: np.ndarray, row: int, value: np.ndarray) -> np.ndarray:
    changed = leaf.copy()
    changed[row] = value
    return changed
