"""Wrenches of the F/T sensor: noise, tare, contact, centre of pressure."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Key

from mjx_fit.config.sections.measurement import WristConfig
from mjx_fit.types import Array, Felt

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
