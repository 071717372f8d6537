"""Attempt loop shared by all tasks: simulate an attempt, update the belief, choose the next attempt."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.control.policies import SPIRAL
from mjx_fit.engines.interface import Engine
from mjx_fit.task.after_attempts import after_failures, after_insertions
from mjx_fit.task.estimator import Update
from mjx_fit.task.seek import GEOMETRIC
from mjx_fit.types import Array, Attempt, Belief, Rollout
from mjx_fit.types.physics import AS_CONFIGURED, Physics


@dataclass(frozen=True)
class Try:
    """Attempts of one round, R rows.

    Attributes:
        attempts: One attempt per row, (R,).
        active: Whether each row makes its attempt.
        beliefs: Prior about the hole that each row tries, (R,).
        noise_keys: Seeds of the F/T sensor noise; None: the round updates no belief.
    """

    attempts: Attempt
    active: Bool[np.ndarray, "R"]
    beliefs: Belief
    noise_keys: Key[Array, "R"] | None


@dataclass(frozen=True)
class Tried:
    """One simulated round with its belief update.

    Attributes:
        asked: Attempts of the round.
        rollouts: Rollout of each row, (R,); meaningless for an inactive row.
        beliefs: Posterior of each row, (R,); likewise.
        confirmed: Posterior of the rows whose peg went in, (R,); None: an insertion is not questioned.
    """

    asked: Try
    rollouts: Rollout
    beliefs: Belief
    confirmed: Belief | None = None


def attempt_rounds(
    next_try: Callable[[], Try | None],
    engine: Engine,
    update: Update,
    actions: int,
    confirm: Update | None = None,
) -> Iterator[Tried]:
    """Simulate rounds of attempts and update the beliefs after each, until no attempt is left.

    Args:
        next_try: Returns the next round, or None at the end. The loop calls it only after the caller has
            consumed the previous round, so the caller can record a round before the next one is requested.
        engine: Simulates the attempts of all active rows together.
        update: The belief update.
        actions: Maximum number of actions in one attempt.
        confirm: The belief update after an insertion; None: insertions are not questioned.
    """
    while (asked := next_try()) is not None:
        rollouts = engine.run(_with_beliefs(asked), actions, asked.active)
        beliefs, confirmed = asked.beliefs, None
        if asked.noise_keys is not None:
            if engine.policy_name == GEOMETRIC:
                # Particles that follow an attempt lose places that later rows make probable again: the whole
                # attempt is read anew, and what it searched in vain counts.
                rollouts = replace(rollouts, report=None)
            beliefs = after_failures(update, asked.beliefs, rollouts, asked.noise_keys)
            if confirm is not None:
                confirmed = after_insertions(confirm, asked.beliefs, rollouts, asked.noise_keys)
        yield Tried(asked, rollouts, beliefs, confirmed)


def _with_beliefs(asked: Try) -> Attempt:
    """Return the attempts with the belief that each starts from, for policies that update it themselves."""
    if asked.attempts.belief is not None:
        return asked.attempts
    return replace(asked.attempts, belief=jax.tree.map(jnp.asarray, asked.beliefs))


def placed_as(beliefs: Belief, others: Belief, where: Bool[np.ndarray, "*batch"]) -> Belief:
    """Return beliefs with the positions of others where asked, for any batch axes."""
    return replace(
        beliefs,
        mean_world=np.where(where[..., None], others.mean_world, beliefs.mean_world),
        cov=np.where(where[..., None, None], others.cov, beliefs.cov),
    )


def spirals_at(
    peg_type: Int[Array, "R"],
    hole_type: Int[Array, "R"],
    hole_pos_world: Float[Array, "R 2"],
    estimate_world: Float[Array, "R D"],
    keys: Key[Array, "R"],
    physics: Physics = AS_CONFIGURED,
) -> Attempt:
    """Make attempts (R,) with the paper's spiral search.

    Args:
        peg_type: Type of the peg in hand.
        hole_type: Type of the hole.
        hole_pos_world: True position of the hole, m.
        estimate_world: Estimate that the attempt starts from, m and rad.
        keys: Seeds of the exploration noise.
        physics: Quantities that each world has of its own.
    """
    return Attempt(
        peg_type=jnp.asarray(peg_type),
        hole_type=jnp.asarray(hole_type),
        hole_pos_world=jnp.asarray(hole_pos_world),
        estimate_world=jnp.asarray(estimate_world),
        policy=jnp.full(len(estimate_world), SPIRAL),
        key=keys,
        physics=physics,
    )
