"""Online estimator: track the beliefs about the holes in front of a robot, attempt by attempt.

The tracker needs only what a robot has (detections, the peg in hand, a sensor log of each attempt) and no
ground truth. It calls the same update functions as the experiments.
"""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.engines.requests import require_count
from mjx_fit.filters.belief_check import require_beliefs
from mjx_fit.filters.contact_memory import detected_as
from mjx_fit.filters.updates import detected_belief
from mjx_fit.scene.robot import ROBOTS
from mjx_fit.sensors.sensor_log import SensorLog
from mjx_fit.sensors.trained_sensor import TrainedSensor
from mjx_fit.task.assembly_snapshot import KEPT_FROM
from mjx_fit.task.estimator import Update, filter_update
from mjx_fit.task.estimator_input import require_places, settings_of
from mjx_fit.task.hole_choice import best_hole
from mjx_fit.task.logged_attempt import AtHole, attempt_of, padded, require_own
from mjx_fit.task.saved_beliefs import (
    FORMAT,
    SavedBeliefs,
    as_stored,
    fingerprint_of,
    read_beliefs,
    write_beliefs,
)
from mjx_fit.types import Belief, Felt
from mjx_fit.utils import numerics
from mjx_fit.utils.arrays import with_row
from mjx_fit.utils.errors import RequestError, shown


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
        config: Configuration in use.
        sensor: The trained sensor; None: the geometry of the parts reads logs.
        belief: Current belief about each hole, (n,).
        peg: Index of the type of the peg in hand; None: there is none.
        filled: (n,), whether each hole is filled.
        tries: (n,), number of failed attempts at each hole with the peg in hand.
    """

    def __init__(
        self,
        sensor: TrainedSensor | None,
        detections: Float[np.ndarray, "n 2"] | Float[np.ndarray, "n D"],
        config: Config | None = None,
    ):
        """Initialise the beliefs from detections.

        Args:
            sensor: The trained sensor; None: the geometry of the parts reads the logs.
            detections: Estimated hole centres in the robot base frame, m; or estimates of all D believed
                coordinates, m and rad.
            config: Defines the outcome model and the detector accuracy; its network settings are ignored in
                favour of the sensor's. None: the configuration of the sensor's training run.

        Raises:
            RequestError: A detection is out of the robot's reach, the configuration and the sensor have
                different shapes, or there is no sensor and ``filter.reads`` asks for one.
        """
        numerics.require()
        self.config = settings_of(sensor, config)
        self.sensor = sensor
        self._robot = ROBOTS[self.config.scene.robot]
        places = require_places(detections, self._robot.estimate_reach_m, self.config)
        self._detected = jax.tree.map(np.asarray, detected_belief(jnp.asarray(places), self.config))
        self.belief: Belief = jax.tree.map(np.array, self._detected)
        self.filled = np.zeros(len(places), bool)
        self.tries = np.zeros(len(places), np.int32)
        self.peg: int | None = None
        network = None if sensor is None else sensor.network
        self._update, self._confirm = (
            filter_update(self.config, network, inserted=inserted, logged=True) for inserted in (False, True)
        )

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
        if kind != self.peg:
            self.peg, self.tries = kind, np.zeros_like(self.tries)
        if self.filled.all():
            raise RequestError(
                f"choose: peg {shown(peg)} cannot be used: all {len(self.filled)} holes are filled"
            )
        return best_hole(self.belief, kind, self.filled, self.tries, self.config)

    def estimate(self, hole: int) -> Float[np.ndarray, "D"]:
        """Return where an attempt at a hole is to start: the mean of the belief about it, m and rad."""
        return np.array(self.belief.mean_world[self._require_hole(hole)])

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
        after = self._learn(self._update, hole, self.read(hole, felt))
        self.tries[hole] += 1
        return after

    def judge_insertion(self, hole: int, felt: Felt | SensorLog) -> bool:
        """Update the belief about a hole that a peg went into, and tell whether it is the peg's own.

        A peg may enter holes of other types, where it has more room, and the trace tells. If the answer is
        False, pull the peg out and go on with ``choose``; else call ``fill``.

        Args:
            hole: The hole that the peg is in.
            felt: Measurements of the attempt, see ``update``.

        Returns:
            Whether the hole matches the peg with at least the probability ``KEPT_FROM``.

        Raises:
            RequestError: As in ``update``.
        """
        hole = self._require_hole(hole)
        felt = self.read(hole, felt)
        after = self._learn(self._confirm, hole, felt)
        own = bool(after.type_logp[int(felt.peg_type)] >= np.log(KEPT_FROM))
        self.tries[hole] += not own
        return own

    def read(self, hole: int, felt: Felt | SensorLog) -> Felt:
        """Return the measurements of an attempt at a hole, checked as in ``update``."""
        there = AtHole(hole, self.estimate(hole), bool(self.filled[hole]), self.peg)
        if isinstance(felt, SensorLog):
            felt = attempt_of(felt, there, self._robot, at_rest=self.config.sensor.pose == "start")
        elif not isinstance(felt, Felt):
            raise RequestError(f"update: felt: {shown(felt)} cannot be used: expected a SensorLog or a Felt")
        require_own(felt, there, self.config.scene.names)
        return felt

    def prior(self, hole: int) -> Belief:
        """Return the belief about a hole before an attempt (1,), with what a filter needs to remember."""
        hole = self._require_hole(hole)
        before, first = (
            jax.tree.map(lambda leaf: leaf[hole : hole + 1], one) for one in (self.belief, self._detected)
        )
        return detected_as(before, first, self.config)

    def _learn(self, update: Update, hole: int, felt: Felt) -> Belief:
        """Replace the belief about a hole by its posterior, and return it."""
        before = self.prior(hole)
        rows = max(self.config.task.attempt_actions, len(felt.trace.action_world))
        batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], padded(felt, rows))
        after = jax.tree.map(np.asarray, update(before, batch, numerics.key(0)[None]))
        after = replace(after, memory=None)
        self.belief = jax.tree.map(lambda leaf, new: with_row(leaf, hole, new[0]), self.belief, after)
        return jax.tree.map(lambda leaf: leaf[0], after)

    def fill(self, hole: int) -> None:
        """Mark a hole as filled; ``choose`` excludes it from then on."""
        self.filled[self._require_hole(hole)] = True
        self.peg, self.tries = None, np.zeros_like(self.tries)

    def save(self, path: Path | str) -> None:
        """Write the beliefs to a JSON file that ``load`` reads."""
        names = self.config.scene.names
        write_beliefs(
            Path(path),
            SavedBeliefs(
                format=FORMAT,
                shapes=list(names),
                sensor=fingerprint_of(self.sensor),
                peg=None if self.peg is None else names[self.peg],
                filled=self.filled.tolist(),
                tries=self.tries.tolist(),
                detections=self._detected.mean_world.tolist(),
                **as_stored(self.belief),
            ),
        )

    @classmethod
    def load(
        cls, path: Path | str, sensor: TrainedSensor | None, config: Config | None = None
    ) -> "BeliefTracker":
        """Restore a tracker from a file that ``save`` wrote.

        Args:
            path: The JSON file.
            sensor: The same trained sensor as at saving, or None.
            config: The same configuration as at saving.

        Raises:
            RequestError: ``save`` did not write this file, or it belongs to another sensor or other shapes.
        """
        saved = read_beliefs(path := Path(path))
        tracker = cls(sensor, saved.places(path), config)
        names = tracker.config.scene.names
        saved.require_for(path, sensor, names)
        belief = saved.belief(path)
        require_beliefs(belief, len(tracker.filled), len(names), d=len(tracker.config.filter.coordinates))
        tracker.belief = belief
        tracker.filled, tracker.tries = np.array(saved.filled), np.array(saved.tries, np.int32)
        tracker.peg = None if saved.peg is None else tracker._type_of(saved.peg)
        return tracker

    def _type_of(self, peg: str) -> int:
        names = self.config.scene.names
        if peg not in names:
            raise RequestError(f"peg: {shown(peg)} is invalid: expected one of {', '.join(names)}")
        return names.index(peg)

    def _require_hole(self, hole: int) -> int:
        return require_count("hole", hole, 0, len(self.filled) - 1)
