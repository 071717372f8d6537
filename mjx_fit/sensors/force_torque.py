"""Preprocessing of a rollout to a reading: tared, with sensor noise, relative to the estimate.

The simulator stores noise-free wrenches; noise is drawn when a trace is read, so training sees new noise each
time and evaluation draws it once per attempt.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.measurement import WristConfig
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.randomization import draw_errors
from mjx_fit.sensors.distortion import distorted, sampled
from mjx_fit.sensors.pose import (
    from_start,
    is_exact,
    measured_trace,
    rotation_offset,
    start_of,
    turned,
)
from mjx_fit.sensors.traces import require_readable
from mjx_fit.types import Array, Felt, Reading

MIN_PRESS_N = 1.0
_ATTEMPTS_AT_ONCE = 256
FACE_M = 0.04
"""Bound of the centre of pressure: twice the largest distance of a peg's edges from its centre per axis."""


def wrench_noise_std(wrist: WristConfig) -> Float[Array, "6"]:
    """Return the noise standard deviation of one sample (Fx, Fy, Fz, Tx, Ty, Tz), N and N·m."""
    return jnp.array([wrist.force_noise_n] * 3 + [wrist.torque_xy_noise_nm] * 2 + [wrist.torque_z_noise_nm])


def measured_tare(
    tare_sensor: Float[Array, "6"], key: Key[Array, ""], wrist: WristConfig
) -> Float[Array, "6"]:
    """Draw the measured tare, the mean of n noisy samples at rest: tare + ε, ε ~ N(0, σ² / n).

    Args:
        tare_sensor: Noise-free reading at rest in free space, N and N·m.
        key: Random key of the noise.
        wrist: F/T sensor with σ and n.
    """
    std = wrench_noise_std(wrist).astype(tare_sensor.dtype) / jnp.sqrt(wrist.tare_samples)
    return tare_sensor + std * jax.random.normal(key, std.shape, std.dtype)


def measured(
    wrench_sensor: Float[Array, "*batch 6"],
    tare_sensor: Float[Array, "6"],
    key: Key[Array, ""],
    wrist: WristConfig,
) -> Float[Array, "*batch 6"]:
    """Tare a wrench and add sensor noise: clean - tare + ε, ε ~ N(0, σ²) per sample.

    Args:
        wrench_sensor: Noise-free wrench, N and N·m.
        tare_sensor: Measured tare, N and N·m.
        key: Random key of the noise.
        wrist: F/T sensor with σ.
    """
    dtype = wrench_sensor.dtype
    noise = jax.random.normal(key, wrench_sensor.shape, dtype)
    return wrench_sensor - tare_sensor + wrench_noise_std(wrist).astype(dtype) * noise


def in_contact(wrench_sensor: Float[Array, "*batch samples 6"], wrist: WristConfig) -> Bool[Array, "*batch"]:
    """Detect contact during an action from the root mean square of the measured force.

    Args:
        wrench_sensor: Measured wrench during the action, tared, N and N·m.
        wrist: F/T sensor with the threshold ``contact_force_n``.
    """
    force = wrench_sensor[..., :3]
    mean_square = (force * force).sum(-1).mean(-1)
    return mean_square > wrist.contact_force_n**2


def touched(felt: Felt, wrist: WristConfig) -> Bool[np.ndarray, "n J"]:
    """Find the actions of n attempts with contact, from the noise-free force; padding has none."""
    found = []
    for first in range(0, len(felt.length), _ATTEMPTS_AT_ONCE):  # taring copies the wrenches
        rows = slice(first, first + _ATTEMPTS_AT_ONCE)
        tare = np.asarray(felt.tare_sensor[rows])[:, None, None]
        found.append(np.asarray(in_contact(np.asarray(felt.trace.wrench_sensor[rows]) - tare, wrist)))
    length = np.asarray(felt.length)[:, None]
    return np.concatenate(found) & (np.arange(felt.trace.action_world.shape[1]) < length)


def centre_of_pressure(wrench_sensor: Float[Array, "*batch 6"], lever_m: float) -> Float[Array, "*batch 2"]:
    """Compute the centre of pressure on the peg's lower face, relative to its centre, world x and y, m.

    It is the intersection of the resultant force's line of action with the plane of the face. The torque
    about the TCP is τ - r × F with r = (0, 0, lever); a force F_z at (x, y) causes the torque (y F_z, -x
    F_z). The sensor points down: its x axis is the world's, its y axis the world's -y. Values are clipped to
    ``FACE_M``, since the quotient is meaningless for small forces.

    Args:
        wrench_sensor: Force (N) that the arm exerts on the peg over torque (N·m), tared.
        lever_m: Distance from the sensor to the TCP, m.
    """
    force_x, force_y, force_z, torque_x, torque_y, _ = jnp.moveaxis(wrench_sensor, -1, 0)
    press = jnp.maximum(force_z, MIN_PRESS_N)
    along_x = -(torque_y - lever_m * force_x) / press
    along_y = -(torque_x + lever_m * force_y) / press
    return jnp.clip(jnp.stack([along_x, along_y], axis=-1), -FACE_M, FACE_M)


def peak_force(felt: Felt) -> Float[np.ndarray, "n"]:
    """Compute the peak force of each of n attempts, tared, N: the load on peg and arm."""
    wrench = felt.trace.wrench_sensor - felt.tare_sensor[:, None, None]
    real = np.arange(wrench.shape[1]) < np.asarray(felt.length)[:, None]
    return np.where(real[..., None], np.linalg.norm(wrench[..., :3], axis=-1), 0).max((1, 2))


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
    scene = config.scene
    require_readable(felt, scene.n_types, batch=0)
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
    sample_key, tare_key, wrist_key, pose_key, size_key = jax.random.split(key, 5)
    wrist, pose = draw_errors(size_key, config)
    clean = distorted(trace.wrench_sensor, felt.tare_sensor, wrist_key, wrist, window.start)
    start = start_of(felt, scene)
    if not is_exact(pose):
        offset_key, noise_key = jax.random.split(pose_key)
        trace = measured_trace(trace, offset_key, noise_key, pose)
        start = replace(start, quat_world=turned(start.quat_world, rotation_offset(offset_key, pose)))
    origin_m = jnp.asarray(plate_top_m(scene), clean.dtype)
    if config.sensor.pose == "start":
        trace, origin_m = from_start(trace, start), start.pos_world[2]
    tare = measured_tare(felt.tare_sensor, tare_key, wrist)
    noisy = sampled(measured(clean, tare, sample_key, wrist), tare, wrist)
    origin = jnp.append(felt.estimate_world, origin_m)
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
