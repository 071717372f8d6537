"""Attempts in a row at one hole: Algorithm 1 without a choice, batched over methods and trials.

Every row of the batch is one trial under one method. A trial's hole, detection, wiggles and sensor noise are
the same for all methods.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.engines.interface import Engine
from mjx_fit.filters.kalman import scale_tril
from mjx_fit.filters.updates import initial_belief
from mjx_fit.sensors.preprocess import peak_force
from mjx_fit.task.attempt_loop import Tried, Try, attempt_rounds, spirals_at
from mjx_fit.task.estimator import Update
from mjx_fit.task.methods import KNOWN_VARIANCE_M2, HoleMethod, of_rows
from mjx_fit.types import Array, Belief, Felt


@dataclass(frozen=True)
class Holes:
    """What the world holds in each of T trials.

    Attributes:
        peg_type: (T,).
        hole_type: (T,).
        hole_pos_world: (T, 2), m.
        estimate_world: (T, 2), what the detector says, m.
        key: (T,), source of wiggles, sensor noise and sampled estimates.
    """

    peg_type: Int[np.ndarray, "T"]
    hole_type: Int[np.ndarray, "T"]
    hole_pos_world: Float[np.ndarray, "T 2"]
    estimate_world: Float[np.ndarray, "T 2"]
    key: Key[Array, "T"]


@dataclass(frozen=True)
class Outcome:
    """What came of the trials under one method, K attempts at most.

    Attributes:
        inserted_at: (T,), the attempt after which the peg was in, from 1; 0 where it never was. The types
            need not match.
        attempts: (T,), attempts made.
        mean_world: (T, K + 1, 2), believed position before the first and after each attempt, m. From an
            insertion on it stays as it is: it is never replaced by where the peg went in.
        cov: (T, K + 1, 2, 2), its covariance, m².
        peak_force_n: (T, K), largest tared force of each attempt, NaN where there was none.
    """

    inserted_at: Int[np.ndarray, "T"]
    attempts: Int[np.ndarray, "T"]
    mean_world: Float[np.ndarray, "T after 2"]
    cov: Float[np.ndarray, "T after 2 2"]
    peak_force_n: Float[np.ndarray, "T K"]


class HoleTable:
    """The state of all rows, method by method, trial by trial: R = methods x trials.

    Args:
        config: Task, detector and physics.
        methods: What to compare.
        holes: T trials.
        max_attempts: K.
    """

    def __init__(self, config: Config, methods: tuple[HoleMethod, ...], holes: Holes, max_attempts: int):
        self.attempt_actions, self._max_attempts = config.task.attempt_actions, max_attempts
        self._methods, self._n_trials = methods, len(holes.peg_type)
        self._world = jax.tree.map(lambda leaf: np.concatenate([leaf] * len(methods)), _plain(holes))
        self._keys = jnp.concatenate([holes.key] * len(methods))
        self._samples = of_rows(methods, self._n_trials, lambda method: method.starts == "sample")
        self._belief = _first_belief(config, methods, holes)
        n_rows = len(self._samples)
        self._inserted_at, self._attempts = np.zeros(n_rows, int), np.zeros(n_rows, int)
        self._means, self._covs = [self._belief.pos_mean_world], [self._belief.pos_cov]
        self._forces: list[Float[np.ndarray, "R"]] = []

    def next_try(self) -> Try | None:
        """The next attempt of the rows whose peg is not in; None where there is none, or after K."""
        active, number = self._inserted_at == 0, len(self._forces)
        if number == self._max_attempts or not active.any():
            return None
        wiggle, noise, sample = _keys(self._keys, number)
        belief, world = self._belief, self._world
        start = np.where(self._samples[:, None], _drawn(belief, sample), belief.pos_mean_world)
        attempts = spirals_at(world["peg_type"], world["hole_type"], world["hole_pos_world"], start, wiggle)
        return Try(attempts, active, belief, noise)

    def record(self, tried: Tried) -> None:
        """Counts the attempts and takes over the beliefs of the rows that were active."""
        active = tried.asked.active
        self._attempts += active
        self._forces.append(np.where(active, peak_force(tried.rollouts.felt), np.nan))
        self._inserted_at[active & tried.rollouts.truth.inserted] = len(self._forces)

        def taken(old, new):
            return np.where(active.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        self._belief = jax.tree.map(taken, self._belief, tried.beliefs)
        self._means.append(self._belief.pos_mean_world)
        self._covs.append(self._belief.pos_cov)

    def outcomes(self) -> dict[str, Outcome]:
        """What came of the trials, by method."""
        left = self._max_attempts - len(self._forces)
        columns = {
            "inserted_at": self._inserted_at,
            "attempts": self._attempts,
            "mean_world": np.stack([*self._means, *[self._means[-1]] * left], 1),
            "cov": np.stack([*self._covs, *[self._covs[-1]] * left], 1),
            "peak_force_n": np.stack([*self._forces, *[np.full(len(self._samples), np.nan)] * left], 1),
        }
        own = {
            method.name: slice(m * self._n_trials, (m + 1) * self._n_trials)
            for m, method in enumerate(self._methods)
        }
        return {
            name: Outcome(**{column: leaf[rows] for column, leaf in columns.items()})
            for name, rows in own.items()
        }


def rounds(table: HoleTable, engine: Engine, update: Update) -> Iterator[int]:
    """Tries every hole under every method until the peg is in, K times at most.

    An attempt that is not valid counts as a failed one from which nothing was learned.

    Args:
        table: The trials; it has what came of them at the end.
        engine: Simulates the attempts of all rows at once.
        update: The update of all rows, as ``update_of_rows`` makes it.

    Yields:
        The number of attempts of each round.
    """
    for tried in attempt_rounds(table.next_try, engine, update, table.attempt_actions):
        table.record(tried)
        yield int(tried.asked.active.sum())


def update_of_rows(methods: tuple[HoleMethod, ...], updates: Mapping[str, Update]) -> Update:
    """Makes the belief update of a table's rows: each method's by its own.

    Args:
        methods: Those of the table.
        updates: What each method that learns makes of a failed attempt, by its name.
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


def _plain(holes: Holes) -> dict[str, np.ndarray]:
    return {name: leaf for name, leaf in vars(holes).items() if name != "key"}


def _first_belief(config: Config, methods: tuple[HoleMethod, ...], holes: Holes) -> Belief:
    """The detector's, or the truth for a method that knows it; NumPy arrays (methods times T)."""
    parts = []
    for method in methods:
        where = holes.hole_pos_world if method.knows_truth else holes.estimate_world
        std = KNOWN_VARIANCE_M2**0.5 if method.knows_truth else config.detector.prior_std_m
        parts.append(initial_belief(jnp.asarray(where), std, config.scene.n_types))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


@jax.jit
def _keys(keys: Key[Array, "R"], number: int) -> tuple[Key[Array, "R"], Key[Array, "R"], Key[Array, "R"]]:
    """Of the wiggle, the sensor's noise and the sampled start of each row's next attempt."""

    def one(key):
        wiggle, noise, sample = jax.random.split(jax.random.fold_in(key, number), 3)
        return wiggle, noise, sample

    return jax.vmap(one)(keys)


@jax.jit
def _drawn(belief: Belief, keys: Key[Array, "R"]) -> Float[Array, "R 2"]:
    """A place from each belief, m: μ + L z with L the Cholesky factor of Σ."""
    z = jax.vmap(lambda key: jax.random.normal(key, (2,)))(keys)
    return belief.pos_mean_world + (scale_tril(belief.pos_cov) * z[:, None]).sum(-1)
