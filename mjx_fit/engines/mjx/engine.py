"""MJX engine: one jitted function with scans over actions and simulation steps and a vmap over worlds."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool

from mjx_fit.config.schema import Config
from mjx_fit.control import policies
from mjx_fit.control.framed import acting
from mjx_fit.control.kinematics import chain_of
from mjx_fit.control.policies import Policy
from mjx_fit.engines import attempt_rules
from mjx_fit.engines.mjx.compiler import compiler_options
from mjx_fit.engines.mjx.step import Models
from mjx_fit.engines.mjx.world import World
from mjx_fit.engines.requests import ANY_POLICY, MOST_THREADS, require_attempts, require_count
from mjx_fit.engines.threads import on_threads, silence_mujoco
from mjx_fit.scene.build import pair_index, simulation_scene
from mjx_fit.scene.placement import setting_of
from mjx_fit.scene.slip import with_grasp
from mjx_fit.types import Array, Attempt, Rollout
from mjx_fit.utils import granted_cpus, interrupts, numerics

MOST_ROWS = 128
"""Maximum number of worlds in one computation on a CPU, to keep its working set small.

The actual number depends on the batch alone, because arithmetic may differ in the last bit between numbers of
rows. No stage calls LAPACK: batches of its calls inside loops can deadlock (jaxlib 0.10;
experiments/physics/deadlock.py demonstrates it).
"""


class MjxEngine:
    """Engine that runs attempts in MJX; see ``mjx_fit.engines.interface.Engine``.

    XLA runs this computation on a single thread of a CPU, so each host thread processes a part of the batch.
    The batch is one computation on an accelerator.
    """

    name = "mjx"

    def __init__(self, config: Config, threads: int, policy: Policy | None = None):
        """Compile the scene.

        Args:
            config: The configuration.
            threads: Number of host threads, if the device is a CPU.
            policy: Custom policy; None: the policy that each attempt names.

        Raises:
            RequestError: The number of threads is invalid.
        """
        numerics.require()
        threads = require_count("threads", threads, 1, MOST_THREADS)
        silence_mujoco()
        self.scene = simulation_scene(config.scene)
        self._models = Models.of(self.scene)
        self._chain = chain_of(self.scene.models[0], self.scene.robot)
        self.config = config
        self._world = World(config, self.scene, acting(policy, config))
        self.turns = self._world.policy.turns
        self._policies = len(policies.NAMES) if policy is None else ANY_POLICY
        self.policy_name = None if policy is None else policy.name
        self._policy = policy
        self._threads = threads if jax.default_backend() == "cpu" else 1
        static = ("actions", "horizon")
        self._jitted = jax.jit(self._rollout, static_argnames=static, compiler_options=compiler_options())
        self._compiled: dict[tuple, jax.stages.Compiled] = {}

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
        n = len(attempts.peg_type)
        rows = rows_of(n)
        rollout = self._executable(attempts, rows, actions, horizon)
        starts = range(0, n, rows)
        done: dict[int, Rollout] = {}

        def run_part(start: int) -> None:
            interrupts.check()
            ids = np.arange(start, start + rows)
            part = jax.tree.map(lambda leaf: leaf[np.minimum(ids, n - 1)], attempts)
            done[start] = jax.tree.map(np.asarray, rollout(part, active[np.minimum(ids, n - 1)] & (ids < n)))

        on_threads(self._threads, run_part, starts)
        return jax.tree.map(lambda *parts: np.concatenate(parts)[:n], *(done[start] for start in starts))

    def _executable(self, attempts: Attempt, rows: int, actions: int, horizon: int) -> jax.stages.Compiled:
        key = (jax.tree.structure(attempts), rows, actions, horizon)
        if key not in self._compiled:

            def shape(leaf):
                return jax.ShapeDtypeStruct((rows, *leaf.shape[1:]), leaf.dtype)

            run = jax.tree.map(shape, attempts), jax.ShapeDtypeStruct((rows,), bool)
            lowered = self._jitted.lower(*run, actions=actions, horizon=horizon)
            self._compiled[key] = lowered.compile()
        return self._compiled[key]

    def _rollout(self, attempts: Attempt, active: Bool[Array, "n"], actions: int, horizon: int) -> Rollout:
        pair = pair_index(attempts.peg_type, attempts.hole_type, self.scene.n_types)
        attempts = replace(attempts, physics=with_grasp(attempts.physics, self.config, len(pair)))
        models, axes = self._models.of_worlds(pair, attempts.physics)
        setting = setting_of(attempts.hole_pos_world, attempts.physics, self.config)
        models, axes = models._replace(setting=setting), axes._replace(setting=0)
        qpos = attempt_rules.start_qpos(self._chain, attempts, self.config)
        world = partial(self._world.rollout, actions=actions, horizon=horizon)
        # Matrix products in lower precision (TF32 on some accelerators) break the constraint solver.
        with jax.default_matmul_precision("highest"):
            return jax.vmap(world, (axes, 0, 0, 0))(models, qpos, attempts, active)


def rows_of(n: int) -> int:
    """Return the number of worlds in one computation; a CPU gets at least two parts, for two threads."""
    if jax.default_backend() != "cpu":
        return n
    return -(-n // max(2, -(-n // MOST_ROWS)))


def _made_here(config: Config, policy: Policy | None) -> MjxEngine:
    return MjxEngine(config, granted_cpus.cpus(), policy)
