"""Seconds and newtons of attempts, against counts by hand and a simulated move."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.api import draw_attempts
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.moves import MovesConfig
from mjx_fit.engines.select import make_engine
from mjx_fit.task.effort import CONTACT_N, HARD_N, effort_of, move_time_s, rest_to_rest_s
from mjx_fit.types import Felt, Trace

J = 4


def attempt_with(force_n: np.ndarray, length: int) -> Felt:
    """One attempt with this force along z at 500 Hz, on top of a tare of -7 N."""
    wrench = np.zeros((1, J, 50, 6), np.float32)
    wrench[0, ..., 2] = force_n.reshape(J, 50) - 7
    rows = np.zeros((1, J, 3), np.float32)
    trace = Trace(wrench, rows, np.zeros((1, J, 4), np.float32), rows, rows, rows)
    tare = np.array([[0, 0, -7, 0, 0, 0]], np.float32)
    return Felt(trace, np.array([length]), tare, np.zeros((1, 2), np.float32), np.array([0]))


def test_seconds_and_newtons_are_counts_of_samples():
    force = np.zeros(200)
    force[10:60], force[60:90], force[150:] = 8.0, 25.0, 1000.0
    got = effort_of(attempt_with(force, length=3))
    assert got.seconds[0] == pytest.approx(0.3)
    assert got.contact_s[0] == pytest.approx(80 * 0.002)
    assert got.peak_force_n[0] == pytest.approx(25)  # the last row is padding
    assert got.over_20n_s[0] == pytest.approx(30 * 0.002)
    assert got.impulse_ns[0] == pytest.approx((50 * 8 + 30 * 25) * 0.002, rel=1e-5)


def test_an_attempt_without_contact_has_no_force_and_a_diverged_one_an_unknown_force():
    free = effort_of(attempt_with(np.full(200, 0.9 * CONTACT_N), 4))
    assert (free.contact_s[0], free.impulse_ns[0], free.over_20n_s[0]) == (0, 0, 0)
    assert free.peak_force_n[0] == pytest.approx(0.9)
    lost = effort_of(attempt_with(np.full(200, np.nan), 4))
    assert lost.seconds[0] == pytest.approx(0.4)
    assert np.isnan([lost.contact_s, lost.peak_force_n, lost.over_20n_s, lost.impulse_ns]).all()


def test_the_effort_of_simulated_attempts_is_that_of_each_alone():
    felt = make_engine("native").run(draw_attempts(jax.random.key(0), 3), actions=12).felt
    got = effort_of(felt)
    for i in range(3):
        size = np.linalg.norm((felt.trace.wrench_sensor[i] - felt.tare_sensor[i])[..., :3], axis=-1)
        size = size[: felt.length[i]].ravel().astype(float)
        assert got.peak_force_n[i] == pytest.approx(size.max(), rel=1e-5)
        assert got.over_20n_s[i] == pytest.approx(0.002 * (size > HARD_N).sum())
        assert got.impulse_ns[i] == pytest.approx(0.002 * size[size >= CONTACT_N].sum(), rel=1e-5)


@given(st.floats(0, 1), st.floats(0.01, 2), st.floats(0.05, 10))
def test_a_move_takes_as_long_as_its_integrated_profile(distance, speed, acceleration):
    """Integrate speed up, cruise, slow down: v(x) = min(v, √(2 a x), √(2 a (d - x)))."""
    moves = MovesConfig(speed_mps=speed, acceleration_mps2=acceleration)
    got = float(rest_to_rest_s(np.array([distance]), moves)[0])
    # x = d (1 - cos s) / 2 resolves both ends, where the speed is zero.
    s = (np.arange(20_000) + 0.5) * np.pi / 20_000
    x, dx = distance * (1 - np.cos(s)) / 2, distance * np.sin(s) / 2 * np.pi / 20_000
    v = np.minimum(speed, np.sqrt(2 * acceleration * np.minimum(x, distance - x)))
    assert got == pytest.approx((dx / np.maximum(v, 1e-300)).sum(), rel=2e-3, abs=1e-9)


def test_a_move_between_holes_lifts_the_peg_crosses_and_lowers_it():
    moves = Config().moves
    away = np.array([[0.0, 0.0], [0.3, 0.0]])
    got = move_time_s(away, np.zeros((2, 2)), moves)
    lift = 2 * np.sqrt(moves.lift_m / moves.acceleration_mps2)
    assert got[0] == pytest.approx(2 * lift + moves.settle_s)
    assert got[1] - got[0] == pytest.approx(0.3 / moves.speed_mps + moves.speed_mps / moves.acceleration_mps2)
