"""A trace that grows: read, encoded and pooled action by action as if it were whole."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import make_rollouts
from test_contact_sensor import ORDERED, PLAIN, ROWS, SMALL, make_reading

from mjx_fit.api import load_config
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.sensors.pooling import after_each_row, code_of, of_rows
from mjx_fit.sensors.reading import Window, read_action, read_window
from mjx_fit.types import Felt, Reading
from mjx_fit.utils.errors import RequestError

PLACED = replace(SMALL, causal=True, places=3, layers=2, contact_features=True, pose="start", noise="trace")


def make_sensor(positional: bool) -> ContactSensor:
    sensor = ContactSensor(replace(PLACED, positional=positional), nnx.Rngs(1))
    sensor.fit_input_scale(make_reading(32, seed=9))
    return sensor


def row_of(reading: Reading, i: int, j: int) -> Reading:
    """Row j of the i-th reading, as a reading of one row."""
    one = jax.tree.map(lambda leaf: leaf[i], reading)
    rows = {name: leaf[j : j + 1] for name, leaf in vars(one).items() if name != "peg_type"}
    return replace(one, **rows)


def upright(felt: Felt) -> Felt:
    """The same with unit quaternions near straight down."""
    quat = felt.trace.tip_quat_world * np.array([0.01, 0, 0.01, 0.01]) + np.array([0, 1, 0, 0])
    quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    return replace(felt, trace=replace(felt.trace, tip_quat_world=quat.astype(np.float32)))


@pytest.mark.parametrize("positional", [pytest.param(False, marks=pytest.mark.slow), True])
def test_an_attempt_in_progress_is_observed_as_the_whole_up_to_there(positional):
    """Three ways: action by action, every row at once, and each prefix as a trace of its own."""
    sensor, reading = make_sensor(positional), make_reading(3, seed=4)
    every = sensor(reading, every_row=True)
    add = nnx.jit(lambda sensor, past, row, step: sensor.add(past, row, step))
    for i in range(3):
        past = sensor.begin(ROWS)
        for j in range(int(reading.mask[i].sum())):
            past, seen = add(sensor, past, row_of(reading, i, j), jnp.asarray(j))
            short = replace(reading, mask=reading.mask & (np.arange(ROWS) <= j))
            whole = jax.tree.map(lambda leaf: leaf[i], sensor(short))  # noqa: B023
            at_once = jax.tree.map(lambda leaf: leaf[i, j], every)  # noqa: B023
            for name, want in vars(whole).items():
                np.testing.assert_allclose(getattr(seen, name), want, rtol=2e-4, atol=2e-6, err_msg=name)
                np.testing.assert_allclose(getattr(at_once, name), want, rtol=2e-4, atol=2e-6, err_msg=name)


def test_a_sensor_that_looks_ahead_cannot_read_an_attempt_in_progress():
    with pytest.raises(RequestError, match=r"^sensor: .* sensor\.causal true"):
        PLAIN.begin(ROWS)
    with pytest.raises(RequestError, match=r"^sensor: .* sensor\.causal true"):
        PLAIN(make_reading(), every_row=True)
    assert ORDERED.begin(ROWS).keys[0][0].shape[2] == ROWS


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 300))
def test_pooling_row_by_row_is_a_maximum_and_softmax_means(seed, scale):
    """Against NumPy in float64, also where scores differ by hundreds."""
    rng = np.random.default_rng(seed)
    codes, scores, places = rng.normal(size=(9, 5)), scale * rng.normal(size=(9, 2)), rng.normal(size=(9, 4))
    mask = np.arange(9) < rng.integers(1, 10)
    codes_, scores_, places_ = (jnp.asarray(x, jnp.float32) for x in (codes, scores, places))
    rows = of_rows(codes_, scores_, places_, jnp.asarray(mask))
    got = np.asarray(code_of(after_each_row(jax.tree.map(lambda leaf: leaf[None], rows))))[0]
    for j in range(9):
        seen = np.flatnonzero(mask[: j + 1])
        weight = np.exp(scores.astype(np.float32)[seen].astype(float) - scores[seen].max(0))
        means = (weight / weight.sum(0)).T @ places[seen]
        want = np.concatenate([codes[seen].max(0), means.ravel()])
        np.testing.assert_allclose(got[j], want, rtol=1e-3, atol=1e-3)


def test_actions_are_read_with_the_errors_of_their_attempt():
    """Without noise, they are the rows of the whole; calibration errors are those of the same key."""
    config = load_config()
    wrist = replace(config.wrist.without_errors(), force_bias_n=0.5, gain_error=0.1, force_drift_nps=0.1)
    pose = replace(config.pose.without_errors(), position_offset_m=0.001, rotation_offset_rad=0.01)
    config = replace(config, wrist=wrist, pose=pose)
    felt = jax.tree.map(lambda leaf: leaf[0], upright(make_rollouts(1, actions=8, seed=2, min_length=8).felt))
    key = jax.random.key(5)
    whole = read_window(felt, key, config, Window(8))
    for j in range(8):
        row = replace(felt, trace=jax.tree.map(lambda leaf: leaf[j : j + 1], felt.trace))  # noqa: B023
        got = read_action(row, key, config, jnp.asarray(j))
        for name in vars(got):
            want = getattr(whole, name)
            np.testing.assert_allclose(
                getattr(got, name), want if name == "peg_type" else want[j : j + 1], rtol=1e-5, atol=1e-6
            )


def test_the_noise_of_each_action_is_its_own():
    config = load_config()
    felt = jax.tree.map(lambda leaf: leaf[0], upright(make_rollouts(1, actions=1, seed=2, min_length=1).felt))
    first, again, later = (
        read_action(felt, jax.random.key(5), config, jnp.asarray(j)).wrench_sensor for j in (0, 0, 1)
    )
    assert (first == again).all()
    assert np.std(first - later) > 0.05
