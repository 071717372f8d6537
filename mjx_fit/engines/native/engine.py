"""Native engine: MuJoCo's C engine on host threads, with the control and policies of the MJX engine.

Each host thread runs the attempts of a block of worlds. A block is small enough for the thread's cache and
large enough to amortise the control, one jitted function over the block. The trace of an attempt is
independent of the other attempts in the batch and of their number.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco.batch import Batch

from mjx_fit.config.schema import Config
from mjx_fit.control import policies
from mjx_fit.control.framed import acting
from mjx_fit.control.goals import Goal
from mjx_fit.control.policies import Policy
from mjx_fit.engines import attempt_rules
from mjx_fit.engines.attempt_rules import Verdict
from mjx_fit.engines.native.block import Block, batch_at_rest
from mjx_fit.engines.native.controller import ROWS, Brain, padded, rows_for
from mjx_fit.engines.native.drive import driven
from mjx_fit.engines.native.models import Models
from mjx_fit.engines.policy_runner import Memory, at_rest
from mjx_fit.engines.requests import ANY_POLICY, MOST_THREADS, require_attempts, require_count
from mjx_fit.engines.threads import on_threads, parts_of, silence_mujoco
from mjx_fit.scene.build import simulation_scene
from mjx_fit.scene.placement import Setting
from mjx_fit.types import Attempt, Rollout
from mjx_fit.utils import interrupts, numerics

OnStep = Callable[[Int[np.ndarray, "m"], Batch], None]


class NativeEngine:
    """Engine that runs attempts in MuJoCo's C engine; see ``mjx_fit.engines.interface.Engine``."""

    name = "native"

    def __init__(
        self,
        config: Config,
        threads: int,
        policy: Policy | None = None,
        on_step: OnStep | None = None,
    ):
        """Compile the scene.

        Args:
            config: The configuration.
            threads: Number of host threads that step the worlds.
            policy: Custom policy; None: the policy that each attempt names.
            on_step: Callback after every step of a block, with the ids of its worlds and their batch; several
                threads call it concurrently. For benchmarks and experiments.

        Raises:
            RequestError: The number of threads is invalid.
        """
        numerics.require()
        threads = require_count("threads", threads, 1, MOST_THREADS)
        silence_mujoco()
        self.config, self.scene = config, simulation_scene(config.scene)
        self._threads, self._on_step = threads, on_step
        self._policies = len(policies.NAMES) if policy is None else ANY_POLICY
        self.policy_name = None if policy is None else policy.name
        self._brain = Brain(self.scene, config, acting(policy, config))
        self.turns = self._brain.policy.turns
        self._models = Models(self.scene)

    def run(
        self,
        attempts: Attempt,
        actions: int | None = None,
        active: Bool[np.ndarray, "n"] | None = None,
        horizon: int | None = None,
    ) -> Rollout:
        """See ``Engine.run``."""
        numerics.require()
        actions = self.config.task.attempt_actions if actions is None else actions
        actions, horizon, active = require_attempts(
            attempts, actions, horizon, active, self.config, self._policies
        )
        done = self._nothing_done(attempts, actions)
        wanted = np.flatnonzero(active)
        parts = [wanted[part] for part in parts_of(len(wanted), self._threads, ROWS[-1])]

        def run_part(ids: Int[np.ndarray, "m"]) -> None:
            part = self._part(attempts, ids, done)
            for step in range(actions):
                interrupts.check()
                if not part.act(step, horizon):
                    return

        on_threads(self._threads, run_part, parts)
        return done

    def act(
        self,
        attempts: Attempt,
        qpos: Float[np.ndarray, "m joints"],
        qvel: Float[np.ndarray, "m joints"],
        step: int,
        horizon: int,
        goal: Goal | None = None,
    ) -> Rollout:
        """Simulate one action of up to 64 attempts from any state; only the row of that action is filled.

        The policy acts from its initial state, without earlier measurements.

        Args:
            attempts: Batch of attempts (m,).
            qpos: Joint angles, rad.
            qvel: Joint velocities, rad/s.
            step: Index j of the action.
            horizon: Number of actions that the policy plans for, and of rows in the result.
            goal: Goals (m, 3) before the action; None: the TCPs were at rest.
        """
        done = self._nothing_done(attempts, horizon)
        part = self._part(attempts, np.arange(len(qpos)), done)
        part.move(qpos, qvel, goal)
        part.act(step, horizon)
        return done

    def batch_at_rest(self, attempts: Attempt) -> Batch:
        """Create one batch of C simulations for all attempts, on all threads, at rest at their start."""
        ids = np.arange(len(attempts.peg_type))
        parts = parts_of(len(ids), 1, ROWS[-1])
        begin = [self._brain.start(attempts=padded(attempts, part)) for part in parts]
        starts = [np.asarray(start)[: len(part)] for start, part in zip(begin, parts, strict=True)]
        setting = self._brain.setting(attempts.hole_pos_world, attempts.physics)
        return batch_at_rest(self._models, attempts, setting, np.concatenate(starts), self._threads)

    def _nothing_done(self, attempts: Attempt, actions: int) -> Rollout:
        joints, turns = len(self.scene.robot.joints), self._brain.policy.turns
        done = attempt_rules.nothing_done(attempts, actions, joints, self.config, turns=turns)
        return replace(done, report=self._brain.no_report(attempts, actions))

    def _part(self, attempts: Attempt, ids: Int[np.ndarray, "m"], done: Rollout) -> "_Part":
        """Initialise the attempts with these ids; their results are written into ``done``."""
        rows = padded(attempts, ids)
        start = np.asarray(self._brain.start(attempts=rows))[: len(ids)]
        own = jax.tree.map(lambda leaf: leaf[: len(ids)], rows)
        setting = self._brain.setting(rows.hole_pos_world, rows.physics)
        here = jax.tree.map(lambda leaf: leaf[: len(ids)], setting)
        block = Block(self._models, self._brain.layout, own, here, start, len(rows.peg_type))
        done.felt.tare_sensor[ids] = block.tare_sensor
        at_rest = (block.tare_sensor, np.asarray(block.tip_pos_world, np.float32))
        memory = self._brain.begin(rows, *(padded(one, np.arange(len(ids))) for one in at_rest))
        return _Part(self._brain, block, memory, setting, ids, done, self._on_step)


@dataclass
class _Part:
    """Part of a batch of attempts, run by one thread.

    Attributes:
        brain: Control and policy.
        block: Simulations of the attempts.
        memory: Memory of the policy for the simulations that ``brain`` receives, padded.
        setting: Settings of the simulations that ``brain`` receives, padded.
        ids: Indices of the attempts in the batch.
        done: Results: arrays over the whole batch, modified in place.
        on_step: Callback, see ``NativeEngine``.
    """

    brain: Brain
    block: Block
    memory: Memory
    setting: Setting
    ids: Int[np.ndarray, "m"]
    done: Rollout
    on_step: OnStep | None

    def __post_init__(self) -> None:
        self._limited = np.zeros(len(self.ids), np.int32)
        # Finished simulations stay among the shown ones until a smaller number of rows suffices.
        self._running = self._shown = np.arange(len(self.ids))

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
        over = np.asarray(self._recorded(step, command, before).over) | ends[place]
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
