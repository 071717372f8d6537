"""Attempts in a row at one hole: Algorithm 1 without a choice, batched over methods and trials.

Every row of the batch is one trial under one method. A trial's hole, detection, wiggles and sensor noise are
the same for all methods.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Key

from mjx_fit.config import Config
from mjx_fit.filters.belief import initial_belief
from mjx_fit.filters.kalman import scale_tril
from mjx_fit.policies import SPIRAL
from mjx_fit.settings import N_TYPES
from mjx_fit.simulate.interface import Engine
from mjx_fit.task.learning import Update
from mjx_fit.task.methods import KNOWN_VARIANCE_M2, HoleMethod
from mjx_fit.types import Array, Attempt, Belief, Interaction
from mjx_fit.wrist import peak_force


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
        inserted_at: (T,), the attempt that succeeded, from 1; 0 where none did.
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


def run(
    config: Config,
    methods: tuple[HoleMethod, ...],
    holes: Holes,
    max_attempts: int,
    engine: Engine,
    updates: Mapping[str, Update],
    progress: Callable[[int], None],
) -> dict[str, Outcome]:
    """Tries every hole under every method until the peg is in, ``max_attempts`` times at most.

    An attempt that is not valid counts as a failed one from which nothing was learned.

    Args:
        config: Task, detector and physics.
        methods: What to compare.
        holes: T trials.
        max_attempts: K.
        engine: Simulates the attempts of all rows at once.
        updates: What each method that learns makes of a failed attempt, by its name.
        progress: Told how many attempts were made, after each round.

    Returns:
        What came of the trials, by method.
    """
    n = len(holes.peg_type)
    world = jax.tree.map(lambda leaf: np.concatenate([leaf] * len(methods)), _plain(holes))
    keys = jnp.concatenate([holes.key] * len(methods))
    belief = _first_belief(config, methods, holes)
    samples = np.repeat([method.starts == "sample" for method in methods], n)
    inserted_at, attempts = np.zeros(len(samples), int), np.zeros(len(samples), int)
    means, covs, forces = [belief.pos_mean_world], [belief.pos_cov], []
    for number in range(max_attempts):
        active = inserted_at == 0
        if active.any():
            wiggle, noise, sample = _keys(keys, number)
            start = np.where(samples[:, None], _drawn(belief, sample), belief.pos_mean_world)
            done = engine.run(_attempts(world, start, wiggle), config.task.attempt_actions, active)
            attempts += active
            inserted_at[active & done.inserted] = number + 1
            belief = _learnt(methods, updates, belief, done, noise, active)
            forces.append(np.where(active, peak_force(done), np.nan))
            progress(int(active.sum()))
        else:
            forces.append(np.full(len(samples), np.nan))
        means.append(belief.pos_mean_world)
        covs.append(belief.pos_cov)
    whole = Outcome(inserted_at, attempts, np.stack(means, 1), np.stack(covs, 1), np.stack(forces, 1))
    return {
        method.name: Outcome(**{name: leaf[m * n : (m + 1) * n] for name, leaf in vars(whole).items()})
        for m, method in enumerate(methods)
    }


def _plain(holes: Holes) -> dict[str, np.ndarray]:
    return {name: leaf for name, leaf in vars(holes).items() if name != "key"}


def _first_belief(config: Config, methods: tuple[HoleMethod, ...], holes: Holes) -> Belief:
    """The detector's, or the truth for a method that knows it; NumPy arrays (methods times T)."""
    parts = []
    for method in methods:
        where = holes.hole_pos_world if method.knows_truth else holes.estimate_world
        std = KNOWN_VARIANCE_M2**0.5 if method.knows_truth else config.detector.prior_std_m
        parts.append(initial_belief(jnp.asarray(where), std, N_TYPES))
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


def _attempts(
    world: dict[str, np.ndarray], start: Float[np.ndarray, "R 2"], wiggle: Key[Array, "R"]
) -> Attempt:
    return Attempt(
        peg_type=jnp.asarray(world["peg_type"]),
        hole_type=jnp.asarray(world["hole_type"]),
        hole_pos_world=jnp.asarray(world["hole_pos_world"]),
        estimate_world=jnp.asarray(start),
        policy=jnp.full(len(start), SPIRAL),
        key=wiggle,
    )


def _learnt(methods, updates, belief: Belief, done: Interaction, noise, active) -> Belief:
    """Beliefs after a round: each method's active rows by its own update; what learns nothing stays."""
    parts, n = [], len(active) // len(methods)
    for m, method in enumerate(methods):
        own = slice(m * n, (m + 1) * n)
        before, felt = (jax.tree.map(lambda leaf, own=own: leaf[own], tree) for tree in (belief, done))
        learns = method.name in updates
        parts.append(updates[method.name](before, felt, noise[own]) if learns else before)

    def joined(old, *new):
        together = np.concatenate([np.asarray(leaf) for leaf in new])
        return np.where(active.reshape(-1, *[1] * (old.ndim - 1)), together, old)

    return jax.tree.map(joined, belief, *parts)
