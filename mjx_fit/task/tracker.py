"""The online estimator: what is believed of the holes in front of a robot, attempt by attempt.

It takes what a robot has (detections, the peg in hand, a log of the attempt) and no ground truth, and does to
the beliefs what the experiments do, by the same functions.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.world import WristConfig
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
"""How far from the estimate an attempt may start: the filter's innovation is measured from there."""


class BeliefTracker:
    """Beliefs about n holes, updated by what a robot measures.

    Example:
        >>> import numpy as np
        >>> import mjx_fit as mf
        >>> tracker = mf.BeliefTracker(mf.load_sensor(), detections=np.array([[0.45, 0.10], [0.50, -0.12]]))
        >>> hole = tracker.choose(peg="cross")
        >>> tracker.estimate(hole)                      # start the attempt here
        array([0.45, 0.1 ], dtype=float32)

        After a failed attempt, ``tracker.update(hole, log)`` with a ``SensorLog`` makes the posterior.

    Attributes:
        belief: About all holes, (n,).
        filled: (n,), which holes are.
        tries: (n,), attempts that failed at each hole with the peg in hand.
    """

    def __init__(
        self, sensor: TrainedSensor, detections: Float[np.ndarray, "n 2"], config: Config | None = None
    ):
        """Start from what a detector says.

        Args:
            sensor: The trained sensor.
            detections: Estimated centres of the holes in the frame of the robot's base, m.
            config: Gives the outcome model and the detector's accuracy; its network is replaced by the
                sensor's. None: as the sensor was trained.

        Raises:
            RequestError: A detection is no place that the robot can reach, or the configuration has other
                shapes than the sensor.
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
        # What is logged has the noise of the robot's own sensor.
        silent = WristConfig(
            force_noise_n=0.0,
            torque_xy_noise_nm=0.0,
            torque_z_noise_nm=0.0,
            contact_force_n=self._config.wrist.contact_force_n,
        )
        self._update = filter_update(replace(self._config, wrist=silent), sensor.network)

    def choose(self, peg: str) -> int:
        """The empty hole at which this peg is most likely to go in; among equals the least tried.

        Args:
            peg: Name of the peg's shape.

        Returns:
            The hole's index.

        Raises:
            RequestError: There is no such shape, or every hole is filled.
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
        """Where an attempt at a hole starts: the mean of the belief about its centre, m."""
        return np.array(self.belief.pos_mean_world[self._require_hole(hole)])

    def update(self, hole: int, felt: Felt | SensorLog) -> Belief:
        """Learn from an attempt that failed, started from ``estimate(hole)``.

        Args:
            hole: The hole that was tried.
            felt: What was felt: a robot's log, of the peg that ``choose`` was called with, or one attempt (no
                batch axes) out of a simulated rollout. No noise is added to it.

        Returns:
            The new belief about that hole.

        Raises:
            RequestError: The log cannot be used (``felt_from_log``), no peg is known, or the attempt was made
                with another peg, from elsewhere, or at a filled hole; no belief changes.
        """
        hole = self._require_hole(hole)
        if isinstance(felt, SensorLog):
            if self._peg is None:
                raise RequestError("update: no peg is in hand: call choose(peg=...) before the attempt")
            felt = felt_from_log(felt, self._peg, self.estimate(hole), self._robot)
        self._require_own(hole, felt)
        before = jax.tree.map(lambda leaf: leaf[hole : hole + 1], self.belief)
        rows = max(self._config.task.attempt_actions, len(felt.trace.action_world))
        batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], _padded(felt, rows))
        after = jax.tree.map(np.asarray, self._update(before, batch, numerics.key(0)[None]))
        self.belief = jax.tree.map(lambda leaf, new: _with_row(leaf, hole, new[0]), self.belief, after)
        self.tries[hole] += 1
        return jax.tree.map(lambda leaf: leaf[0], after)

    def fill(self, hole: int) -> None:
        """Note that a peg is in a hole: no attempt goes there any more."""
        self.filled[self._require_hole(hole)] = True
        self._peg, self.tries = None, np.zeros_like(self.tries)

    def save(self, path: Path | str) -> None:
        """Write the beliefs to a JSON file; ``load`` reads it."""
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
        """The tracker that was saved, with the same sensor.

        Args:
            path: The file.
            sensor: As when it was saved.
            config: Likewise.

        Raises:
            RequestError: The file is not one of ``save``, or is of another sensor or other shapes.
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
                    f"{path}: {word}: {shown(there)} cannot be used: the sensor's is {shown(here)}"
                )
        leaves = (
            np.asarray(leaf, np.float32) for leaf in (saved.pos_mean_world, saved.pos_cov, saved.type_logp)
        )
        belief, n = Belief(*leaves), len(tracker.filled)
        require_beliefs(belief, n, len(names))
        if not len(saved.filled) == len(saved.tries) == n:
            raise RequestError(f"{path}: filled, tries: they must have an entry for each of {n} holes")
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
        """Make sure that an attempt is one of this hole: another would give a wrong belief in silence."""
        names, peg = self._config.scene.names, int(felt.peg_type)
        if self._peg not in (None, peg):
            raise RequestError(f"update: peg_type: {peg} cannot be used: {names[self._peg]} is in hand")
        if self.filled[hole]:
            raise RequestError(f"update: hole {hole} cannot be used: it is filled")
        start, estimate = np.asarray(felt.estimate_world), self.estimate(hole)
        if not np.linalg.norm(start - estimate) <= MOST_OFF_START_M:
            raise RequestError(
                f"update: estimate_world: {np.round(start, 5).tolist()} cannot be used: an attempt at hole "
                f"{hole} starts from {np.round(estimate, 5).tolist()}"
            )


def _padded(felt: Felt, rows: int) -> Felt:
    """The attempt with that many rows, so that most attempts compile once."""

    def pad(leaf: Any) -> np.ndarray:
        leaf = np.asarray(leaf)
        return np.pad(leaf, [(0, rows - len(leaf)), *[(0, 0)] * (leaf.ndim - 1)])

    return replace(felt, trace=jax.tree.map(pad, felt.trace))


def _with_row(leaf: np.ndarray, row: int, value: np.ndarray) -> np.ndarray:
    changed = leaf.copy()
    changed[row] = value
    return changed
