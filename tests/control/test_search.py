"""The search in contact: its path integrated by hand, its times against searches played out."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fakes import seen
from hypothesis import given, settings
from hypothesis import strategies as st

from mjx_fit.config.sections.seek import SeekConfig
from mjx_fit.control import search
from mjx_fit.control.leaning import lean_search

CONFIG = SeekConfig()
PATH = np.linspace(0, 0.4, 40_001)
"""Lengths of the path at which the search is looked at, m."""


def path_of(pitch_m: float) -> np.ndarray:
    return np.asarray(jax.vmap(lambda s: search.spiral(s, pitch_m))(jnp.asarray(PATH)), np.float64)


@pytest.mark.parametrize("pitch_m", [0.001, 0.0015, 0.004])
def test_the_spiral_is_as_long_as_it_says_and_its_turns_are_a_pitch_apart(pitch_m):
    path = path_of(pitch_m)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    far = 20 * pitch_m < PATH
    np.testing.assert_allclose(length[far], PATH[far], rtol=0.06)
    radius = np.linalg.norm(path, axis=1)
    np.testing.assert_allclose(np.pi * radius**2, pitch_m * PATH, rtol=1e-3, atol=1e-9)
    angle = np.unwrap(np.arctan2(path[1:, 1], path[1:, 0]))
    np.testing.assert_allclose(np.interp(angle + 2 * np.pi, angle, radius[1:])[: len(PATH) // 2]
                               - radius[1 : 1 + len(PATH) // 2], pitch_m, rtol=0.02)  # fmt: skip


def test_expected_times_are_those_of_searches_played_out():
    """A hole is found by the first point of the path within half a pitch, of holes drawn from the belief."""
    rng = np.random.default_rng(1)
    cov = np.array([[9e-6, 3e-6], [3e-6, 4e-6]])
    holes = rng.multivariate_normal([0, 0], cov, 1500)
    path = path_of(CONFIG.pitch_m)
    distance = np.linalg.norm(path[None, ::10] - holes[:, None], axis=-1)
    found = distance <= CONFIG.pitch_m / 2
    assert found.any(1).all()
    seconds = PATH[::10][found.argmax(1)] / CONFIG.speed_mps
    expected = float(search.time_s(jnp.trace(jnp.asarray(cov)), CONFIG))
    assert expected == pytest.approx(seconds.mean(), rel=0.08)
    # The same search after its first 30 mm, for the holes that it has not found by then.
    begun = replace(search.begin(jnp.zeros(2)), path_m=jnp.asarray(0.03))
    anew = 7.0
    goes_on = float(search.remaining_s(begun, jnp.asarray(holes), jnp.asarray(anew), CONFIG))
    outside = np.linalg.norm(holes, axis=1) > np.sqrt(CONFIG.pitch_m * 0.03 / np.pi)
    left = np.where(outside, seconds - 0.03 / CONFIG.speed_mps, anew + CONFIG.change_s)
    assert goes_on == pytest.approx(left.mean(), rel=0.08)


def test_a_new_search_takes_the_change_the_slide_and_the_spiral():
    cov = jnp.diag(jnp.array([4e-6, 1e-6]))
    took = search.new_s(jnp.array([0.01, 0.0]), jnp.array([0.01, 0.008]), cov, CONFIG)
    assert float(took) == pytest.approx(0.2 + 0.008 / 0.03 + np.pi * 5e-6 / (0.02 * 0.0015), rel=1e-5)


@settings(max_examples=30)
@given(st.floats(0, 1e3), st.floats(0, 1e3))
def test_an_insertion_takes_longer_after_a_longer_search_but_never_more_than_feeling_and_sinking(a, b):
    short, long = sorted((a, b))
    times = [float(search.insertion_s(jnp.asarray(t), CONFIG)) for t in (short, long)]
    assert CONFIG.sink_s <= times[0] <= times[1] <= CONFIG.sink_s + CONFIG.feel_s
    assert times[0] <= CONFIG.sink_s + short + 1e-5


def test_a_search_begins_with_contact_and_waits_for_a_peg_that_lags():
    state, command = search.step(search.begin(jnp.zeros(2)), seen(contact=False), CONFIG)
    assert float(state.path_m) == 0
    np.testing.assert_allclose(command, [0, 0, -CONFIG.approach_push_m])
    touched, _ = search.step(state, seen(), CONFIG)
    assert float(touched.path_m) == pytest.approx(CONFIG.speed_mps * 0.1)
    behind, _ = search.step(touched, seen((0.006, 0.0, 0.045)), CONFIG)
    assert float(behind.path_m) == float(touched.path_m)


def test_noise_that_looks_like_contact_of_a_falling_peg_is_no_touch_down():
    falling, _ = search.step(search.begin(jnp.zeros(2)), seen((0.0, 0.0, 0.0465), sinks_mps=0.01), CONFIG)
    assert not falling.touched
    down, _ = search.step(falling, seen((0.0, 0.0, 0.0449)), CONFIG)
    assert down.touched
    assert not down.dropped
    assert float(down.touch_m) == pytest.approx(0.0449)


def test_a_slide_to_another_centre_is_no_faster_than_allowed_and_precedes_its_spiral():
    state, _ = search.step(search.begin(jnp.zeros(2)), seen(), CONFIG)
    state = search.about(state, jnp.array([0.01, 0.0]))
    places = []
    for _ in range(4):
        state, _ = search.step(state, seen((*state.goal_world, 0.045)), CONFIG)
        places.append(np.asarray(state.goal_world))
        if len(places) == 1:
            assert float(state.path_m) == 0
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert (steps <= CONFIG.slide_mps * 0.1 + 1e-6).all()
    assert np.linalg.norm(places[-1] - [0.01, 0]) < 0.003


def test_a_peg_that_drops_is_pushed_more_where_it_is_and_searched_with_there_once_it_stops():
    state, _ = search.step(search.begin(jnp.zeros(2)), seen(), CONFIG)
    hole = (0.003, 0.001)
    deep = 0.045 - CONFIG.drop_m - 0.0005
    sinking, command = search.step(state, seen((*hole, deep), sinks_mps=0.01), CONFIG)
    np.testing.assert_allclose(command, [0, 0, -CONFIG.deep_push_m], atol=1e-6)
    stuck, command = search.step(sinking, seen((*hole, deep)), CONFIG)
    assert float(stuck.path_m) > 0
    np.testing.assert_allclose(stuck.centre_world, hole)
    assert np.linalg.norm(command[:2]) < 0.003


@pytest.mark.parametrize("drop_m", [0.00025, 0.0012, 0.003])
def test_a_drop_begins_at_its_depth(drop_m):
    config = replace(CONFIG, drop_m=drop_m)
    state, _ = search.step(search.begin(jnp.zeros(2)), seen(), config)
    for deeper, dropped in ((0.9, False), (1.1, True)):
        after, _ = search.step(state, seen((0.0, 0.0, 0.045 - deeper * drop_m)), config)
        assert bool(after.dropped) == dropped


@pytest.mark.parametrize(
    ("tip_mm", "plate_mm", "sure_mm", "dropped"),
    [
        (43.0, 43.0, 0.1, False),  # the plate slopes down: no drop, though the touch-down was at 45 mm
        (45.0, 47.0, 0.1, True),  # it slopes up, and the peg does not rise with it
        (43.0, 43.0, 1.0, True),  # the plate is hardly known: as from the touch-down
    ],
)
def test_a_drop_is_measured_from_the_believed_plate(tip_mm, plate_mm, sure_mm, dropped):
    config = replace(SeekConfig(), drop_m=0.0012)
    down, _ = search.step(search.begin(jnp.zeros(2)), seen((0, 0, 0.045)), config)
    plate = search.Plate(jnp.asarray(plate_mm / 1000), jnp.asarray(sure_mm / 1000))
    after, _ = search.step(down, seen((0.01, 0, tip_mm / 1000)), config, plate=plate)
    assert bool(after.dropped) == dropped


def test_the_goal_of_a_held_peg_comes_back_when_the_search_is_begun_anew_where_it_is():
    state, _ = search.step(search.begin(jnp.zeros(2)), seen(), CONFIG)
    held = replace(state, goal_world=jnp.array([0.005, 0.0]))
    ahead = search.about(held, jnp.array([0.02, 0.0]))
    waits, _ = search.step(ahead, seen(), CONFIG)
    np.testing.assert_allclose(waits.goal_world, held.goal_world)
    for centre in ((0.0, 0.0), (-0.02, 0.0)):
        back = search.about(held, jnp.array(centre))
        for _ in range(3):
            back, command = search.step(back, seen(), CONFIG)
        assert float(command[0]) < 0.001, centre


def test_a_raster_that_has_found_the_hole_searches_there():
    """Its first point is the corner of its square; the hole is in the middle of it."""
    policy = search.raster_search(CONFIG)
    state, _ = search.step(search.begin(jnp.zeros(2)), seen(), CONFIG)
    hole = (0.003, 0.001)
    for _ in range(8):
        state, command = policy.act(state, seen((*hole, 0.045 - CONFIG.drop_m - 0.0005)))
        assert np.linalg.norm(command[:2]) < 0.003
    assert float(state.path_m) > 0


@pytest.mark.parametrize(("pitch_m", "half_m"), [(0.002, 0.01), (0.0015, 0.004)])
def test_the_raster_sweeps_its_square_in_lines_a_pitch_apart_and_begins_again(pitch_m, half_m):
    once = (int(2 * half_m / pitch_m + 1e-6) + 1) * (2 * half_m + pitch_m)
    lengths = jnp.linspace(0, once, 20_001)
    path = np.asarray(jax.vmap(lambda s: search.raster(s, pitch_m, half_m))(lengths))
    assert np.abs(path).max() <= half_m + 1e-6
    steps = np.linalg.norm(np.diff(path[:-200], axis=0), axis=1)
    np.testing.assert_allclose(steps[steps > 1e-9].mean(), once / 20_000, rtol=0.01)  # as long as it says
    spots = np.random.default_rng(0).uniform(-half_m, half_m, (500, 2))
    nearest = np.linalg.norm(spots[:, None] - path[None, ::10], axis=2).min(1)
    assert nearest.max() <= pitch_m / 2 + 2e-4 + 2 * half_m % pitch_m
    np.testing.assert_allclose(search.raster(lengths[3] + once, pitch_m, half_m), path[3], atol=1e-6)


def test_the_raster_policy_slides_to_the_corner_of_its_square_and_sweeps_it():
    policy = search.raster_search(CONFIG)
    state = policy.init(seen().start, jax.random.key(0))
    state, command = policy.act(state, seen(contact=False))
    np.testing.assert_allclose(command, [0, 0, -CONFIG.approach_push_m], atol=1e-7)
    here, way = np.zeros(2), []
    for _ in range(60):
        state, command = policy.act(state, seen(place=(*here, 0.045)))
        here = here + np.asarray(command)[:2]
        way.append(here)
    assert np.abs(way).max() <= CONFIG.raster_m + 1e-6
    corner = np.linalg.norm(np.array(way) + CONFIG.raster_m, axis=1)
    assert corner.min() < 1e-6
    assert way[-1][0] > CONFIG.raster_m / 2  # along the first line


def test_a_leaning_peg_leads_with_its_low_edge_until_it_drops():
    """The leading edge of the lower face, at 1 cm along the motion, is lower than the centre."""
    policy = lean_search(CONFIG)
    state, here = policy.init(seen().start, jax.random.key(0)), np.zeros(2)
    for _ in range(40):
        state, command = policy.act(state, seen(place=(*here, 0.045)))
        here = here + np.asarray(command)[:2]
    along, turn = np.asarray(state.along_world), np.asarray(command[3:])
    assert np.linalg.norm(along) > 0.5
    edge = np.cross(turn, 0.01 * np.append(along, 0) / np.linalg.norm(along))
    assert edge[2] < -0.01 * 0.5 * CONFIG.lean_rad
    assert abs(edge[:2]).max() < 1e-6
    _, command = policy.act(state, seen(place=(*here, 0.045 - 2 * CONFIG.drop_m)))
    np.testing.assert_array_equal(command[3:], 0)


def test_a_peg_that_has_not_touched_does_not_lean():
    policy = lean_search(CONFIG)
    _, command = policy.act(policy.init(seen().start, jax.random.key(0)), seen(contact=False))
    np.testing.assert_array_equal(command[3:], 0)
