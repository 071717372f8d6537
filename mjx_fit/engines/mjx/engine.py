"""MJX engine: one jitted function with scans over actions and simulation steps and a vmap over worlds."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from mujoco import mjx

from mjx_fit.config.schema import Config
from mjx_fit.control import operational_space, policies
from mjx_fit.control.framed import acting
from mjx_fit.control.goals import Goal, after, commanded, goal_during
from mjx_fit.control.kinematics import chain_of
from mjx_fit.control.policies import Policy
from mjx_fit.engines import attempt_rules, policy_runner
from mjx_fit.engines.mjx.compiler import compiler_options
from mjx_fit.engines.mjx.step import Models, WorldModel, advance, arm_state, free_reading, placed
from mjx_fit.engines.plausible import at_limit
from mjx_fit.engines.requests import ANY_POLICY, MOST_THREADS, require_attempts, require_count
from mjx_fit.engines.threads import on_threads, silence_mujoco
from mjx_fit.scene.build import Scene, pair_index, simulation_scene
from mjx_fit.scene.placement import setting_of
from mjx_fit.scene.slip import slipped, with_grasp
from mjx_fit.types import Array, Attempt, Felt, Rollout, Truth
from mjx_fit.types.physics import Physics
from mjx_fit.utils import interrupts, numerics
from mjx_fit.utils.linalg import worlds_last
from mjx_fit.utils.rates import SUBSTEPS

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
        self._threads = threads if jax.default_backend() == "cpu" else 1
        static = ("actions", "horizon")
        self._jitted = jax.jit(self._rollout, static_argnames=static, compiler_options=compiler_options())
        self._compiled: dict[tuple, jax.stages.Compiled] = {}

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
        rows = self._rows(n)
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

    def _rows(self, n: int) -> int:
        """Return the number of worlds in one computation; a CPU gets at least two parts, for two threads."""
        if jax.default_backend() != "cpu":
            return n
        return -(-n // max(2, -(-n // MOST_ROWS)))

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


@dataclass(frozen=True)
class World:
    """One world in MJX.

    Attributes:
        config: The configuration.
        scene: Scene of the world.
        policy: Policy that computes the commands.
    """

    config: Config
    scene: Scene
    policy: Policy

    def rollout(
        self,
        start: WorldModel,
        qpos: Float[Array, "joints"],
        attempt: Attempt,
        active: Bool[Array, ""],
        actions: int,
        horizon: int,
    ) -> Rollout:
        """Simulate one attempt from a start posture; an inactive world does not move."""
        data = placed(start, qpos, attempt.hole_pos_world, self.scene.plate_top_m)
        tare = free_reading(start, data)
        slips = self.config.placement.slips

        def held_now(model, physics):
            if not slips:
                return model
            return model._replace(setting=setting_of(attempt.hole_pos_world, physics, self.config))

        def act(carry, step):
            data, running, limited, memory = carry
            memory = replace(memory, running=running)
            model = held_now(start, memory.physics)
            arm = arm_state(model, data, self.scene)
            tip = attempt_rules.tip_of(arm, memory.physics, self.config)
            state, command = policy_runner.act(self.policy, self.config, horizon, memory, tip, step)
            wanted = commanded(arm.tip_pos_world, command, self.config.control)
            driven, goal, wrench = self.drive(model, data, memory.goal, wanted, memory.physics)
            tip = attempt_rules.tip_of(arm_state(model, driven, self.scene), memory.physics, self.config)
            row = attempt_rules.trace_row(tip, wrench, command)
            finite = jnp.isfinite(driven.qpos).all() & jnp.isfinite(driven.qvel).all()
            # Evaluated after the action: one more output of a step would change the rounding of all
            # outputs in XLA.
            limit = at_limit(driven.ctrl, self.scene.robot)
            peg = attempt_rules.peg_of(tip, model.setting, memory.physics, self.config)
            verdict = attempt_rules.judge(peg, attempt.hole_pos_world, finite, limit, limited, self.config)
            verdict = verdict.as_sensed(policy_runner.measures_insertion(memory, tip, step + 1, self.config))
            data = jax.tree.map(partial(jnp.where, running & verdict.valid), driven, data)
            made = row, policy_runner.reported(self.policy, state)
            row, told = jax.tree.map(lambda leaf: jnp.where(running, leaf, jnp.zeros_like(leaf)), made)
            memory = replace(memory, state=state, wrench_sensor=wrench, command_world=command, goal=goal)
            if slips:
                moved = slipped(memory.physics, wrench, tare, self.config)
                moved = jax.tree.map(partial(jnp.where, running & verdict.valid), moved, memory.physics)
                memory = replace(memory, physics=moved)
            over = verdict.over | policy_runner.gives_up(self.policy, state)
            carry = data, running & ~over, verdict.limited, memory
            return carry, (row, told, running, (verdict.inserted, verdict.valid, verdict.sensed))

        begin = arm_state(start, data, self.scene).tip_pos_world
        memory = policy_runner.begin(self.policy, self.config, attempt, tare, begin)
        carry = data, active, jnp.int32(0), memory
        (end, _, _, memory), (trace, report, ran, flags) = jax.lax.scan(act, carry, jnp.arange(actions))
        inserted, valid, sensed = jax.tree.map(lambda flag: active & flag[ran.sum() - 1], flags)
        felt = Felt(
            trace=trace,
            length=ran.sum(),
            tare_sensor=jnp.where(active, tare, 0),
            estimate_world=attempt.estimate_world,
            peg_type=attempt.peg_type,
        )
        truth = Truth(
            hole_type=attempt.hole_type,
            hole_pos_world=attempt.hole_pos_world,
            inserted=inserted,
            valid=valid | ~active,
            end_qpos=jnp.where(active, end.qpos, 0),
            end_qvel=jnp.where(active, end.qvel, 0),
            physics=memory.physics if slips else attempt.physics,
        )
        return Rollout(felt, truth, report, sensed)

    def drive(
        self, model: WorldModel, data: mjx.Data, goal: Goal, next_world: Float[Array, "k"], physics: Physics
    ) -> tuple[mjx.Data, Goal, Float[Array, "50 6"]]:
        """Drive the TCP to the next commanded goal for one action: 50 steps of control and physics.

        The position and velocity stages of the data must be current, and are again on return. The function
        returns the goal at the end, and the wrench (N, N·m) of every step.
        """
        robot = self.scene.robot

        @worlds_last
        def torque(arm, goal, physics):
            gains = operational_space.gains_of(self.config, physics)
            return operational_space.torque(arm, goal, gains, robot)

        def substep(carry, number):
            data, goal = carry
            goal, now = goal_during(goal, next_world, number, self.config.control, physics)
            wanted = torque(arm_state(model, data, self.scene), now, physics)
            data, wrench = advance(model, data, wanted, self.scene.config.physics_steps)
            return (data, goal), wrench

        (data, goal), wrench = jax.lax.scan(substep, (data, goal), jnp.arange(SUBSTEPS))
        return data, after(goal, next_world), wrench
