"""Errors of the F/T sensor other than white noise, against NumPy and SciPy."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter
from synthetic import make_rollouts

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.measurement import WristConfig
from mjx_fit.sensors.distortion import distorted, is_undistorted, sampled
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.types import Felt
from mjx_fit.utils.errors import RequestError

EXACT = WristConfig().without_errors()

TARE = np.array([0.5, -0.2, 4.0, 0.01, 0.02, 0.0], np.float32)
KEY = jax.random.key(5)


def wrench(actions: int = 6) -> np.ndarray:
    rng = np.random.default_rng(1)
    return (TARE + rng.normal(size=(actions, 50, 6)) * [5, 5, 10, 0.3, 0.3, 0.1]).astype(np.float32)


def upright(felt: Felt) -> Felt:
    """The same with the tool straight down."""
    down = np.broadcast_to(np.array([0, 1, 0, 0], np.float32), felt.trace.tip_quat_world.shape)
    return replace(felt, trace=replace(felt.trace, tip_quat_world=down))


def seen(wrist: WristConfig, clean: np.ndarray, key=KEY, start: int = 0) -> np.ndarray:
    """The tared wrenches."""
    return np.asarray(distorted(jnp.asarray(clean), jnp.asarray(TARE), key, wrist, start)) - TARE


def test_without_errors_nothing_changes():
    assert is_undistorted(EXACT)
    assert (seen(EXACT, wrench()) == wrench() - TARE).all()


def test_bias_and_drift_are_lines_in_time():
    wrist = replace(
        EXACT, force_bias_n=0.3, torque_bias_nm=0.01, force_drift_nps=0.02, torque_drift_nmps=0.001
    )
    assert not is_undistorted(wrist)
    error = (seen(wrist, wrench()) - (wrench() - TARE)).reshape(-1, 6)
    time = 0.002 * np.arange(len(error))
    slope, start = np.polyfit(time, error, 1)
    assert (abs(slope[:3]) > 1e-4).all()
    np.testing.assert_allclose(error, start + time[:, None] * slope, atol=1e-4)
    later = (seen(wrist, wrench(), start=100) - (wrench() - TARE)).reshape(-1, 6)
    np.testing.assert_allclose(later[0], start + 10 * slope, rtol=1e-3, atol=1e-3)


def test_their_sizes_are_those_of_the_configuration():
    wrist = replace(EXACT, force_bias_n=0.3, torque_bias_nm=0.01, gain_error=0.03, cross_talk=0.02)
    one = np.zeros((1, 50, 6), np.float32) + TARE
    keys = jax.random.split(KEY, 400)
    bias = np.stack([seen(wrist, one, key)[0, 0] for key in keys[:200]])
    assert bias[:, :3].std() == pytest.approx(0.3, rel=0.15)
    assert bias[:, 3:].std() == pytest.approx(0.01, rel=0.15)
    quiet = replace(wrist, force_bias_n=0.0, torque_bias_nm=0.0)
    pressed = one + np.array([0, 0, 10, 0, 0, 0], np.float32)
    response = np.stack([seen(quiet, pressed, key)[0, 0] for key in keys[200:]]) / 10
    assert response[:, 2].mean() == pytest.approx(1, abs=0.01)
    assert response[:, 2].std() == pytest.approx(0.03, rel=0.2)
    assert response[:, :2].std() == pytest.approx(0.02, rel=0.2)
    assert (response[:, 3:] == 0).all()


def test_the_low_pass_is_scipys():
    cutoff = 30.0
    share = 1 - np.exp(-2 * np.pi * cutoff * 0.002)
    clean = wrench()
    x = (clean - TARE).reshape(-1, 6)
    expected, _ = lfilter([share], [1, share - 1], x, axis=0, zi=(1 - share) * x[:1])
    found = seen(replace(EXACT, bandwidth_hz=cutoff), clean).reshape(-1, 6)
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_a_slow_sensor_holds_its_samples_noise_included():
    config = Config(wrist=replace(EXACT, rate_hz=100.0))
    felt = upright(make_rollouts(2, actions=12).felt)
    reading = read_window(felt[0], KEY, config, Window(12))
    found = np.asarray(reading.wrench_sensor)[np.asarray(reading.mask)].reshape(-1, 5, 6)
    np.testing.assert_array_equal(found, np.repeat(found[:, :1], 5, axis=1))
    assert len(np.unique(found[:, 0, 0])) == len(found)


def test_it_saturates_tare_and_noise_included():
    wrist = replace(EXACT, force_range_n=10.0, torque_range_nm=1.0)
    tared = wrench() - TARE
    tared[0, 0] = [0, 0, 500, 0, 0, -9]
    raw = np.asarray(sampled(jnp.asarray(tared), jnp.asarray(TARE), wrist)) + TARE
    np.testing.assert_allclose(raw[0, 0, [2, 5]], [10, -1], rtol=1e-6)
    assert abs(raw[..., :3]).max() <= 10.00001


@pytest.mark.parametrize("rate", [300.0, 499.0, 334.0])
def test_a_rate_that_cannot_be_held_is_refused(rate):
    with pytest.raises(RequestError, match=r"wrist\.rate_hz: .* expected 500 divided by a whole number"):
        read_config(None, [f"wrist.rate_hz={rate}"])


def test_keys_of_a_reading_differ():
    keys = jax.random.split(KEY, 4)
    np.testing.assert_array_equal(jax.random.key_data(keys[:2]), jax.random.key_data(jax.random.split(KEY)))
    assert len(np.unique(jax.random.key_data(keys), axis=0)) == 4


def test_a_reading_has_the_errors_and_depends_on_its_key_alone():
    config = Config(wrist=replace(EXACT, force_bias_n=0.5, bandwidth_hz=40.0))
    felt = upright(make_rollouts(2, actions=8).felt)
    one, other, again = (read_window(felt[0], jax.random.key(i), config, Window(8)) for i in (0, 1, 0))
    np.testing.assert_array_equal(one.wrench_sensor, again.wrench_sensor)
    assert abs(one.wrench_sensor - other.wrench_sensor).max() > 0.1
