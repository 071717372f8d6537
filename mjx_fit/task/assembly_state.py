"""State of many assemblies at once; a row is one trial under one method.

A peg may enter a hole of another type. A method that learns the type judges by what it felt: if the hole is
more likely another's than the peg's own, it pulls the peg out again, and the attempt has failed; so may a
peg be pulled out of its own hole. Otherwise the peg stays and fills the hole: the robot grasps the next peg,
and the attempts count as usual. In a hole of another type it is *inserted wrongly*: neither a success nor a
human intervention. The hole of its own type stays empty, so a later peg whose hole is taken ends in any empty
hole or needs a human, who puts it into the first empty hole. A peg that the robot takes for inserted and that
is not in (``task.success: sensed``) counts as inserted wrongly, too.
"""

from dataclasses import replace
from functools import reduce
from operator import attrgetter

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from mjx_fit.config.schema import Config
from mjx_fit.filters.contact_memory import detected_as
from mjx_fit.filters.updates import detected_belief
from mjx_fit.scene.scenarios import Trials
from mjx_fit.scene.slip import with_grasp
from mjx_fit.task.assembly_snapshot import EMPTY, KEPT_FROM, Choice, State
from mjx_fit.task.attempt_log import Diary, about, believed
from mjx_fit.task.attempt_loop import Tried, Try, spirals_at
from mjx_fit.task.effort import COLUMNS, Travel, effort_of
from mjx_fit.task.hole_choice import Situation, choose, of_a_human
from mjx_fit.task.methods import Method, of_rows
from mjx_fit.task.oracle import reveal_hole, reveal_match, reveal_place
from mjx_fit.task.revisits import Revisits
from mjx_fit.task.shared_grasp import SharedGrasp, in_hand, places_for_tool, regrasped
from mjx_fit.types import Belief, Rollout
from mjx_fit.types.physics import Physics
from mjx_fit.utils.randomness import root_key


