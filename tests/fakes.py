"""Fakes that replace physics by fixed outcomes, and what a policy sees."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from synthetic import with_trace

from mjx_fit.config.schema import Config
from mjx_fit.control.policies import PolicyInput, PolicyStart
from mjx_fit.task.holes import Holes
from mjx_fit.types import Felt, Rollout, Trace, Truth

CLOSE_M = 0.005
T = 40
"""Trials of ``make_holes``; the types match in the first half."""

TWO_HOLES = dataclasses.replace(
    Config(), task=dataclasses.replace(Config().task, n_holes=2, max_attempts=2, attempt_actions=2)
)
"""Assemblies that are played in no time."""


def seen(place=(0.0, 0.0, 0.045), contact=True, sinks_mps=0.0) -> PolicyInput:
    """What a policy sees of a peg in contact, at a place in m."""
    key = jax.random.key(0)
    return PolicyInput(
        start=PolicyStart(jnp.int32(0), jnp.zeros(2), jnp.int32(2)),
        attempt_key=key,
        key=key,
        step=jnp.int32(1),
        tip_pos_world=jnp.asarray(place),
        tip_quat_world=jnp.array([0.0, 1, 0, 0]),
        tip_linvel_world=jnp.array([0.0, 0, -sinks_mps]),
        tip_angvel_world=jnp.zeros(3),
        wrench_sensor=jnp.zeros((50, 6)),
        contact=jnp.asarray(contact),
        horizon=100,
    )


class FakeEngine:
    """An attempt succeeds when the types match and the estimate is within 5 mm.

    Attributes:
        seen: Of each batch, the keys and which rows were active.
        starts: Of each batch, the estimates.
    """

    name = "fake"
    policy_name = None
    turns = False

    def __init__(self):
        self.seen, self.starts = [], []

    def run(self, attempts, actions=None, active=None, horizon=None):
        n = len(attempts.peg_type)
        active = np.ones(n, bool) if active is None else active
        start = np.asarray(attempts.estimate_world)
        error = np.linalg.norm(start[:, :2] - np.asarray(attempts.hole_pos_world), axis=1)
        match = np.asarray(attempts.peg_type) == np.asarray(attempts.hole_type)
        self.seen.append((jax.tree.map(np.asarray, jax.random.key_data(attempts.key)), active))
        self.starts.append(start)
        zeros = np.zeros
        trace = Trace(
            zeros((n, 2, 50, 6)), zeros((n, 2, 3)), np.tile([0.0, 1, 0, 0], (n, 2, 1)), zeros((n, 2, 3)),
            zeros((n, 2, 3)), zeros((n, 2, 3)),
        )  # fmt: skip
        tare = np.pad(np.asarray(attempts.hole_pos_world), ((0, 0), (0, 4)))
        felt = Felt(trace, active * 2, tare, attempts.estimate_world, attempts.peg_type)
        inserted, whole = active & match & (error < CLOSE_M), np.ones(n, bool)
        rest = inserted, whole, zeros((n, 7)), zeros((n, 7))
        return Rollout(felt, Truth(attempts.hole_type, attempts.hole_pos_world, *rest))


def place_of(felt: Felt) -> np.ndarray:
    """Where the hole is, which the fake engine tells a sensor by decree: in the tare, of all places."""
    return np.asarray(felt.tare_sensor)[:, :2]


class Peeking:
    """An engine that keeps the truth of its latest batch, for a sensor by decree."""

    def __init__(self, engine):
        self.name, self.policy_name, self.turns = engine.name, engine.policy_name, engine.turns
        self._engine = engine

    def run(self, attempts, actions=None, active=None, horizon=None):
        done = self._engine.run(attempts, actions, active, horizon)
        self.truth = done.truth
        return done


class PathEngine(FakeEngine):
    """The tip goes 2 mm in x with each of two actions."""

    def run(self, attempts, actions=None, active=None, horizon=None):
        done = super().run(attempts, actions, active, horizon)
        start = np.pad(np.asarray(attempts.estimate_world), ((0, 0), (0, 1)), constant_values=0.042)
        way = start[:, None] + np.array([[0.002, 0, 0], [0.004, 0, 0]])
        return with_trace(done, tip_pos_world=way)


def halving(beliefs, felt, keys):
    """Halves the error, and knows it."""
    error = place_of(felt) - beliefs.pos_mean_world
    return dataclasses.replace(beliefs, mean_world=beliefs.mean_world + error / 2, cov=beliefs.cov / 4)


def make_holes(seed: int = 0) -> Holes:
    rng = np.random.default_rng(seed)
    peg = np.arange(T) % 3
    place = rng.uniform(-0.3, 0.3, (T, 2)).astype(np.float32)
    estimate = place + rng.uniform(-0.02, 0.02, (T, 2)).astype(np.float32)
    other = np.where(np.arange(T) < T // 2, peg, (peg + 1) % 3)
    return Holes(peg, other, place, estimate, jax.random.split(jax.random.key(1), T))
