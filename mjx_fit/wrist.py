"""What the robot's sensors make of an interaction: a tared, noisy reading relative to the estimate.

The simulator stores clean wrenches; noise is drawn when a trace is read, so that training sees it afresh each
time and an evaluation once per attempt.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int, Key

from mjx_fit.config import WristConfig
from mjx_fit.types import Array, Interaction, Reading


def wrench_noise_std(wrist: WristConfig) -> Float[Array, "6"]:
    """Standard deviation of one sample of (Fx, Fy, Fz, Tx, Ty, Tz), N and N·m."""
    return jnp.array([wrist.force_noise_n] * 3 + [wrist.torque_xy_noise_nm] * 2 + [wrist.torque_z_noise_nm])


def read(
    interaction: Interaction,
    key: Key[Array, ""],
    wrist: WristConfig,
    plate_top_m: float,
    *,
    rows: int,
    start: int | Int[Array, ""] = 0,
    count: int | Int[Array, ""] | None = None,
) -> Reading:
    """Read ``count`` actions of one interaction, from ``start`` on, into ``rows`` rows; vmap for a batch.

    wrench = clean - tare + ε - ε_tare, with ε ~ N(0, σ²) per sample and ε_tare ~ N(0, σ² / n) once per
    reading: the sensor is tared by the mean of n samples that are as noisy as the others.

    Args:
        interaction: One interaction, without batch axes.
        key: Source of the noise.
        wrist: Noise of the force/torque sensor.
        plate_top_m: Height of the plate's upper face, m.
        rows: L, static: rows beyond the window are padding, zeros and masked out.
        start: First action.
        count: Actions to read; those beyond the interaction's end are padding. None: all there are.
    """
    offsets = jnp.arange(rows)
    mask = start + offsets < interaction.length
    if count is not None:
        mask &= offsets < count
    # A gather with clipped indices: a dynamic slice near the end would shift the whole window instead.
    last = interaction.trace.contact.shape[0] - 1
    window = jax.tree.map(lambda rows_: rows_[jnp.minimum(start + offsets, last)], interaction.trace)
    window = jax.tree.map(
        lambda x: jnp.where(mask.reshape(-1, *[1] * (x.ndim - 1)), x, jnp.zeros_like(x)), window
    )

    sample_key, tare_key = jax.random.split(key)
    clean = window.wrench_sensor
    std = wrench_noise_std(wrist).astype(clean.dtype)
    tare_std = std / jnp.sqrt(wrist.tare_samples)
    tare = interaction.tare_sensor + tare_std * jax.random.normal(tare_key, std.shape, clean.dtype)
    noisy = clean - tare + std * jax.random.normal(sample_key, clean.shape, clean.dtype)
    origin = jnp.append(interaction.estimate_world, jnp.asarray(plate_top_m, clean.dtype))
    return Reading(
        wrench_sensor=jnp.where(mask[:, None, None], noisy, 0),
        tip_pos_estimate=jnp.where(mask[:, None], window.tip_pos_world - origin, 0),
        tip_quat_world=window.tip_quat_world,
        tip_linvel_world=window.tip_linvel_world,
        tip_angvel_world=window.tip_angvel_world,
        contact=window.contact.astype(clean.dtype),
        action_world=window.action_world,
        mask=mask,
        peg_type=interaction.peg_type,
    )
