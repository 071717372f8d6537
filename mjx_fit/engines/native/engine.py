"""Native engine: MuJoCo's C engine on host threads, with the control and policies of the MJX engine.

Each host thread runs the attempts of a block of worlds. A block is small enough for the thread's cache and
large enough to amortise the control, one jitted function over the block. The trace of an attempt is
independent of the other attempts in the batch and of their number.
"""

from dataclasses import replace
from typing import Any

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
from mjx_fit.engines.native.block import Block, batch_at_rest
from mjx_fit.engines.native.controller import ROWS, Brain, padded, rows_for
from mjx_fit.engines.native.models import Models
from mjx_fit.engines.native.part import OnStep, Part
from mjx_fit.engines.requests import ANY_POLICY, MOST_THREADS, require_attempts, require_count
from mjx_fit.engines.threads import OneByOne, on_threads, parts_of, silence_mujoco
from mjx_fit.scene.build import simulation_scene
from mjx_fit.scene.slip import with_grasp
from mjx_fit.types import Attempt, Rollout
from mjx_fit.utils import granted_cpus, interrupts, numerics


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
        self._policy = policy
        self._brain = Brain(self.scene, config, acting(policy, config))
        self.turns = self._brain.policy.turns
        self._models = Models(self.scene)
        self._compiling = OneByOne()

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel as what it was made of: elsewhere it has the threads that are granted there."""
        return _made_here, (self.config, self._policy)

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
        attempts = self._gripped(attempts)
        done = self._nothing_done(attempts, actions)
        wanted = np.flatnonzero(active)
        parts = [wanted[part] for part in parts_of(len(wanted), self._threads, ROWS[-1])]

        def run_part(ids: Int[np.ndarray, "m"]) -> None:
            with self._compiling.at_first(("begin", rows_for(len(ids)))):
                part = self._part(attempts, ids, done)
            for step in range(actions):
                interrupts.check()
                with self._compiling.at_first((horizon, part.rows)):
                    goes_on = part.act(step, horizon)
                if not goes_on:
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
        attempts = self._gripped(attempts)
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

    def _gripped(self, attempts: Attempt) -> Attempt:
        return replace(attempts, physics=with_grasp(attempts.physics, self.config, len(attempts.peg_type)))

    def _nothing_done(self, attempts: Attempt, actions: int) -> Rollout:
        joints, turns = len(self.scene.robot.joints), self._brain.policy.turns
        done = attempt_rules.nothing_done(attempts, actions, joints, self.config, turns=turns)
        return replace(done, report=self._brain.no_report(attempts, actions))

    def _part(self, attempts: Attempt, ids: Int[np.ndarray, "m"], done: Rollout) -> Part:
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
        return Part(self._brain, block, own, memory, setting, ids, done, self._on_step)


def _made_here(config: Config, policy: Policy | None) -> NativeEngine:
    return NativeEngine(config, granted_cpus.cpus(), policy)
