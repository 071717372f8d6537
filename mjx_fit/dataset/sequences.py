"""Simulating sequences: attempts in a row of one peg at one hole, a batch of sequences at once."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit import policies
from mjx_fit.config import Config
from mjx_fit.dataset.draws import draw_attempts, draw_later_attempts
from mjx_fit.dataset.episode import Episode
from mjx_fit.dataset.plan import Plan
from mjx_fit.filters.belief import initial_belief
from mjx_fit.randomness import root_key
from mjx_fit.settings import N_TYPES
from mjx_fit.simulate.broken import report
from mjx_fit.simulate.interface import Engine
from mjx_fit.task.learning import Update
from mjx_fit.types import Array, Attempt, Belief, Interaction


class Sequences:
    """Simulates batches of sequences.

    Attributes:
        broken: Worlds so far that are not valid: left out of training.
    """

    def __init__(self, engine: Engine, config: Config, plan: Plan, dumps: Path, update: Update | None):
        self._engine, self._config, self._plan, self._dumps = engine, config, plan, dumps
        self._update = update
        self._root = root_key(plan.seed, "collect")
        self._noise_keys = jax.vmap(partial(jax.random.fold_in, root_key(plan.seed, "collect: noise")))
        self.broken = 0

    def __call__(self, start: int) -> Episode:
        """The episodes of one batch of sequences, in the order of their ids."""
        plan = self._plan
        sequences = np.arange(start, start + plan.worlds)
        wanted = sequences < plan.sequences
        going, whole, belief = wanted, None, None
        for number in range(plan.sequence):
            attempts, cov = self._attempts(sequences, number, belief)
            ids = sequences * plan.sequence + number
            done = self._run(attempts, ids, going)
            if number + 1 < plan.sequence:
                belief = self._updated(belief, attempts, done, ids)
            going = going & done.valid & ~done.inserted
            policy = np.asarray(attempts.policy)
            one = Episode(ids, sequences, np.full_like(ids, number), policy, np.asarray(cov), done)
            one = jax.tree.map(lambda leaf: leaf[: wanted.sum()], one)
            if plan.sequence == 1:
                return one
            if whole is None:  # in place at once: kept and joined at the end, all would be there twice
                whole = jax.tree.map(partial(_with_axis, plan.sequence), one)
            jax.tree.map(lambda to, leaf, n=number: to.__setitem__((slice(None), n), leaf), whole, one)
        return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), whole)

    def _attempts(
        self, sequences: Int[np.ndarray, "n"], number: int, belief: Belief | None
    ) -> tuple[Attempt, Float[Array, "n 2 2"]]:
        ids, policy = jnp.asarray(sequences), self._plan.policy
        if number:
            drawn, cov = draw_later_attempts(self._root, ids, policy, number, self._config)
            if belief is None:
                return drawn, cov
            return replace(drawn, estimate_world=belief.pos_mean_world), belief.pos_cov
        cov = self._config.detector.prior_std_m**2 * np.eye(2, dtype=np.float32)
        attempts = draw_attempts(self._root, ids, policy, self._config.detector)
        return attempts, np.broadcast_to(cov, (len(sequences), 2, 2))

    def _updated(
        self, belief: Belief | None, attempts: Attempt, done: Interaction, ids: Int[np.ndarray, "n"]
    ) -> Belief | None:
        """What is believed after an attempt; None where estimates are drawn."""
        if self._update is None:
            return None
        if belief is None:
            belief = initial_belief(attempts.estimate_world, self._config.detector.prior_std_m, N_TYPES)
        return self._update(belief, done, self._noise_keys(jnp.asarray(ids)))

    def _run(self, attempts: Attempt, ids: Int[np.ndarray, "n"], going: Bool[np.ndarray, "n"]) -> Interaction:
        """Runs the attempts of each policy with as many actions as it has."""
        kind, steps = np.asarray(attempts.policy), self._plan.actions
        done = None
        for policy in np.unique(kind):
            mine = kind == policy
            horizon = self._config.task.attempt_actions if policy == policies.SPIRAL else steps
            part = self._engine.run(attempts, min(steps, horizon), going & mine, horizon)
            self.broken += report(part, attempts, ids, horizon, self._config, self._dumps)
            part = _padded(part, steps)
            done = part if done is None else jax.tree.map(partial(_chosen, mine), part, done)
        assert done is not None
        return done


def _with_axis(n: int, leaf: np.ndarray) -> np.ndarray:
    return np.zeros((len(leaf), n, *leaf.shape[1:]), leaf.dtype)


def _padded(interactions: Interaction, steps: int) -> Interaction:
    def pad(leaf):
        return np.pad(leaf, [(0, 0), (0, steps - leaf.shape[1]), *[(0, 0)] * (leaf.ndim - 2)])

    return Interaction(**vars(interactions) | {"trace": jax.tree.map(pad, interactions.trace)})


def _chosen(chosen: Bool[np.ndarray, "n"], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(chosen.reshape(-1, *[1] * (a.ndim - 1)), a, b)
