"""The loop around every attempt that is learned from: attempt, engine, estimator, and the next attempt."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.control.policies import SPIRAL
from mjx_fit.engines.interface import Engine
from mjx_fit.task.estimator import Update, after_failures
from mjx_fit.types import Array, Attempt, Belief, Rollout


@dataclass(frozen=True)
class Try:
    """The attempts of one round, R rows.

    Attributes:
        attempts: (R,), one of each row.
        active: Which rows make theirs.
        beliefs: (R,), about the hole that each row tries.
        noise_keys: Sources of the F/T sensor's noise; None: nothing is learned from this round.
    """

    attempts: Attempt
    active: Bool[np.ndarray, "R"]
    beliefs: Belief
    noise_keys: Key[Array, "R"] | None


@dataclass(frozen=True)
class Tried:
    """One round, simulated and learned from.

    Attributes:
        asked: What was tried.
        rollouts: (R,), what happened; meaningless for a row that was not active.
        beliefs: (R,), the posterior; likewise.
    """

    asked: Try
    rollouts: Rollout
    beliefs: Belief


def attempt_rounds(
    next_try: Callable[[], Try | None], engine: Engine, update: Update, actions: int
) -> Iterator[Tried]:
    """Simulates and learns from one round after the other, until there is nothing left to try.

    Args:
        next_try: Gives the next round, or None. It is called once the round before has been taken, so that
            whoever iterates records a round before asking for the next.
        engine: Simulates the attempts of all active rows together.
        update: The estimator.
        actions: Most actions in one attempt.
    """
    while (asked := next_try()) is not None:
        rollouts = engine.run(asked.attempts, actions, asked.active)
        beliefs = asked.beliefs
        if asked.noise_keys is not None:
            beliefs = after_failures(update, beliefs, rollouts, asked.noise_keys)
        yield Tried(asked, rollouts, beliefs)


def spirals_at(
    peg_type: Int[Array, "R"],
    hole_type: Int[Array, "R"],
    hole_pos_world: Float[Array, "R 2"],
    estimate_world: Float[Array, "R 2"],
    keys: Key[Array, "R"],
) -> Attempt:
    """Attempts (R,) by the paper's spiral.

    Args:
        peg_type: The peg in hand.
        hole_type: The hole that is tried.
        hole_pos_world: Its true position, m.
        estimate_world: Where the attempt starts, m.
        keys: Sources of the exploration noise.
    """
    return Attempt(
        peg_type=jnp.asarray(peg_type),
        hole_type=jnp.asarray(hole_type),
        hole_pos_world=jnp.asarray(hole_pos_world),
        estimate_world=jnp.asarray(estimate_world),
        policy=jnp.full(len(estimate_world), SPIRAL),
        key=keys,
    )