class Table:
    """State of all rows, ordered by method, then by trial: R = methods x trials.

    Attributes:
        pegs_done: Number of pegs inserted by the robot or a human, (R,).
        choice: Choice of each row in the latest round.
        attempt_actions: Maximum number of actions in one attempt.
    """

    choice: Choice

    def __init__(self, config: Config, methods: tuple[Method, ...], trials: Trials, seed: int):
        self._config, self._methods, self._n_trials = config, methods, len(trials.hole_type)
        self._world = jax.tree.map(
            lambda leaf: np.tile(leaf, (len(methods), *[1] * (leaf.ndim - 1))), trials.__dict__
        )
        n_rows, n = self._world["hole_type"].shape
        self._world["physics"] = with_grasp(self._world["physics"], config, n_rows, n)
        self._places = places_for_tool(self._world["hole_pos_world"], self._world["physics"], config)
        self._world["place_world"] = self._places[:, 0].copy()
        self._trial, shares = self._world["trial"], config.filter.shares_grasp
        self._detected, self._beliefs = self._initial_beliefs(), self._initial_beliefs()
        self._revisits = Revisits(self._detected, config)
        self._shared = SharedGrasp(self._world["estimate_world"], config) if shares else None
        self._content = np.full((n_rows, n), EMPTY)
        self._revealed = np.repeat(self._of("knows_truth")[:, None], n, 1)
        self._tries, self._attempts = np.zeros((n_rows, n), np.int32), np.zeros((n_rows, n), int)
        self._human, self._wrongly = np.zeros((n_rows, n), bool), np.zeros((n_rows, n), bool)
        self._pulled_out = np.zeros((n_rows, n), int)
        self._travel = Travel(np.asarray(self._beliefs.mean_world).mean(1), config.moves)
        self._diary = Diary(n_rows, n)
        self.pegs_done, self.attempt_actions = np.zeros(n_rows, int), config.task.attempt_actions
        self._root = root_key(seed, "assembly: attempts")
        self._keys = jax.jit(jax.vmap(self._attempt_keys))

    @property
    def active(self) -> Bool[np.ndarray, "R"]:
        """Whether each row has pegs left."""
        return self.pegs_done < self._content.shape[1]

    def leave_out_all_but(self, row: int) -> None:
        """Mark all other rows as done."""
        self.pegs_done[np.arange(len(self.pegs_done)) != row] = self._content.shape[1]

    def now(self) -> State:
        """Return a copy of the current state."""
        return State(self.active, self._peg_number(), *jax.tree.map(np.copy, (self._beliefs, self._content)))

    def next_try(self) -> Try | None:
        """Choose a hole per row and return the next attempts; None once all pegs are inserted."""
        if not self.active.any():
            return None
        detected = self._detected
        if self._shared is not None:
            detected = self._shared.detections(detected, self._of("learns_position"))
        beliefs = self._revisits.started(self._beliefs, detected, self._tries > 0)
        here = self._travel.here_world[:, :2]
        now = Situation(beliefs, self._peg(), self._content != EMPTY, self._tries, here)
        self.choice, elsewhere = choose(now, self._config)
        hole, rows = self.choice.hole, np.arange(len(self._trial))
        wiggle_keys, noise_keys = self._keys(self._trial, self._peg_number(), self._attempt_number())
        hole_type, hole_pos = (self._world[name][rows, hole] for name in ("hole_type", "hole_pos_world"))
        beliefs = detected_as(about(beliefs, hole), about(detected, hole), self._config)
        physics = in_hand(self._world["physics"], self._peg_number(), hole)
        attempts = spirals_at(self._peg(), hole_type, hole_pos, beliefs.mean_world, wiggle_keys, physics)
        return Try(replace(attempts, elsewhere_per_s=elsewhere), self.active, beliefs, noise_keys)

    def learn(self, tried: Tried) -> None:
        """Store the posteriors about the tried holes, and reveal the truth to the upper-bound methods."""
        chosen, rows, happened = self.choice.hole, np.arange(len(self._trial)), tried.rollouts
        kept = self._kept(tried)
        self._store(rows[self.active], tried.beliefs)
        if tried.confirmed is not None:
            self._store(rows[self.active & np.asarray(happened.taken) & ~kept], tried.confirmed)
        failed = self.active & np.asarray(happened.truth.valid) & ~kept
        in_vain = failed & ~np.asarray(happened.taken) & self._of("learns_position")
        self._revisits.note((rows, chosen), in_vain, tried)
        told, match_told = (rows[failed & self._of(trait)] for trait in ("learns_truth", "learns_match"))
        for beliefs in (self._beliefs, self._detected):
            reveal_hole(beliefs, self._world, (told, chosen[told]))
            reveal_match(beliefs, self._world, (match_told, chosen[match_told]), self._peg()[match_told])
        for rows in (told, match_told):
            self._revealed[rows, chosen[rows]] = True
        self._note(happened, tried.asked.beliefs)
        if self._config.placement.slips:
            self._go_on_with(happened.truth.physics)

    def record(self, tried: Tried) -> None:
        """Count the attempts, fill holes, call a human at the attempt limit, and advance to the next pegs."""
        chosen = self.choice.hole
        rows, happened = np.flatnonzero(self.active), tried.rollouts
        inserted = self._kept(tried)
        wrongly = inserted & ~np.asarray(happened.succeeded)
        peg, hole = self.pegs_done[rows], chosen[rows]
        self._attempts[rows, peg] += 1
        self._pulled_out[rows, peg] += (np.asarray(happened.taken) & ~inserted)[rows]
        self._tries[rows, hole] += 1
        helped = ~inserted[rows] & (self._attempts[rows, peg] == self._config.task.max_attempts)
        best = of_a_human(self._world["hole_type"], self._peg(), self._content == EMPTY)
        hole = np.where(helped, best[rows], hole)
        self._human[rows, peg], self._wrongly[rows, peg] = helped, wrongly[rows]
        done = inserted[rows] | helped
        self._content[rows[done], hole[done]] = self._peg()[rows[done]]
        self._tries[rows[done]] = 0
        self._revisits.forget(rows[done])
        self.pegs_done[rows[done]] += 1
        self._take_peg(rows[done])

    def rows(self) -> list[dict]:
        """Return one record per row for the result file."""
        names = self._config.scene.names
        return [
            {
                "trial": int(self._trial[row]),
                "method": self._methods[row // self._n_trials].name,
                "pegs": [names[peg] for peg in self._world["peg_type"][row]],
                "attempts": self._attempts[row].tolist(),
                "human": self._human[row].tolist(),
                **({"inserted_wrongly": self._wrongly[row].tolist()} if self._wrongly[row].any() else {}),
                **({"pulled_out": self._pulled_out[row].tolist()} if self._pulled_out[row].any() else {}),
                "move_seconds": round(float(self._travel.seconds[row]), 4),
                "holes": [names[hole] for hole in self._world["hole_type"][row]],
                **self._diary.of(row),
            }
            for row in range(len(self._trial))
        ]

    def _kept(self, tried: Tried) -> Bool[np.ndarray, "R"]:
        """Tell whose peg is in and stays: by the truth, by the posterior, or always, as the method learns."""
        inserted = np.asarray(tried.rollouts.taken)
        if tried.confirmed is None:
            return inserted
        right = np.asarray(tried.rollouts.succeeded)
        match = np.take_along_axis(np.asarray(tried.confirmed.type_logp), self._peg()[:, None], axis=1)[:, 0]
        judged = np.where(self._of("learns_type"), match >= np.log(KEPT_FROM), True)
        told = self._of("learns_truth") | self._of("learns_match")
        return inserted & np.where(told, right, judged)

    def _store(self, rows: Int[np.ndarray, "k"], beliefs: Belief) -> None:
        """Store the beliefs of some rows about the holes that they tried."""
        chosen, beliefs = self.choice.hole[rows], replace(beliefs, memory=None)
        for leaf, new in zip(jax.tree.leaves(self._beliefs), jax.tree.leaves(beliefs), strict=True):
            leaf[rows, chosen] = np.asarray(new)[rows]
        if self._shared is not None:
            learns = self._of("learns_position")
            self._shared.learn(rows[learns[rows]], self.choice.hole, beliefs)
            self._beliefs = self._shared.beliefs(self._beliefs, learns)

    def _take_peg(self, rows: Int[np.ndarray, "k"]) -> None:
        """Change what depends on the grasp of the peg in hand, for rows with a new one."""
        if self._shared is not None:
            self._shared.new_peg(rows)
            self._beliefs = self._shared.beliefs(self._beliefs, self._of("learns_position"))
        self._hold(rows)

    def _hold(self, rows: Int[np.ndarray, "k"]) -> None:
        """Change where the pegs in hand belong, and tell it to those who know."""
        self._world["place_world"][rows] = self._places[rows, self._peg_number()[rows]]
        known = self._revealed & np.isin(np.arange(len(self._trial)), rows)[:, None]
        for beliefs in (self._beliefs, self._detected):
            reveal_place(beliefs, self._world, known)

    def _go_on_with(self, left: Physics) -> None:
        """Take the grasps that the attempts left for those of the pegs in hand."""
        self._world["physics"] = regrasped(self._world["physics"], self._peg_number(), left, self.active)
        self._places = places_for_tool(self._world["hole_pos_world"], self._world["physics"], self._config)
        self._hold(np.arange(len(self._trial)))

    def _note(self, rollouts: Rollout, before: Belief) -> None:
        """Log the choice, the belief before and after the attempt, and its time and force."""
        chosen, rows = self.choice.hole, np.flatnonzero(self.active)
        position = self._world["place_world"][np.arange(len(chosen)), chosen]
        match, error = believed(before, self._peg(), position)
        match_after, error_after = believed(about(self._beliefs, chosen), self._peg(), position)
        # A peg begins above its first hole.
        effort, start = effort_of(rollouts.felt), np.asarray(rollouts.felt.estimate_world)
        self._travel.go(start, self.active, counted=self._attempt_number() > 0)
        columns = {
            "tried": chosen,
            "chance": self.choice.chance,
            "next_best": self.choice.next_best,
            "match_probability": match,
            "error_cm": error,
            **{name: getattr(effort, name) for name in COLUMNS},
            "match_after": match_after,
            "error_after_cm": error_after,
        }
        self._diary.write(rows, self.pegs_done[rows], **{name: of[rows] for name, of in columns.items()})

    def _initial_beliefs(self) -> Belief:
        """Return writable priors (R, n): from the detector, or the truth if the method knows it."""
        estimate = jnp.asarray(self._world["estimate_world"])
        beliefs = jax.tree.map(np.array, detected_belief(estimate, self._config))
        reveal_hole(beliefs, self._world, self._of("knows_truth"))
        return beliefs

    def _of(self, trait: str) -> Bool[np.ndarray, "R"]:
        return of_rows(self._methods, self._n_trials, attrgetter(trait))

    def _attempt_keys(self, trial, peg_number, attempt_number):
        key = reduce(jax.random.fold_in, (trial, peg_number, attempt_number), self._root)
        return tuple(jax.random.split(key))

    def _peg_number(self) -> Int[np.ndarray, "R"]:
        return np.minimum(self.pegs_done, self._content.shape[1] - 1)

    def _peg(self) -> Int[np.ndarray, "R"]:
        return self._world["peg_type"][np.arange(len(self._trial)), self._peg_number()]

    def _attempt_number(self) -> Int[np.ndarray, "R"]:
        return self._attempts[np.arange(len(self._trial)), self._peg_number()]
