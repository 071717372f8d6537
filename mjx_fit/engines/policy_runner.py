"""Run a policy inside a rollout: its input before each action, and its memory between actions."""

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int, Key

from mjx_fit.config.sections.world import WristConfig
from mjx_fit.control.policies import Policy, PolicyInput, PolicyStart, State, start_of
from mjx_fit.engines.attempt_rules import Tip
from mjx_fit.sensors import force_torque
from mjx_fit.types import SUBSTEPS, Array, Attempt, pytree

_NOISE = 2**21
"""Offset that separates the noise keys of the F/T sensor from the keys that policies derive."""


@pytree
class Memory:
    """Memory of one attempt between actions.

    Attributes:
        state: State of the policy.
        start: Information that the policy has from the start.
        key: Key of the attempt.
        tare_sensor: Clean reading of the F/T sensor in free space, N and N·m.
        wrench_sensor: Clean wrenches of the previous action, N and N·m.
        goal_pos_world: Goal of the TCP at the end of the previous action, at first its position, m.
    """

    state: State
    start: PolicyStart
    key: Key[Array, ""]
    tare_sensor: Float[Array, "6"]
    wrench_sensor: Float[Array, "50 6"]
    goal_pos_world: Float[Array, "3"]


def begin(
    policy: Policy, attempt: Attempt, tare_sensor: Float[Array, "6"], tip_pos_world: Float[Array, "3"]
) -> Memory:
    """Initialise the memory before the first action, with the wrench of free space and the TCP's position."""
    start = start_of(attempt)
    wrench = jnp.broadcast_to(tare_sensor, (SUBSTEPS, 6))
    return Memory(policy.init(start, attempt.key), start, attempt.key, tare_sensor, wrench, tip_pos_world)


def act(
    policy: Policy, wrist: WristConfig, horizon: int, memory: Memory, tip: Tip, step: Int[Array, ""]
) -> tuple[State, Float[Array, "3"]]:
    """Compute the policy's new state and its command (m) for one action.

    Args:
        policy: The policy.
        wrist: Noise and contact threshold of the F/T sensor.
        horizon: Number of actions that the policy plans for.
        memory: Memory with the wrenches of the previous action.
        tip: TCP state at the start of the action.
        step: Index j of the action.
    """
    tare_key, noise_key = jax.random.split(jax.random.fold_in(memory.key, _NOISE))
    tare = force_torque.measured_tare(memory.tare_sensor, tare_key, wrist)
    wrench = force_torque.measured(memory.wrench_sensor, tare, jax.random.fold_in(noise_key, step), wrist)
    seen = PolicyInput(
        start=memory.start,
        attempt_key=memory.key,
        key=jax.random.fold_in(memory.key, step),
        step=step,
        tip_pos_world=tip.pos_world,
        tip_quat_world=tip.quat_world,
        tip_linvel_world=tip.linvel_world,
        tip_angvel_world=tip.angvel_world,
        wrench_sensor=wrench,
        contact=force_torque.in_contact(wrench, wrist),
        horizon=horizon,
    )
    return policy.act(memory.state, seen)
