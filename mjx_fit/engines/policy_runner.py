"""Run a policy inside a rollout: its input before each action, and its memory between actions."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.control import goals
from mjx_fit.control.goals import Goal
from mjx_fit.control.policies import Policy, PolicyInput, PolicyStart, State, start_of
from mjx_fit.engines.attempt_rules import Tip, trace_row
from mjx_fit.filters import frame
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.randomization import draw_errors, with_arrays
from mjx_fit.sensors import distortion, force_torque
from mjx_fit.sensors.contact_rows import with_world_poses
from mjx_fit.sensors.pose import is_exact, measured_trace
from mjx_fit.sensors.reading import read_action
from mjx_fit.types import Array, Attempt, Felt, Reading, Trace, pytree
from mjx_fit.types.physics import Physics
from mjx_fit.utils.rates import SUBSTEPS

_NOISE, _READING, _HEIGHT = 2**21, 2**21 + 1, 2**21 + 2
"""Offsets that separate the keys of errors from those that policies derive: the F/T sensor's and the poses',
those of readings, and that of the socket's height."""


@pytree
class Memory:
    """Memory of one attempt between actions.

    Attributes:
        state: State of the policy.
        start: Information that the policy has from the start.
        key: Key of the attempt.
        tare_sensor: Clean reading of the F/T sensor in free space, N and N·m.
        wrench_sensor: Clean wrenches of the previous action, N and N·m.
        command_world: Command of the previous action, m and rad.
        goal: Goal of the TCP at the end of the previous action, at first its position.
        physics: Quantities that the world has of its own, unknown to the policy.
        running: Whether the attempt goes on (``PolicyInput.running``).
    """

    state: State
    start: PolicyStart
    key: Key[Array, ""]
    tare_sensor: Float[Array, "6"]
    wrench_sensor: Float[Array, "50 6"]
    command_world: Float[Array, "k"]
    goal: Goal
    physics: Physics
    running: Bool[Array, ""]


def begin(
    policy: Policy,
    config: Config,
    attempt: Attempt,
    tare_sensor: Float[Array, "6"],
    tip_pos_world: Float[Array, "3"],
) -> Memory:
    """Initialise the memory before the first action, with the wrench of free space and the TCP's position."""
    start = start_of(attempt)
    wrench = jnp.broadcast_to(tare_sensor, (SUBSTEPS, 6))
    return Memory(
        state=policy.init(start, attempt.key),
        start=start,
        key=attempt.key,
        tare_sensor=tare_sensor,
        wrench_sensor=wrench,
        command_world=jnp.zeros(policy.width),
        goal=at_rest(policy, config, start, tip_pos_world),
        physics=attempt.physics,
        running=jnp.ones((), bool),
    )


def at_rest(policy: Policy, config: Config, start: PolicyStart, tip_pos_world: Float[Array, "*n 3"]) -> Goal:
    """Return the goals of TCPs that rest at the start of their attempts, turned as the estimate is."""
    if not policy.turns:
        return goals.at_rest(tip_pos_world, config.control)
    here = frame.frame_of(start.estimate_world, config.filter.coordinates)
    return goals.at_rest(tip_pos_world, config.control, here.rotation_world.log())


def act(
    policy: Policy, config: Config, horizon: int, memory: Memory, tip: Tip, step: Int[Array, ""]
) -> tuple[State, Float[Array, "k"]]:
    """Compute the policy's new state and its command (m and rad) for one action.

    The arguments are those of ``seen``.
    """
    return policy.act(memory.state, seen(policy.reads, config, horizon, memory, tip, step))


