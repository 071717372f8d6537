"""Errors of the F/T sensor other than white noise: bandwidth, gain, bias, drift, saturation and rate."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Key

from mjx_fit.config.sections.measurement import WristConfig
from mjx_fit.types import Array
from mjx_fit.utils.arrays import is_off
from mjx_fit.utils.rates import STEP_S


def distorted(
    wrench_sensor: Float[Array, "L samples 6"],
    tare_sensor: Float[Array, "6"],
    key: Key[Array, ""],
    wrist: WristConfig,
    start: int | Int[Array, ""] = 0,
) -> Float[Array, "L samples 6"]:
    """Apply the errors of the F/T sensor other than white noise to consecutive actions of one attempt.

    tare + G low_pass(clean - tare) + bias + t drift, where t is the time since the start. G has the gains on
    its diagonal and the cross talk off it, separately for forces and torques.

    Args:
        wrench_sensor: Noise-free wrenches, N and N·m.
        tare_sensor: Noise-free reading at rest in free space, N and N·m.
        key: Random key of the errors that are constant in an attempt.
        wrist: F/T sensor with the errors.
        start: Index of the first action.
    """
    if is_undistorted(wrist):
        return wrench_sensor
    gain_key, bias_key, drift_key = jax.random.split(key, 3)
    shape = wrench_sensor.shape
    wrench = (wrench_sensor - tare_sensor).reshape(-1, 6)
    if wrist.bandwidth_hz is not None:
        wrench = _low_pass(wrench, wrist.bandwidth_hz)
    wrench = wrench @ _gains(gain_key, wrist).T
    time_s = STEP_S * (start * shape[1] + jnp.arange(len(wrench)))[:, None]
    bias = _per_axis(wrist.force_bias_n, wrist.torque_bias_nm) * jax.random.normal(bias_key, (6,))
    drift = _per_axis(wrist.force_drift_nps, wrist.torque_drift_nmps) * jax.random.normal(drift_key, (6,))
    return (wrench + bias + time_s * drift + tare_sensor).reshape(shape)


def sampled(
    wrench_sensor: Float[Array, "L samples 6"], tare_sensor: Float[Array, "6"], wrist: WristConfig
) -> Float[Array, "L samples 6"]:
    """Saturate measured wrenches, and hold each sample until the sensor's next one.

    Args:
        wrench_sensor: Measured wrenches of consecutive actions, tared, N and N·m.
        tare_sensor: Measured tare, N and N·m.
        wrist: F/T sensor with its ranges and its rate.
    """
    shape = wrench_sensor.shape
    if wrist.force_range_n is not None or wrist.torque_range_nm is not None:
        most = _per_axis(wrist.force_range_n or jnp.inf, wrist.torque_range_nm or jnp.inf)
        wrench_sensor = jnp.clip(wrench_sensor + tare_sensor, -most, most) - tare_sensor
    if wrist.rate_hz is not None:
        flat = wrench_sensor.reshape(-1, 6)
        held = round(1 / (wrist.rate_hz * STEP_S))
        wrench_sensor = flat[jnp.arange(len(flat)) // held * held].reshape(shape)
    return wrench_sensor


def is_undistorted(wrist: WristConfig) -> bool:
    """Return True if the F/T sensor has no errors but white noise, saturation and a rate."""
    sizes = ("force_bias_n", "torque_bias_nm", "force_drift_nps", "torque_drift_nmps", "gain_error")
    return wrist.bandwidth_hz is None and all(is_off(getattr(wrist, name)) for name in (*sizes, "cross_talk"))


def _per_axis(force: Any, torque: Any) -> Float[Array, "6"]:
    return jnp.array([force] * 3 + [torque] * 3)


def _gains(key: Key[Array, ""], wrist: WristConfig) -> Float[Array, "6 6"]:
    """Draw the matrix of gains and cross talk; forces and torques do not mix, as their units differ."""
    drawn = jax.random.normal(key, (6, 6))
    same = np.kron(np.eye(2), np.ones((3, 3)))
    size = np.eye(6) * wrist.gain_error + (same - np.eye(6)) * wrist.cross_talk
    return jnp.eye(6) + size * drawn


def _low_pass(wrench: Float[Array, "n 6"], cutoff_hz: float | Array) -> Float[Array, "n 6"]:
    """Filter with y_k = y_{k-1} + a (x_k - y_{k-1}), a = 1 - exp(-2π f Δt), from the state y_0 = x_0."""
    share = -jnp.expm1(-2 * math.pi * cutoff_hz * STEP_S)

    def sample(last, now):
        filtered = last + share * (now - last)
        return filtered, filtered

    return jax.lax.scan(sample, wrench[0], wrench)[1]
