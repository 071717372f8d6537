"""Repeated attempts at one hole: Algorithm 1 without a choice, batched over methods and trials.

Every row of the batch is one trial under one method. The hole, detection, exploration noise and sensor noise
of a trial are identical for all methods.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Key

from mjx_fit.config.schema import Config
from mjx_fit.engines.interface import Engine
from mjx_fit.filters import chart
from mjx_fit.filters.contact_memory import remembering
from mjx_fit.filters.kalman import scale_tril
from mjx_fit.filters.updates import detected_belief, initial_belief
from mjx_fit.scene.placement import place_for_tool
from mjx_fit.scene.slip import carried_on
from mjx_fit.task.attempt_loop import Tried, Try, attempt_rounds, spirals_at
from mjx_fit.task.effort import COLUMNS, Effort, Travel, effort_of
from mjx_fit.task.estimator import Update
from mjx_fit.task.holes import Holes, Outcome
from mjx_fit.task.methods import KNOWN_VARIANCE_M2, HoleMethod, of_rows
from mjx_fit.task.revisits import Revisits
from mjx_fit.types import Array, Belief, Felt


class HoleTable:
    """State of all rows, ordered by method, then by trial: R = methods x trials.

    Args:
        config: Settings of the task, the detector and the physics.
        methods: Methods to compare.
        holes: Setup of the T trials.
        max_attempts: Maximum number of attempts per trial, K.
    """

    def __init__(self, config: Config, methods: tuple[HoleMethod, ...], holes: Holes, max_attempts: int):
        self._config, self._max_attempts = config, max_attempts
        self.attempt_actions = config.task.attempt_actions
        self._methods, self._n_trials = methods, len(holes.peg_type)
        self._world = jax.tree.map(lambda leaf: np.concatenate([leaf] * len(methods)), _plain(holes))
        self._keys = jnp.concatenate([holes.key] * len(methods))
        self._names = config.filter.coordinates
        self._samples = of_rows(methods, self._n_trials, lambda method: method.starts == "sample")
        self._places = [self._true_place()]
        self._knows = of_rows(methods, self._n_trials, lambda method: method.knows_truth)
        self._reads = of_rows(methods, self._n_trials, lambda method: method.reads != "")
        self._detected = self._belief = _first_belief(config, methods, holes, self._places[0])
        self._revisits = Revisits(self._detected, config)
        n_rows = len(self._samples)
        self._inserted_at, self._attempts = np.zeros(n_rows, int), np.zeros(n_rows, int)
        self._done = np.zeros(n_rows, bool)
        self._means, self._covs = [self._belief.mean_world], [self._belief.cov]
        self._matches = [self._match_probability()]
        self._efforts: list[Effort] = []
        self._travel = Travel(np.asarray(self._belief.mean_world), config.moves)

    def next_try(self) -> Try | None:
        """Return the next attempt of each unfinished row; None if all are done, or after K attempts."""
        active, number = ~self._done, len(self._efforts)
        if number == self._max_attempts or not active.any():
            return None
        wiggle, noise, sample = _keys(self._keys, number)
        world = self._world
        belief = self._revisits.started(self._belief, self._detected, np.ones(len(active), bool))
        start = np.where(self._samples[:, None], _drawn(belief, sample, self._names), belief.mean_world)
        kinds = world["peg_type"], world["hole_type"]
        attempts = spirals_at(*kinds, world["hole_pos_world"], start, wiggle, world["physics"])
        return Try(attempts, active, belief, noise)

    def record(self, tried: Tried) -> None:
        """Count the attempts and store the posteriors of the active rows."""
        active = tried.asked.active
        self._attempts += active
        after = tried.rollouts.truth.physics
        self._world["physics"] = carried_on(self._world["physics"], after, active, self._config)
        self._places.append(self._true_place())

        def latest(old, new):
            return np.where(active.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        starts = np.asarray(tried.asked.attempts.estimate_world)
        self._travel.go(starts, active, np.full(len(active), bool(self._efforts)))
        effort = effort_of(tried.rollouts.felt)
        self._efforts.append(jax.tree.map(lambda column: np.where(active, column, np.nan), effort))
        taken = active & tried.rollouts.taken
        self._inserted_at[taken & tried.rollouts.truth.inserted] = len(self._efforts)
        self._done |= taken
        self._belief = self._told(jax.tree.map(latest, self._belief, tried.beliefs))
        self._detected = self._told(self._detected)
        # Only methods that learn from attempts remember where they were in vain.
        failed = active & tried.rollouts.truth.valid & ~taken & self._reads
        self._revisits.note((np.arange(len(active)),), failed, tried)
        self._means.append(self._belief.mean_world)
        self._covs.append(self._belief.cov)
        self._matches.append(self._match_probability())

    def _told(self, belief: Belief) -> Belief:
        """Return beliefs that have the true place where the method knows it."""
        known = np.where(self._knows[:, None], self._places[-1], belief.mean_world)
        return replace(belief, mean_world=known)

    def _true_place(self) -> Float[np.ndarray, "R D"]:
        world = self._world
        return np.asarray(place_for_tool(world["hole_pos_world"], world["physics"], self._config))

    def _match_probability(self) -> Float[np.ndarray, "R"]:
        kind = np.exp(np.asarray(self._belief.type_logp))
        return np.take_along_axis(kind, self._world["peg_type"][:, None], axis=1)[:, 0]

    def _none(self) -> Effort:
        """Return the effort of attempts that were not made."""
        return Effort(*[np.full(len(self._samples), np.nan)] * len(COLUMNS))

    def outcomes(self) -> dict[str, Outcome]:
        """Return the outcome of the trials per method."""
        left = self._max_attempts - len(self._efforts)
        columns = {
            "inserted_at": self._inserted_at,
            "attempts": self._attempts,
            "mean_world": np.stack([*self._means, *[self._means[-1]] * left], 1),
            "cov": np.stack([*self._covs, *[self._covs[-1]] * left], 1),
            "place_world": np.stack([*self._places, *[self._places[-1]] * left], 1),
            "match_probability": np.stack([*self._matches, *[self._matches[-1]] * left], 1),
            "effort": jax.tree.map(lambda *made: np.stack(made, 1), *self._efforts, *[self._none()] * left),
            "move_seconds": self._travel.seconds,
        }
        own = {
            method.name: slice(m * self._n_trials, (m + 1) * self._n_trials)
            for m, method in enumerate(self._methods)
        }
        return {
            name: Outcome(**jax.tree.map(lambda leaf, rows=rows: leaf[rows], columns))
            for name, rows in own.items()
        }


def rounds(table: HoleTable, engine: Engine, update: Update) -> Iterator[int]:
    """Repeat the attempt of every trial and method until the insertion, at most K times.

    An invalid attempt counts as a failed one without a belief update.

    Args:
        table: State of the trials, modified in place; holds the outcomes at the end.
        engine: Simulates the attempts of all rows as one batch.
        update: Belief update of all rows, from ``update_of_rows``.

    Yields:
        The number of attempts of each round.
    """
    for tried in attempt_rounds(table.next_try, engine, update, table.attempt_actions):
        table.record(tried)
        yield int(tried.asked.active.sum())


def update_of_rows(methods: tuple[HoleMethod, ...], updates: Mapping[str, Update]) -> Update:
    """Make the belief update of a table's rows from the updates of its methods.

    Args:
        methods: Methods of the table.
        updates: Update of each method that learns from failed attempts, by method name.
    """

    def update(belief: Belief, felt: Felt, keys: Key[Array, "R"]) -> Belief:
        parts, n = [], len(felt.length) // len(methods)
        for m, method in enumerate(methods):
            own = slice(m * n, (m + 1) * n)
            before, now = (jax.tree.map(lambda leaf, own=own: leaf[own], tree) for tree in (belief, felt))
            learns = method.name in updates
            parts.append(updates[method.name](before, now, keys[own]) if learns else before)
        return jax.tree.map(lambda *new: np.concatenate([np.asarray(leaf) for leaf in new]), *parts)

    return update


def _plain(holes: Holes) -> dict[str, Any]:
    return {name: leaf for name, leaf in vars(holes).items() if name != "key"}


def _first_belief(
    config: Config, methods: tuple[HoleMethod, ...], holes: Holes, place_world: Float[np.ndarray, "R D"]
) -> Belief:
    """Return the priors as NumPy arrays (methods times T): from the detector, or the truth if it is known."""
    detected = detected_belief(jnp.asarray(holes.estimate_world), config)
    known = initial_belief(
        jnp.asarray(place_world[: len(holes.key)]), KNOWN_VARIANCE_M2**0.5, config.scene.n_types
    )
    parts = [known if method.knows_truth else detected for method in methods]
    belief = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
    if config.filter.reads == "geometry":
        belief = jax.tree.map(np.asarray, remembering(belief, config))
    return belief


@jax.jit
def _keys(keys: Key[Array, "R"], number: int) -> tuple[Key[Array, "R"], Key[Array, "R"], Key[Array, "R"]]:
    """Derive the keys of exploration noise, sensor noise and sampled start for the next attempts."""

    def one(key):
        wiggle, noise, sample = jax.random.split(jax.random.fold_in(key, number), 3)
        return wiggle, noise, sample

    return jax.vmap(one)(keys)


@partial(jax.jit, static_argnames="coordinates")
def _drawn(belief: Belief, keys: Key[Array, "R"], coordinates: tuple[str, ...]) -> Float[Array, "R D"]:
    """Sample a place from each belief, m and rad: a step L z from μ, with L the Cholesky factor of Σ."""
    z = jax.vmap(lambda key: jax.random.normal(key, (len(coordinates),)))(keys)
    return chart.moved(belief.mean_world, (scale_tril(belief.cov) * z[:, None]).sum(-1), coordinates)
