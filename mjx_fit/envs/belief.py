"""Beliefs in observations: what a trained sensor makes of the attempt in progress."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.config.schema import Config
from mjx_fit.engines.attempt_rules import nothing_done
from mjx_fit.engines.stepped import Stepped, from_outside
from mjx_fit.envs.observation import POSITION_M
from mjx_fit.filters.frame import is_world
from mjx_fit.filters.updates import detected_belief
from mjx_fit.sensors.trained_sensor import TrainedSensor
from mjx_fit.task.progress import progress_update
from mjx_fit.types import Attempt, Belief
from mjx_fit.utils.errors import RequestError, require, shown

COMPONENTS = 5
"""Components of an observed belief."""


@dataclass(frozen=True)
class BeliefReading:
    """How beliefs are read.

    Attributes:
        sensor: The trained sensor.
        every: Actions of an attempt between two readings.
    """

    sensor: TrainedSensor
    every: int = 10


class BeliefReader:
    """Beliefs about the holes of n attempts in progress, read anew after every few actions of each.

    Args:
        config: Configuration of the worlds; their measurements err as it says.
        how: Which sensor reads, and when.

    Raises:
        RequestError: The sensor has other shapes, more is believed than x and y, or attempts end before the
            first reading.
    """

    def __init__(self, config: Config, how: BeliefReading):
        if not isinstance(how, BeliefReading):
            raise RequestError(f"belief: {shown(how)} is invalid: expected BeliefReading(sensor, every)")
        require("belief: every", how.every, 1, config.task.attempt_actions)
        self._config, self._every = how.sensor.adapt(config), how.every
        if not is_world(self._config.filter.coordinates):
            names = ", ".join(self._config.filter.coordinates)
            raise RequestError(f"belief: filter.coordinates [{names}] cannot be observed: expected [x, y]")
        self._update = progress_update(self._config, how.sensor.network, logged=False)

    def begin(self, which: Bool[np.ndarray, "n"], attempts: Attempt) -> None:
        """Begin the attempts (n,) of some worlds; at first those of all."""
        prior = detected_belief(jnp.asarray(attempts.estimate_world), self._config)
        actions, turns = self._config.task.attempt_actions, from_outside(self._config).turns
        felt = jax.tree.map(np.array, nothing_done(attempts, actions, 0, self._config, turns=turns).felt)
        if which.all():
            self._felt, self._keys = felt, attempts.key
            self._prior, self._belief = (jax.tree.map(np.array, prior) for _ in range(2))
            return
        self._keys = jnp.where(which, attempts.key, self._keys)
        for new, old in ((felt, self._felt), (prior, self._prior), (prior, self._belief)):
            for row, kept in zip(jax.tree.leaves(new), jax.tree.leaves(old), strict=True):
                kept[which] = np.asarray(row)[which]

    def add(self, stepped: Stepped) -> None:
        """Record an action of each attempt, and read those that are due."""
        felt, rows = self._felt, np.arange(len(self._felt.length))
        valid = np.asarray(stepped.verdict.valid)
        for stored, now in zip(jax.tree.leaves(felt.trace), jax.tree.leaves(stepped.row), strict=True):
            stored[rows, felt.length] = now
        felt.tare_sensor[:], felt.length[:] = stepped.tare_sensor, felt.length + 1
        due = np.flatnonzero(valid & (felt.length % self._every == 0))
        if len(due):
            self._read(due)

    def observed(self) -> Float[np.ndarray, "n 5"]:
        """Return what is believed of each hole.

        It is the place relative to the detection (2), its standard deviations (2), both in the unit of
        positions, and the probability that the hole is the peg's.
        """
        belief, rows = self._belief, np.arange(len(self._keys))
        apart = belief.mean_world - self._felt.estimate_world
        std = np.sqrt(np.diagonal(belief.cov, axis1=1, axis2=2))
        own = np.exp(belief.type_logp[rows, self._felt.peg_type])
        return np.column_stack([apart / POSITION_M, std / POSITION_M, own]).astype(np.float32)

    def _read(self, due) -> None:
        # The number of rows is a power of two, so that few are compiled.
        rows = np.resize(due, 1 << (len(due) - 1).bit_length())
        prior, felt = (jax.tree.map(lambda leaf: leaf[rows], one) for one in (self._prior, self._felt))
        after: Belief = self._update(replace(prior, memory=None), felt, self._keys[rows])
        for stored, now in zip(jax.tree.leaves(self._belief), jax.tree.leaves(after), strict=True):
            stored[rows] = np.asarray(now)
