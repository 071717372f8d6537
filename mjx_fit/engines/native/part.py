"""Part of a batch of attempts in MuJoCo's C engine, run by one host thread."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco.batch import Batch

from mjx_fit.control.goals import Goal
from mjx_fit.engines import attempt_rules
from mjx_fit.engines.attempt_rules import Verdict
from mjx_fit.engines.native.block import Block
from mjx_fit.engines.native.controller import Brain, padded, rows_for
from mjx_fit.engines.native.drive import driven
from mjx_fit.engines.policy_runner import Memory, at_rest
from mjx_fit.scene.placement import GRASP, Setting
from mjx_fit.types import Attempt, Rollout

ROUNDING = 1e-7
"""Moves of a peg in the hand up to this, m and rad, are rounding."""
OnStep = Callable[[Int[np.ndarray, "m"], Batch], None]


@dataclass
class Part:
    """Part of a batch of attempts, run by one thread.

    Attributes:
        brain: Control and policy.
        block: Simulations of the attempts.
        attempts: The attempts, (m,).
        memory: Memory of the policy for the simulations that ``brain`` receives, padded.
        setting: Settings of the simulations that ``brain`` receives, padded.
        ids: Indices of the attempts in the batch.
        done: Results: arrays over the whole batch, modified in place.
        on_step: Callback, see ``NativeEngine``.
    """

    brain: Brain
    block: Block
    attempts: Attempt
    memory: Memory
    setting: Setting
    ids: Int[np.ndarray, "m"]
    done: Rollout
    on_step: OnStep | None

    def __post_init__(self) -> None:
        self._limited = np.zeros(len(self.ids), np.int32)
        # Finished simulations stay among the shown ones until a smaller number of rows suffices.
        self._running = self._shown = np.arange(len(self.ids))
        self._tell_running()

    @property
    def rows(self) -> int:
        """Number of rows that the controller computes."""
        return len(self.memory.running)

    def move(
        self,
        qpos: Float[np.ndarray, "m joints"],
        qvel: Float[np.ndarray, "m joints"],
        goal: Goal | None = None,
    ) -> None:
        """Set the state of the simulations before their first action, and their goals if not at rest."""
        self.block.move(qpos, qvel)
        if goal is None:
            tip = self.brain.tip(self.block.packed(), self.memory.physics)
            goal = at_rest(self.brain.policy, self.brain.config, self.memory.start, tip.pos_world)
        else:
            goal = padded(goal, np.arange(len(qpos)))
        self.memory = replace(self.memory, goal=goal)

    def act(self, step: int, horizon: int) -> bool:
        """Simulate and record action ``step`` of the running attempts; return True if any is unfinished."""
        before = self.block.qpos.copy(), self.block.qvel.copy()
        state, *acted = self.brain.act(self.memory, self.block.packed(), step, horizon)
        command, wanted, told, ends = jax.tree.map(np.asarray, acted)
        watched = None if self.on_step is None else partial(self.on_step, self.ids, self.block.batch)
        goal = driven(self.brain, self.block, self.memory, wanted, watched)
        felt = padded(self.block.wrench.swapaxes(0, 1), self._shown)
        self.memory = replace(self.memory, state=state, wrench_sensor=felt, command_world=command, goal=goal)
        place = np.searchsorted(self._shown, self._running)
        for stored, now in zip(jax.tree.leaves(self.done.report), jax.tree.leaves(told), strict=True):
            stored[self.ids[self._running], step] = now[place]
        verdict = self._recorded(step, command, before)
        if self.brain.config.placement.slips:
            self._slip(np.flatnonzero(verdict.valid))
        over = np.asarray(verdict.over) | ends[place]
        self._leave_out(over)
        return not bool(over.all())

    def _recorded(self, step: int, command: np.ndarray, before: tuple[np.ndarray, np.ndarray]) -> Verdict:
        """Record the action of the running attempts and return the verdict."""
        block, done, running = self.block, self.done, self._running
        place, ids = np.searchsorted(self._shown, running), self.ids[running]
        end = self.brain.end(self.memory, block.packed(), self.setting, step + 1)
        tip, peg, sensed = jax.tree.map(lambda leaf: np.asarray(leaf)[place], end)
        row = attempt_rules.trace_row(tip, block.wrench.swapaxes(0, 1)[running], command[place])
        for stored, now in zip(jax.tree.leaves(done.felt.trace), jax.tree.leaves(row), strict=True):
            stored[ids, step] = now
        at_limit, limited = block.at_limit()[running], self._limited[running]
        hole = np.asarray(self.setting.hole_pos_world)[place]
        verdict = attempt_rules.judge(
            peg, hole, block.finite()[running], at_limit, limited, self.brain.config
        ).as_sensed(sensed)
        self._limited[running] = verdict.limited
        done.felt.length[ids] = step + 1
        ends = (done.truth.valid, done.truth.inserted, done.sensed)
        for stored, now in zip(ends, (verdict.valid, verdict.inserted, verdict.sensed), strict=True):
            if stored is not None:
                stored[ids] = now
        end = (done.truth.end_qpos, block.qpos, before[0]), (done.truth.end_qvel, block.qvel, before[1])
        for stored, now, old in end:
            stored[ids] = np.where(verdict.valid[:, None], now[running], old[running])
        return verdict

    def _slip(self, valid: Int[np.ndarray, "v"]) -> None:
        """Move the pegs of these running attempts in the hand, where the grip did not hold them."""
        memory, rows = self.memory, self._running[valid]
        place = np.searchsorted(self._shown, rows)
        before, after = (
            jax.tree.map(np.array, physics) for physics in (memory.physics, self.brain.slip(memory))
        )
        moved = np.zeros(len(place), bool)
        for name in GRASP:
            old, new = getattr(before, name), getattr(after, name)[place]
            moved |= np.abs(new - old[place]) > ROUNDING
            old[place] = new
        if not moved.any():
            return
        self.memory = replace(memory, physics=before)
        self.setting = self.brain.setting(self.setting.hole_pos_world, before)
        kept = self.done.truth.physics
        for name in GRASP:
            getattr(kept, name)[self.ids[rows]] = getattr(before, name)[place]
        rows, place = rows[moved], place[moved]
        own = jax.tree.map(lambda leaf: leaf[rows], self.attempts)
        own = replace(own, physics=jax.tree.map(lambda leaf: leaf[place], before))
        self.block.hold(rows, own, jax.tree.map(lambda leaf: leaf[place], self.setting))

    def _leave_out(self, over: Bool[np.ndarray, "r"]) -> None:
        """Freeze the finished attempts, and reduce the number of controller rows where possible."""
        if not over.any() or over.all():
            return
        self._running = self._running[~over]
        self.block.run_only(self._running)
        rows = rows_for(len(self._running))
        if rows < len(self.memory.key):
            kept = np.searchsorted(self._shown, self._running)
            self.memory, self.setting = padded(self.memory, kept), padded(self.setting, kept)
            self._shown = self._running
            self.block.show(self._shown, rows)
        self._tell_running()

    def _tell_running(self) -> None:
        """Tell the policy which of the controller's rows count."""
        counts = np.zeros(self.rows, bool)
        counts[np.searchsorted(self._shown, self._running)] = True
        self.memory = replace(self.memory, running=counts)
