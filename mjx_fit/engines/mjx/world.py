"""One world in MJX: its start, one action of it, and a whole attempt."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int
from mujoco import mjx

from mjx_fit.config.schema import Config
from mjx_fit.control import operational_space
from mjx_fit.control.goals import Goal, after, commanded, goal_during
from mjx_fit.control.policies import Policy
from mjx_fit.engines import attempt_rules, policy_runner
from mjx_fit.engines.attempt_rules import Tip
from mjx_fit.engines.mjx.step import WorldModel, advance, arm_state, free_reading, placed
from mjx_fit.engines.plausible import at_limit
from mjx_fit.engines.policy_runner import Memory
from mjx_fit.scene.build import Scene
from mjx_fit.scene.placement import setting_of
from mjx_fit.scene.slip import slipped
from mjx_fit.types import Array, Attempt, Felt, Rollout, Trace, Truth, pytree
from mjx_fit.types.physics import Physics
from mjx_fit.utils.linalg import worlds_last
from mjx_fit.utils.rates import SUBSTEPS


@pytree
class WorldState:
    """State of one world between actions.

    Attributes:
        data: The simulation; its position and velocity stages are current.
        running: Whether the attempt goes on.
        limited: As in ``attempt_rules.Verdict``.
        memory: Memory of the policy.
    """

    data: mjx.Data
    running: Bool[Array, ""]
    limited: Int[Array, ""]
    memory: Memory


@pytree
class Acted:
    """What an action led to; zero in a world that was not running.

    Attributes:
        row: Row of the trace.
        told: What the policy reports.
        ran: Whether the world was running.
        inserted: Whether the peg is in.
        valid: Whether the simulation is plausible.
        sensed: Whether the robot measures an insertion; None: it relies on the truth.
        peg: The peg as it is judged; None: not recorded.
    """

    row: Trace
    told: Any
    ran: Bool[Array, ""]
    inserted: Bool[Array, ""]
    valid: Bool[Array, ""]
    sensed: Bool[Array, ""] | None
    peg: Tip | None


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

    def begin(
        self,
        start: WorldModel,
        qpos: Float[Array, "joints"],
        attempt: Attempt,
        active: Bool[Array, ""],
    ) -> WorldState:
        """Place the arm in the start posture (rad) of an attempt; an inactive world does not move."""
        data = placed(start, qpos, attempt.hole_pos_world, self.scene.plate_top_m)
        tare = free_reading(start, data)
        here = arm_state(start, data, self.scene).tip_pos_world
        memory = policy_runner.begin(self.policy, self.config, attempt, tare, here)
        return WorldState(data, active, jnp.int32(0), memory)

    def act(
        self,
        start: WorldModel,
        attempt: Attempt,
        world: WorldState,
        step: Int[Array, ""],
        horizon: int,
    ) -> tuple[WorldState, Acted]:
        """Simulate action ``step`` of an attempt whose policy plans for ``horizon`` actions."""
        data, running, config = world.data, world.running, self.config
        memory = replace(world.memory, running=running)
        model = self._held_now(start, attempt, memory.physics)
        arm = arm_state(model, data, self.scene)
        tip = attempt_rules.tip_of(arm, memory.physics, config)
        state, command = policy_runner.act(self.policy, config, horizon, memory, tip, step)
        wanted = commanded(arm.tip_pos_world, command, config.control)
        driven, goal, wrench = self.drive(model, data, memory.goal, wanted, memory.physics)
        tip = attempt_rules.tip_of(arm_state(model, driven, self.scene), memory.physics, config)
        row = attempt_rules.trace_row(tip, wrench, command)
        finite = jnp.isfinite(driven.qpos).all() & jnp.isfinite(driven.qvel).all()
        # Evaluated after the action: one more output of a step would change the rounding of all outputs in
        # XLA.
        limit = at_limit(driven.ctrl, self.scene.robot)
        peg = attempt_rules.peg_of(tip, model.setting, memory.physics, config)
        verdict = attempt_rules.judge(peg, attempt.hole_pos_world, finite, limit, world.limited, config)
        verdict = verdict.as_sensed(policy_runner.measures_insertion(memory, tip, step + 1, config))
        data = jax.tree.map(partial(jnp.where, running & verdict.valid), driven, data)
        made = row, policy_runner.reported(self.policy, state)
        row, told = jax.tree.map(lambda leaf: jnp.where(running, leaf, jnp.zeros_like(leaf)), made)
        memory = replace(memory, state=state, wrench_sensor=wrench, command_world=command, goal=goal)
        if config.placement.slips:
            moved = slipped(memory.physics, wrench, memory.tare_sensor, config)
            moved = jax.tree.map(partial(jnp.where, running & verdict.valid), moved, memory.physics)
            memory = replace(memory, physics=moved)
        over = verdict.over | policy_runner.gives_up(self.policy, state)
        acted = Acted(row, told, running, verdict.inserted, verdict.valid, verdict.sensed, peg)
        return WorldState(data, running & ~over, verdict.limited, memory), acted

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
        begun = self.begin(start, qpos, attempt, active)

        def act(world: WorldState, step: Int[Array, ""]) -> tuple[WorldState, Acted]:
            world, acted = self.act(start, attempt, world, step, horizon)
            return world, replace(acted, peg=None)

        end, acted = jax.lax.scan(act, begun, jnp.arange(actions))
        length = acted.ran.sum()
        flags = acted.inserted, acted.valid, acted.sensed
        inserted, valid, sensed = jax.tree.map(lambda flag: active & flag[length - 1], flags)
        felt = Felt(
            trace=acted.row,
            length=length,
            tare_sensor=jnp.where(active, begun.memory.tare_sensor, 0),
            estimate_world=attempt.estimate_world,
            peg_type=attempt.peg_type,
        )
        truth = Truth(
            hole_type=attempt.hole_type,
            hole_pos_world=attempt.hole_pos_world,
            inserted=inserted,
            valid=valid | ~active,
            end_qpos=jnp.where(active, end.data.qpos, 0),
            end_qvel=jnp.where(active, end.data.qvel, 0),
            physics=end.memory.physics if self.config.placement.slips else attempt.physics,
        )
        return Rollout(felt, truth, acted.told, sensed)

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

    def _held_now(self, start: WorldModel, attempt: Attempt, physics: Physics) -> WorldModel:
        """Return the model with the peg as it has slipped."""
        if not self.config.placement.slips:
            return start
        return start._replace(setting=setting_of(attempt.hole_pos_world, physics, self.config))
