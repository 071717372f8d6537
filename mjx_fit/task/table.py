"""The state of many assemblies at once: a row is one trial under one method."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config import Config
from mjx_fit.filters.belief import initial_belief
from mjx_fit.filters.success import success_probability
from mjx_fit.policies import SPIRAL
from mjx_fit.randomness import root_key
from mjx_fit.settings import N_TYPES
from mjx_fit.task import pomdp
from mjx_fit.task.diary import Diary, believed
from mjx_fit.task.learning import Learn
from mjx_fit.task.methods import KNOWN_VARIANCE_M2, Method
from mjx_fit.task.trials import Trials
from mjx_fit.types import Array, Attempt, Belief, Interaction
from mjx_fit.wrist import peak_force

_LOG_IMPOSSIBLE = -30.0
"""ln ξ of a type that is known to be wrong: small enough to mean never, and finite."""


@dataclass(frozen=True)
class State:
    """Where all rows stand, R of them with n holes each.

    Attributes:
        active: Which rows have pegs left.
        peg: Number of the peg in hand, from 0.
        beliefs: About every hole, (R, n).
        filled: Which holes are, by the robot or by a human.
    """

    active: Bool[np.ndarray, "R"]
    peg: Int[np.ndarray, "R"]
    beliefs: Belief
    filled: Bool[np.ndarray, "R n"]


@dataclass(frozen=True)
class Choice:
    """What each row tries next, and why.

    Attributes:
        hole: Which.
        chance: How likely the attempt is thought to succeed.
        next_best: The same of the best of the other empty holes; NaN where there is none.
    """

    hole: Int[np.ndarray, "R"]
    chance: Float[np.ndarray, "R"]
    next_best: Float[np.ndarray, "R"]


class Table:
    """The state of all rows, method by method, trial by trial: R = methods x trials."""

    def __init__(self, config: Config, methods: tuple[Method, ...], trials: Trials, seed: int):
        self._config, self._methods, self._n_trials = config, methods, len(trials.hole_type)
        self._world = jax.tree.map(
            lambda leaf: np.tile(leaf, (len(methods), *[1] * (leaf.ndim - 1))), trials.__dict__
        )
        n_rows, n = self._world["hole_type"].shape
        self._trial = self._world["trial"]
        self._beliefs = self._initial_beliefs()
        self._filled = np.zeros((n_rows, n), bool)
        self._tries = np.zeros((n_rows, n), np.int32)
        self._attempts, self._human = np.zeros((n_rows, n), int), np.zeros((n_rows, n), bool)
        self._diary = Diary(n_rows, n)
        self.pegs_done = np.zeros(n_rows, int)
        self._root = root_key(seed, "assembly: attempts")
        self._keys = jax.jit(jax.vmap(self._attempt_keys))
        self._choose = jax.jit(self._greedy)

    @property
    def active(self) -> Bool[np.ndarray, "R"]:
        """Rows that have pegs left."""
        return self.pegs_done < self._filled.shape[1]

    def leave_out_all_but(self, row: int) -> None:
        """Takes the other rows for done."""
        self.pegs_done[np.arange(len(self.pegs_done)) != row] = self._filled.shape[1]

    def now(self) -> State:
        """A copy of where the rows stand."""
        beliefs = jax.tree.map(np.copy, self._beliefs)
        return State(self.active, self._peg_number(), beliefs, self._filled.copy())

    def choose(self) -> Choice:
        """The hole that each row tries next."""
        chosen = self._choose(self._beliefs, self._peg(), self._filled, self._tries)
        return Choice(*map(np.asarray, chosen))

    def keys(self) -> tuple[Key[Array, "R"], Key[Array, "R"]]:
        """Sources of the wiggle and of the sensor noise of each row's next attempt."""
        return self._keys(self._trial, self._peg_number(), self._attempt_number())

    def attempts(self, chosen: Int[np.ndarray, "R"], wiggle_keys: Key[Array, "R"]) -> Attempt:
        """The attempts of a round."""
        rows = np.arange(len(chosen))
        return Attempt(
            peg_type=jnp.asarray(self._peg()),
            hole_type=jnp.asarray(self._world["hole_type"][rows, chosen]),
            hole_pos_world=jnp.asarray(self._world["hole_pos_world"][rows, chosen]),
            estimate_world=jnp.asarray(self._beliefs.pos_mean_world[rows, chosen]),
            policy=jnp.full(len(chosen), SPIRAL),
            key=wiggle_keys,
        )

    def learn(
        self,
        choice: Choice,
        interactions: Interaction,
        noise_keys: Key[Array, "R"],
        learn: Learn,
    ) -> None:
        """Updates the beliefs about the holes that were tried."""
        chosen, rows = choice.hole, np.arange(len(choice.hole))
        before = self._belief_about(chosen)
        position = self._of(lambda method: method.learns_position)
        kind = self._of(lambda method: method.learns_type)
        after = learn(before, interactions, noise_keys, position, kind)
        open_rows = rows[self.active]
        for leaf, new in zip(jax.tree.leaves(self._beliefs), jax.tree.leaves(after), strict=True):
            leaf[open_rows, chosen[open_rows]] = np.asarray(new)[open_rows]
        failed = self.active & np.asarray(interactions.valid & ~interactions.inserted)
        for trait, tell in (
            (self._of(lambda method: method.learns_truth), _make_known),
            (self._of(lambda method: method.learns_match), self._tell_match),
        ):
            told = rows[failed & trait]
            tell(self._beliefs, self._world, (told, chosen[told]))
        self._note(choice, interactions, before)

    def record(self, chosen: Int[np.ndarray, "R"], interactions: Interaction) -> None:
        """Counts the attempts, fills holes, lets a human help at the cap, and hands out the next pegs."""
        rows, inserted = np.flatnonzero(self.active), np.asarray(interactions.inserted)
        peg, hole = self.pegs_done[rows], chosen[rows]
        self._attempts[rows, peg] += 1
        self._tries[rows, hole] += 1
        helped = ~inserted[rows] & (self._attempts[rows, peg] == self._config.task.max_attempts)
        # The human fills the first empty hole that truly matches; if another peg sits in it, any empty one.
        matching = (self._world["hole_type"] == self._peg()[:, None]) & ~self._filled
        best = np.where(matching.any(1, keepdims=True), matching, ~self._filled)
        hole = np.where(helped, best[rows].argmax(1), hole)
        self._human[rows, peg] = helped
        done = inserted[rows] | helped
        self._filled[rows[done], hole[done]] = True
        self._tries[rows[done]] = 0
        self.pegs_done[rows[done]] += 1

    def rows(self) -> list[dict]:
        """What happened, ready for the result file."""
        names = self._config.scene.names
        return [
            {
                "trial": int(self._trial[row]),
                "method": self._methods[row // self._n_trials].name,
                "pegs": [names[peg] for peg in self._world["peg_type"][row]],
                "attempts": self._attempts[row].tolist(),
                "human": self._human[row].tolist(),
                "holes": [names[hole] for hole in self._world["hole_type"][row]],
                **self._diary.of(row),
            }
            for row in range(len(self._trial))
        ]

    def _belief_about(self, chosen: Int[np.ndarray, "R"]) -> Belief:
        """What each row believes of one of its holes."""
        return jax.tree.map(lambda leaf: leaf[np.arange(len(chosen)), chosen], self._beliefs)

    def _note(self, choice: Choice, interactions: Interaction, before: Belief) -> None:
        """What was tried and why, what was believed of it before and after, and how hard it pressed."""
        chosen, rows = choice.hole, np.flatnonzero(self.active)
        position = self._world["hole_pos_world"][np.arange(len(chosen)), chosen]
        match, error = believed(before, self._peg(), position)
        match_after, error_after = believed(self._belief_about(chosen), self._peg(), position)
        columns = {
            "tried": chosen,
            "chance": choice.chance,
            "next_best": choice.next_best,
            "match_probability": match,
            "error_cm": error,
            "peak_force_n": np.round(peak_force(interactions), 1),
            "match_after": match_after,
            "error_after_cm": error_after,
        }
        own = {name: values[rows] for name, values in columns.items()}
        self._diary.write(rows, self.pegs_done[rows], **own)

    def _tell_match(self, beliefs: Belief, world: dict[str, np.ndarray], which: Any) -> None:
        """Puts the true position, and whether the type is that of the peg in hand, into some beliefs."""
        is_peg = np.arange(N_TYPES) == self._peg()[which[0]][:, None]
        same = (world["hole_type"][which] == self._peg()[which[0]])[:, None]
        beliefs.pos_mean_world[which] = world["hole_pos_world"][which]
        beliefs.pos_cov[which] = KNOWN_VARIANCE_M2 * np.eye(2)
        left = np.where(is_peg == same, beliefs.type_logp[which], _LOG_IMPOSSIBLE)
        beliefs.type_logp[which] = left - np.logaddexp.reduce(left, axis=1, keepdims=True)

    def _initial_beliefs(self) -> Belief:
        """Beliefs (R, n) as writable arrays: the detector's, or the truth for a method that knows it."""
        world = self._world
        detected = initial_belief(
            jnp.asarray(world["estimate_world"]), self._config.detector.prior_std_m, N_TYPES
        )
        beliefs = jax.tree.map(np.array, detected)
        _make_known(beliefs, world, self._of(lambda method: method.knows_truth))
        return beliefs

    def _of(self, trait: Callable[[Method], bool]) -> Bool[np.ndarray, "R"]:
        """Whether each row's method has a trait."""
        return np.repeat([trait(method) for method in self._methods], self._n_trials)

    def _greedy(self, beliefs: Belief, peg_type, filled, tries):
        alpha = success_probability(self._config, beliefs.pos_cov)
        reward = pomdp.expected_reward(beliefs.type_logp, peg_type, alpha)
        hole = pomdp.greedy(reward, filled, tries)
        chance = jnp.take_along_axis(reward, hole[:, None], axis=1)[:, 0]
        return hole, chance, pomdp.runner_up(reward, filled, hole)

    def _attempt_keys(self, trial, peg_number, attempt_number):
        key = self._root
        for part in (trial, peg_number, attempt_number):
            key = jax.random.fold_in(key, part)
        wiggle, noise = jax.random.split(key)
        return wiggle, noise

    def _peg_number(self) -> Int[np.ndarray, "R"]:
        return np.minimum(self.pegs_done, self._filled.shape[1] - 1)

    def _peg(self) -> Int[np.ndarray, "R"]:
        return self._world["peg_type"][np.arange(len(self._trial)), self._peg_number()]

    def _attempt_number(self) -> Int[np.ndarray, "R"]:
        return self._attempts[np.arange(len(self._trial)), self._peg_number()]


def _make_known(beliefs: Belief, world: dict[str, np.ndarray], which: Any) -> None:
    """Puts the truth in the place of the beliefs about some holes, an index into (R, n)."""
    one_hot = np.arange(N_TYPES) == world["hole_type"][which][..., None]
    beliefs.pos_mean_world[which] = world["hole_pos_world"][which]
    beliefs.pos_cov[which] = KNOWN_VARIANCE_M2 * np.eye(2)
    beliefs.type_logp[which] = np.where(one_hot, 0.0, _LOG_IMPOSSIBLE)