def seen(
    reads: bool, config: Config, horizon: int, memory: Memory, tip: Tip, step: Int[Array, ""]
) -> PolicyInput:
    """Measure what a policy sees before an action.

    Args:
        reads: Whether it needs ``PolicyInput.reading``.
        config: Defines the errors of the F/T sensor and of the poses, and the contact threshold.
        horizon: Number of actions that the policy plans for.
        memory: Memory with the wrenches of the previous action.
        tip: TCP state at the start of the action.
        step: Index j of the action.
    """
    tare_key, noise_key, error_key, _, size_key = _noise_keys(memory)
    wrist, _ = draw_errors(size_key, config)
    before = jnp.maximum(step - 1, 0)
    tare = force_torque.measured_tare(memory.tare_sensor, tare_key, wrist)
    clean = distortion.distorted(memory.wrench_sensor[None], memory.tare_sensor, error_key, wrist, before)
    noisy = force_torque.measured(clean, tare, jax.random.fold_in(noise_key, step), wrist)
    wrench = distortion.sampled(noisy, tare, wrist)[0]
    measured = _measured(tip, memory, config, step)
    return PolicyInput(
        start=memory.start,
        attempt_key=memory.key,
        key=jax.random.fold_in(memory.key, step),
        step=step,
        tip_pos_world=measured.pos_world,
        tip_quat_world=measured.quat_world,
        tip_linvel_world=measured.linvel_world,
        tip_angvel_world=measured.angvel_world,
        wrench_sensor=wrench,
        contact=force_torque.in_contact(wrench, wrist),
        reading=_read(memory, tip, config, before) if reads else None,
        horizon=horizon,
        running=memory.running,
    )


def measures_insertion(
    memory: Memory, tip: Tip, step: Int[Array, ""], config: Config
) -> Bool[Array, ""] | None:
    """Return whether the robot measures an insertion after ``step`` actions; None: it relies on the truth.

    It does if the TCP, as the policy sees it before its next action, in the frame of its estimate, is at
    least the insertion depth and the margin below where the robot takes the top of the socket to be, which is
    off by an error that is constant in an attempt.
    """
    if config.task.success == "truth":
        return None
    _, pose = draw_errors(_noise_keys(memory)[-1], config)
    error = pose.height_offset_m * jax.random.normal(jax.random.fold_in(memory.key, _HEIGHT))
    here, top_m = _measured(tip, memory, config, step).pos_world, plate_top_m(config.scene)
    coordinates = config.filter.coordinates
    if not frame.is_world(coordinates):
        here = frame.frame_of(memory.start.estimate_world, coordinates).seen(here, top_m)
    below = top_m + error - here[2]
    return below >= config.task.insertion_depth_m + config.task.sensed_margin_m


def gives_up(policy: Policy, state: State) -> Bool[Array, ""]:
    """Return whether a policy ends its attempt with the action that led to this state."""
    return jnp.zeros((), bool) if policy.gives_up is None else policy.gives_up(state)


def reported(policy: Policy, state: State) -> Any:
    """Return what a policy reports after an action; None if it reports nothing."""
    return None if policy.report is None else policy.report(state)


def _read(memory: Memory, tip: Tip, config: Config, step: Int[Array, ""]) -> Reading:
    """Read the previous action, at whose end the TCP is now."""
    row = trace_row(tip, memory.wrench_sensor, memory.command_world)
    felt = Felt(
        trace=jax.tree.map(lambda leaf: leaf[None], row),
        length=jnp.ones((), jnp.int32),
        tare_sensor=memory.tare_sensor,
        estimate_world=memory.start.estimate_world,
        peg_type=memory.start.peg_type,
    )
    if config.filter.reads == "geometry":
        config = with_world_poses(config)
    return read_action(felt, jax.random.fold_in(memory.key, _READING), config, step)


def _noise_keys(memory: Memory) -> Key[Array, "5"]:
    """Derive the keys of the tare, the F/T sensor's noise and errors, the poses, and the sizes of errors."""
    return jax.random.split(jax.random.fold_in(memory.key, _NOISE), 5)


def _measured(tip: Tip, memory: Memory, config: Config, step: Int[Array, ""]) -> Tip:
    """Return pose and twist as the robot measures them, without calibration errors (``PoseConfig``)."""
    *_, pose_key, size_key = _noise_keys(memory)
    _, pose = draw_errors(size_key, config)
    if is_exact(pose):
        return tip
    key = jax.random.fold_in(pose_key, step)
    calibrated = with_arrays(pose, position_offset_m=0.0, height_offset_m=0.0, rotation_offset_rad=0.0)
    row = Trace(
        wrench_sensor=jnp.zeros((1, SUBSTEPS, 6)),
        tip_pos_world=tip.pos_world[None],
        tip_quat_world=tip.quat_world[None],
        tip_linvel_world=tip.linvel_world[None],
        tip_angvel_world=tip.angvel_world[None],
        action_world=jnp.zeros((1, 3)),
    )
    seen = measured_trace(row, key, key, calibrated)
    return Tip(
        seen.tip_pos_world[0], seen.tip_quat_world[0], seen.tip_linvel_world[0], seen.tip_angvel_world[0]
    )
