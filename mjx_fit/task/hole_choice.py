"""Choose the next hole: by the chance of an attempt, as in the paper, or by the insertions per second.

A visit to hole j with belief Σ inserts the peg with probability ξ_j, that the types match, and takes the time
of the move and of the search: the rate is ξ_j / (move + search). Where an object is hidden in one of several
places, the best next place is the one with the highest ratio of probability to cost (Black, "Discrete
sequential search", 1965). The policy ``seek`` compares the same rates inside a visit, so one rule tells where
to go and when to leave.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.control.search import visit_s
from mjx_fit.filters.outcome_model import success_probability
from mjx_fit.task import greedy
from mjx_fit.task.assembly_snapshot import Choice
from mjx_fit.task.effort import move_time_s
from mjx_fit.types import Array, Belief


class Situation(NamedTuple):
    """Situation of R assemblies before an attempt.

    Attributes:
        beliefs: Beliefs about the holes, (R, n).
        peg_type: Type of the peg in hand.
        filled: Whether each hole is filled.
        tries: Number of attempts at each hole with the peg in hand.
        from_world: Place of the peg, m. A new peg begins above its first hole: its first move takes no time.
    """

    beliefs: Belief
    peg_type: Int[np.ndarray, "R"]
    filled: Bool[np.ndarray, "R n"]
    tries: Int[np.ndarray, "R n"]
    from_world: Float[np.ndarray, "R 2"]


def choose(now: Situation, config: Config) -> tuple[Choice, Float[np.ndarray, "R"] | None]:
    """Choose a hole for each row by ``task.next_hole``; see ``by_chance`` and ``by_rate``."""
    return (by_rate if config.task.next_hole == "rate" else by_chance)(now, config)


def by_chance(now: Situation, config: Config) -> tuple[Choice, None]:
    """Choose the hole with the highest success chance; the paper's greedy policy."""
    return Choice(*map(np.asarray, _most_likely(now._replace(from_world=np.zeros(0)), config))), None


def best_hole(
    beliefs: Belief,
    peg_type: int,
    filled: Bool[np.ndarray, "n"],
    tries: Int[np.ndarray, "n"],
    config: Config,
) -> int:
    """Return the hole with the highest success chance in one assembly."""
    rows = jax.tree.map(lambda leaf: np.asarray(leaf)[None], beliefs)
    now = Situation(rows, np.array([peg_type]), filled[None], tries[None], np.zeros(0))
    return int(by_chance(now, config)[0].hole[0])


def by_rate(now: Situation, config: Config) -> tuple[Choice, Float[np.ndarray, "R"]]:
    """Choose the empty hole with the highest rate.

    Returns:
        The choice, with the chances of a match, and the highest rate of the other holes from there on, 1/s.
        It is 0 where they are filled: nobody takes the peg away from the last hole.
    """
    rows = np.arange(len(now.peg_type))
    moves = now.tries.any(1, keepdims=True)
    rate = np.where(moves, rates_per_s(now, now.from_world, config), rates_per_s(now, None, config))
    hole = np.where(now.filled, -1.0, rate).argmax(1)
    there = rates_per_s(now, np.asarray(now.beliefs.pos_mean_world)[rows, hole], config)
    others = ~now.filled & (np.arange(now.filled.shape[1]) != hole[:, None])
    match = _match(now)
    best = np.where(others, match, -1.0).max(1)
    choice = Choice(hole, match[rows, hole], np.where(best < 0, np.nan, best))
    return choice, np.where(others, there, 0.0).max(1).astype(np.float32)


def rates_per_s(
    now: Situation, from_world: Float[np.ndarray, "R 2"] | None, config: Config
) -> Float[np.ndarray, "R n"]:
    """Compute the insertions per second that a visit to each hole promises, after a move from a place."""
    mean, match = np.asarray(now.beliefs.pos_mean_world), _match(now)
    moves = np.zeros(match.shape)
    if from_world is not None:
        here = np.broadcast_to(from_world[:, None], mean.shape).reshape(-1, 2)
        moves = move_time_s(here, mean.reshape(-1, 2), config.moves).reshape(match.shape)
    spread = np.trace(now.beliefs.pos_cov, axis1=-2, axis2=-1)
    return match / (moves + np.asarray(visit_s(spread, config.seek)))


def _match(now: Situation) -> Float[np.ndarray, "R n"]:
    """Return the probability that each hole matches the peg."""
    logp = np.take_along_axis(now.beliefs.type_logp, now.peg_type[:, None, None], -1)
    return np.exp(logp[..., 0])


@partial(jax.jit, static_argnames="config")
def _most_likely(now: Situation, config: Config) -> tuple[Array, Array, Array]:
    alpha = success_probability(config, now.beliefs.pos_cov)
    reward = greedy.expected_reward(now.beliefs.type_logp, now.peg_type, alpha)
    hole = greedy.greedy(reward, now.filled, now.tries)
    chance = jnp.take_along_axis(reward, hole[:, None], axis=1)[:, 0]
    return hole, chance, greedy.runner_up(reward, now.filled, hole)


def of_a_human(
    hole_type: Int[np.ndarray, "R n"], peg_type: Int[np.ndarray, "R"], empty: Bool[np.ndarray, "R n"]
) -> Int[np.ndarray, "R"]:
    """Return the hole that a human fills: the first empty one of the peg's type, or else the first."""
    matching = (hole_type == peg_type[:, None]) & empty
    return np.where(matching.any(1, keepdims=True), matching, empty).argmax(1)
