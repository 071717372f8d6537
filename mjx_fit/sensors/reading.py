"""Preprocessing of a rollout to a reading: tared, with sensor noise, relative to the estimate.

The simulator stores noise-free wrenches; noise is drawn when a trace is read, so training sees new noise each
time and evaluation draws it once per attempt. An attempt in progress is read action by action.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.randomize import RandomizeConfig
from mjx_fit.filters import frame
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.randomization import draw_errors
from mjx_fit.sensors.distortion import distorted, sampled
from mjx_fit.sensors.force_torque import centre_of_pressure, in_contact, measured, measured_tare
from mjx_fit.sensors.pose import (
    from_start,
    in_frame,
    is_exact,
    measured_trace,
    rotation_offset,
    start_of,
    turned,
)
from mjx_fit.sensors.traces import require_readable
from mjx_fit.types import Array, Felt, Reading, Trace


class Window(NamedTuple):
    """Window of consecutive actions of an attempt, in a fixed number of rows.

    Attributes:
        rows: Number of rows L, static; rows beyond the window are zero padding and masked out.
        start: Index of the first action.
        count: Number of actions to read; those after the end of the attempt are padding. None: all.
    """

    rows: int
    start: int | Int[Array, ""] = 0
    count: int | Int[Array, ""] | None = None


def without_errors(config: Config) -> Config:
    """Return a configuration that adds no errors: those of a robot's log are in it already."""
    wrist, pose = config.wrist.without_errors(), config.pose.without_errors()
    return replace(config, wrist=wrist, pose=pose, randomize=RandomizeConfig())


class _Keys(NamedTuple):
    """Random keys of one reading: the noise of each sample and of the tare, and the errors of an attempt."""

    samples: Key[Array, ""]
    tare: Key[Array, ""]
    wrist: Key[Array, ""]
    pose_offset: Key[Array, ""]
    pose_noise: Key[Array, ""]
    sizes: Key[Array, ""]

    @staticmethod
    def of(key: Key[Array, ""]) -> "_Keys":
        samples, tare, wrist, pose, sizes = jax.random.split(key, 5)
        offset, noise = jax.random.split(pose)
        return _Keys(samples, tare, wrist, offset, noise, sizes)


def read_window(felt: Felt, key: Key[Array, ""], config: Config, window: Window) -> Reading:
    """Read a window of one attempt; vmap for a batch.

    The noise of the tare is drawn once per reading.

    Args:
        felt: Measurements of one attempt, without batch axes.
        key: Random key of the noise.
        config: Defines the errors of the F/T sensor and of the poses, the scene, and the origin of poses
            (``sensor.pose``).
        window: Window of actions to read.

    Raises:
        RequestError: The attempt cannot be read (``mjx_fit.sensors.traces``).
    """
    require_readable(felt, config.scene.n_types, batch=0, d=len(config.filter.coordinates))
    offsets = jnp.arange(window.rows)
    mask = window.start + offsets < felt.length
    if window.count is not None:
        mask &= offsets < window.count
    # Gather with clipped indices: a dynamic slice near the end would shift the whole window instead.
    last = felt.trace.action_world.shape[0] - 1
    trace = jax.tree.map(lambda x: x[jnp.minimum(window.start + offsets, last)], felt.trace)
    trace = jax.tree.map(
        lambda x: jnp.where(mask.reshape(-1, *[1] * (x.ndim - 1)), x, jnp.zeros_like(x)), trace
    )
    return _reading(felt, trace, (mask, window.start), _Keys.of(key), config)


def read_action(felt: Felt, key: Key[Array, ""], config: Config, step: Int[Array, ""]) -> Reading:
    """Read the latest action of an attempt in progress, as the row ``step`` of its reading.

    The errors that are constant in an attempt are those of ``read_window`` with the same key; noise is drawn
    for each action. The F/T sensor's low pass starts anew with the action.

    Args:
        felt: Measurements of the attempt; its trace has the one row.
        key: Random key of the noise of the attempt.
        config: As in ``read_window``.
        step: Index of the action.
    """
    keys = _Keys.of(key)
    of_action = keys._replace(
        samples=jax.random.fold_in(keys.samples, step), pose_noise=jax.random.fold_in(keys.pose_noise, step)
    )
    return _reading(felt, felt.trace, (jnp.ones(1, bool), step), of_action, config)


def _reading(
    felt: Felt,
    trace: Trace,
    rows: tuple[Bool[Array, "L"], int | Int[Array, ""]],
    keys: _Keys,
    config: Config,
) -> Reading:
    """Return the reading of consecutive rows: which of them are real, and the index of the first."""
    scene, (mask, first) = config.scene, rows
    wrist, pose = draw_errors(keys.sizes, config)
    clean = distorted(trace.wrench_sensor, felt.tare_sensor, keys.wrist, wrist, first)
    start = start_of(felt, config)
    if not is_exact(pose):
        trace = measured_trace(trace, keys.pose_offset, keys.pose_noise, pose)
        start = replace(start, quat_world=turned(start.quat_world, rotation_offset(keys.pose_offset, pose)))
    origin_m, coordinates = jnp.asarray(plate_top_m(scene), clean.dtype), config.filter.coordinates
    if not frame.is_world(coordinates):
        here = frame.frame_of(felt.estimate_world, coordinates)
        trace, start = in_frame(trace, start, here, plate_top_m(scene))
    if config.sensor.pose == "start":
        trace, origin_m = from_start(trace, start), start.pos_world[2]
    tare = measured_tare(felt.tare_sensor, keys.tare, wrist)
    noisy = sampled(measured(clean, tare, keys.samples, wrist), tare, wrist)
    origin = jnp.append(jnp.asarray(felt.estimate_world)[:2], origin_m)
    wrench = jnp.where(mask[:, None, None], noisy, 0)
    return Reading(
        wrench_sensor=wrench,
        pressure_tip=centre_of_pressure(wrench.mean(axis=1), scene.peg_length_m),
        tip_pos_estimate=jnp.where(mask[:, None], trace.tip_pos_world - origin, 0),
        tip_quat_world=trace.tip_quat_world,
        tip_linvel_world=trace.tip_linvel_world,
        tip_angvel_world=trace.tip_angvel_world,
        contact=(mask & in_contact(wrench, wrist)).astype(clean.dtype),
        action_world=trace.action_world,
        mask=mask,
        peg_type=felt.peg_type,
    )
