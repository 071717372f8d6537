"""A policy inside a rollout: what it is shown before each action, and what it keeps from one to the next."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int, Key

from mjx_fit import wrist as wrist_
from mjx_fit.policies import Policy, PolicyInput, State, start_of
from mjx_fit.settings import WristConfig
from mjx_fit.simulate.attempt_rules import Tip
from mjx_fit.types import SUBSTEPS, Array, Attempt, pytree

_NOISE = 2**21
"""Keeps the keys of the sensor's noise clear of those that policies derive from the same attempt's."""


@pytree
class Memory:
    """What is kept of one attempt from action to action.

    Attributes:
        state: The policy's.
        tare_sensor: The sensor's reading in free space, as it was measured, N and N·m.
        wrench_sensor: Clean wrenches of the action before, N and N·m.
        noise: Source of the sensor's noise.
    """

    state: State
    tare_sensor: Float[Array, "6"]
    wrench_sensor: Float[Array, "50 6"]
    noise: Key[Array, ""]


def begin(policy: Policy, wrist: WristConfig, attempt: Attempt, tare_sensor: Float[Array, "6"]) -> Memory:
    """The memory before the first action; the wrench is that of free space."""
    noise, tare_key = jax.random.split(jax.random.fold_in(attempt.key, _NOISE))
    return Memory(
        state=policy.init(start_of(attempt), attempt.key),
        tare_sensor=wrist_.measured_tare(tare_sensor, tare_key, wrist),
        wrench_sensor=jnp.broadcast_to(tare_sensor, (SUBSTEPS, 6)),
        noise=noise,
    )


def act(
    policy: Policy, wrist: WristConfig, horizon: int, memory: Memory, tip: Tip, step: Int[Array, ""]
) -> tuple[Memory, Float[Array, "3"]]:
    """The policy's command (m) for one action, and the memory with its new state.

    Args:
        policy: The policy.
        wrist: Noise and threshold of the sensor.
        horizon: Actions that the policy plans for.
        memory: With the wrenches of the action before.
        tip: The tip as the action begins.
        step: Number j of the action.
    """
    key = jax.random.fold_in(memory.noise, step)
    wrench = wrist_.measured(memory.wrench_sensor, memory.tare_sensor, key, wrist)
    seen = PolicyInput(
        step=step,
        tip_pos_world=tip.pos_world,
        tip_quat_world=tip.quat_world,
        tip_linvel_world=tip.linvel_world,
        tip_angvel_world=tip.angvel_world,
        wrench_sensor=wrench,
        contact=wrist_.in_contact(wrench, wrist),
        horizon=horizon,
    )
    state, command = policy.act(memory.state, seen)
    return replace(memory, state=state), command
