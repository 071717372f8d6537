"""Simulate sequences: consecutive attempts of one peg at one hole, a batch of sequences at a time."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.control import policies
from mjx_fit.data.episode import Episode, padded
from mjx_fit.data.plan import Plan
from mjx_fit.data.schedule import draw_attempts, draw_later_attempts
from mjx_fit.engines.failures import report
from mjx_fit.engines.interface import Engine
from mjx_fit.filters.updates import detected_belief
from mjx_fit.task.attempt_loop import Tried, Try, attempt_rounds
from mjx_fit.task.estimator import Update
from mjx_fit.task.revisits import Revisits
from mjx_fit.types import Array, Attempt, Belief, Felt, Rollout
from mjx_fit.utils.randomness import root_key


class Sequences:
    """Simulates batches of sequences.

    Args:
        engine: Simulates the attempts.
        config: The configuration.
        plan: The collection plan.
        dumps: Folder for the files that replay diverged simulations.
        update: Estimator whose posteriors later attempts start from; None: later attempts start from sampled
            estimates.
    """

    def __init__(self, engine: Engine, config: Config, plan: Plan, dumps: Path, update: Update | None):
        self._engine, self._config, self._plan, self._dumps = engine, config, plan, dumps
        self._update = update

    def __call__(self, start: int) -> Episode:
        """Simulate one batch of sequences and return its episodes in the order of their ids."""
        plan = self._plan
        batch = _Batch(self._config, plan, start, learns=self._update is not None)
        engine = _EachPolicy(self._engine, self._config, batch, self._dumps)
        rounds = attempt_rounds(batch.next_try, engine, self._update or _nothing_learned, plan.actions)
        whole = None
        for number, tried in enumerate(rounds):
            one = batch.record(tried)
            if plan.sequence == 1:
                whole = one
                continue
            if whole is None:  # filled in place: concatenation would hold everything twice
                whole = jax.tree.map(partial(_with_axis, plan.sequence), one)
            jax.tree.map(lambda to, leaf, n=number: to.__setitem__((slice(None), n), leaf), whole, one)
        assert whole is not None
        if plan.sequence == 1:
            return whole
        return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), whole)


def _nothing_learned(beliefs: Belief, felt: Felt, keys: Key[Array, "n"]) -> Belief:
    return beliefs


class _Batch:
    """State of a batch of sequences.

    Attributes:
        ids: Ids of the episodes of the current round.
    """

    def __init__(self, config: Config, plan: Plan, start: int, *, learns: bool):
        self._config, self._plan, self._learns = config, plan, learns
        self._root = root_key(plan.seed, "collect")
        self._noise_keys = jax.vmap(partial(jax.random.fold_in, root_key(plan.seed, "collect: noise")))
        self._sequences = np.arange(start, start + plan.worlds)
        self._wanted = self._sequences < plan.sequences
        self._revisits: Revisits | None = None
        self._going, self._number = self._wanted, 0
        self._detected = self._belief = self._left = None

    @property
    def ids(self) -> Int[np.ndarray, "n"]:
        return self._sequences * self._plan.sequence + self._number

    def next_try(self) -> Try | None:
        """Return the next attempt of each sequence; None after the last."""
        if self._number == self._plan.sequence:
            return None
        attempts, self._cov = self._attempts()
        if self._belief is None or not self._learns:
            drawn = detected_belief(attempts.estimate_world[:, :2], self._config)
            self._belief = replace(drawn, mean_world=attempts.estimate_world, cov=jnp.asarray(self._cov))
            if self._detected is None:
                self._detected = self._belief
                self._revisits = Revisits(self._detected, self._config)
        goes_on = self._learns and self._number + 1 < self._plan.sequence
        keys = self._noise_keys(jnp.asarray(self.ids)) if goes_on else None
        return Try(attempts, self._going, self._belief, keys)

    def record(self, tried: Tried) -> Episode:
        """Store the posteriors and return the episodes of the round."""
        done, policy = tried.rollouts, np.asarray(tried.asked.attempts.policy)
        number = np.full_like(self.ids, self._number)
        done = replace(done, report=None)
        one = Episode(self.ids, self._sequences, number, policy, np.asarray(self._cov), done)
        self._going = self._going & done.truth.valid & ~done.taken
        self._left = done.truth.physics if self._config.placement.slips else None
        self._belief, self._number = tried.beliefs, self._number + 1
        if self._revisits is not None and self._detected is not None:
            rows = np.arange(len(self.ids))
            self._revisits.note((rows,), self._going, tried)
            self._belief = self._revisits.started(self._belief, self._detected, rows >= 0)
        return jax.tree.map(lambda leaf: leaf[: self._wanted.sum()], one)

    def _attempts(self) -> tuple[Attempt, Float[Array, "n D D"]]:
        ids, policy, belief = jnp.asarray(self._sequences), self._plan.policy, self._belief
        if self._number:
            drawn, cov = draw_later_attempts(self._root, ids, policy, self._number, self._config, self._left)
            if not self._learns or belief is None:
                return drawn, cov
            return replace(drawn, estimate_world=belief.mean_world), belief.cov
        attempts = draw_attempts(self._root, ids, policy, self._config)
        return attempts, detected_belief(attempts.estimate_world[:, :2], self._config).cov


class _EachPolicy:
    """Engine wrapper that runs the attempts of each policy with that policy's number of actions."""

    def __init__(self, engine: Engine, config: Config, batch: _Batch, dumps: Path):
        self.name, self.policy_name, self.turns = engine.name, engine.policy_name, engine.turns
        self._engine = engine
        self._config, self._batch, self._dumps = config, batch, dumps

    def run(
        self,
        attempts: Attempt,
        actions: int | None = None,
        active: Bool[np.ndarray, "n"] | None = None,
        horizon: int | None = None,
    ) -> Rollout:
        """See ``Engine.run``. The horizon of a spiral is always ``task.attempt_actions``."""
        actions = self._config.task.attempt_actions if actions is None else actions
        kind, ids = np.asarray(attempts.policy), self._batch.ids
        active = np.ones(len(kind), bool) if active is None else active
        done = None
        for policy in np.unique(kind):
            mine = kind == policy
            plans = self._config.task.attempt_actions if policy == policies.SPIRAL else horizon or actions
            part = self._engine.run(attempts, min(actions, plans), active & mine, plans)
            report(part, attempts, ids, plans, self._config, self._dumps)
            part = padded(part, actions)
            done = part if done is None else jax.tree.map(partial(_chosen, mine), part, done)
        assert done is not None
        return done


def _with_axis(n: int, leaf: np.ndarray) -> np.ndarray:
    return np.zeros((len(leaf), n, *leaf.shape[1:]), leaf.dtype)


def _chosen(chosen: Bool[np.ndarray, "n"], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(chosen.reshape(-1, *[1] * (a.ndim - 1)), a, b)
