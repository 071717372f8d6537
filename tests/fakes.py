"""Stand-ins that decide by decree what physics would."""

import dataclasses

import jax
import numpy as np

from mjx_fit.types import Interaction, Trace

CLOSE_M = 0.005


class FakeEngine:
    """An attempt succeeds when the types match and the estimate is within 5 mm.

    Attributes:
        seen: Of each batch, the keys and which rows were active.
        starts: Of each batch, the estimates.
    """

    name = "fake"

    def __init__(self):
        self.seen, self.starts = [], []

    def run(self, attempts, actions, active=None, horizon=None):
        n = len(attempts.peg_type)
        active = np.ones(n, bool) if active is None else active
        start = np.asarray(attempts.estimate_world)
        error = np.linalg.norm(start - np.asarray(attempts.hole_pos_world), axis=1)
        match = np.asarray(attempts.peg_type) == np.asarray(attempts.hole_type)
        self.seen.append((jax.tree.map(np.asarray, jax.random.key_data(attempts.key)), active))
        self.starts.append(start)
        zeros = np.zeros
        trace = Trace(
            zeros((n, 2, 50, 6)), zeros((n, 2, 3)), np.tile([0.0, 1, 0, 0], (n, 2, 1)), zeros((n, 2, 3)),
            zeros((n, 2, 3)), zeros((n, 2), bool), zeros((n, 2, 3)),
        )  # fmt: skip
        return Interaction(
            trace, active * 2, active & match & (error < CLOSE_M), attempts.peg_type, attempts.hole_type,
            attempts.hole_pos_world, attempts.estimate_world, zeros((n, 6)), zeros((n, 7)), zeros((n, 7)),
            np.ones(n, bool),
        )  # fmt: skip


class PathEngine(FakeEngine):
    """The tip goes 2 mm in x with each of two actions."""

    def run(self, attempts, actions, active=None, horizon=None):
        done = super().run(attempts, actions, active, horizon)
        start = np.pad(np.asarray(attempts.estimate_world), ((0, 0), (0, 1)), constant_values=0.042)
        way = start[:, None] + np.array([[0.002, 0, 0], [0.004, 0, 0]])
        return dataclasses.replace(done, trace=dataclasses.replace(done.trace, tip_pos_world=way))
