"""The online tracker against the batch path, logs of other rates, and logs that it refuses."""

import subprocess
import sys
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np
import pytest
from flax import nnx
from hypothesis import given, settings
from hypothesis import strategies as st
from places import EXPERIMENTS

import mjx_fit as mf
from mjx_fit.config.schema import Config
from mjx_fit.config.sections.learning import SensorConfig
from mjx_fit.config.sections.measurement import PoseConfig, WristConfig
from mjx_fit.config.sections.randomize import RandomizeConfig
from mjx_fit.filters.updates import initial_belief
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.task.estimator import filter_update

OWN = EXPERIMENTS / "own"
SILENT, EXACT = WristConfig().without_errors(), PoseConfig().without_errors()
ARRAYS = ("wrench_time_s", "wrench_sensor")
POSES = ("pose_time_s", "tip_pos_world", "tip_quat_world", "tip_linvel_world", "tip_angvel_world")


@pytest.fixture(scope="module")
def sensor():
    return mf.load_sensor()


@pytest.fixture(scope="module")
def failed(native) -> mf.Felt:
    """What was felt in three whole attempts that failed: every odd one has a peg of another shape."""
    attempts = mf.draw_attempts(jax.random.key(3), 6)
    return native.run(attempts, active=np.arange(6) % 2 == 1).felt[np.array([1, 3, 5])]


@pytest.fixture
def tracker(sensor, failed):
    return mf.BeliefTracker(sensor, failed.estimate_world)


def batch_posterior(sensor, felt: mf.Felt) -> mf.Belief:
    """As the experiments do it, with measurements that have no errors."""
    config = replace(sensor.config, wrist=SILENT, pose=EXACT, randomize=RandomizeConfig())
    names = config.scene.names
    prior = initial_belief(np.asarray(felt.estimate_world), config.detector.prior_std_m, len(names))
    return filter_update(config, sensor.network)(prior, felt, jax.random.split(jax.random.key(0), 3))


def track(tracker, felt: mf.Felt, logs: list[mf.SensorLog]) -> mf.Belief:
    names = tracker.config.scene.names
    for hole, log in enumerate(logs):
        tracker.choose(names[int(felt.peg_type[hole])])
        tracker.update(hole, log)
    return tracker.belief


def test_a_log_at_500_hz_gives_what_the_batch_gives(tracker, sensor, failed):
    want = batch_posterior(sensor, failed)
    got = track(tracker, failed, [mf.log_from_felt(failed[i], start_s=1.7e9) for i in range(3)])
    for name in ("pos_mean_world", "pos_cov", "type_probability"):
        np.testing.assert_allclose(getattr(got, name), getattr(want, name), atol=1e-5)
    moved = np.linalg.norm(np.asarray(got.pos_mean_world) - failed.estimate_world, axis=1)
    assert moved.min() > 1e-3


def test_errors_of_simulated_sensors_are_not_added_to_a_log(sensor, failed):
    """A log has those of the robot's own sensors already."""
    wrong = replace(
        sensor.config,
        wrist=WristConfig(force_bias_n=5.0, gain_error=0.3, bandwidth_hz=5.0),
        pose=PoseConfig(position_noise_m=0.01, height_offset_m=0.01, delay_s=0.1),
    )
    logs = [mf.log_from_felt(failed[0])]
    want, got = (
        track(mf.BeliefTracker(replace(sensor, config=config), failed.estimate_world[:1]), failed, logs)
        for config in (sensor.config, wrong)
    )
    np.testing.assert_allclose(got.pos_mean_world, want.pos_mean_world, atol=1e-7)
    np.testing.assert_allclose(got.type_logp, want.type_logp, atol=1e-6)


def resampled(log: mf.SensorLog, rate_hz: float) -> mf.SensorLog:
    """The log of a wrist of another rate: values on the line between those that were simulated."""
    time, wrench = log.wrench_time_s, log.wrench_sensor
    at = np.arange(time[0], time[-1] + 1e-9, 1 / rate_hz)
    at = np.append(at, time[-1]) if time[-1] - at[-1] > 1e-6 else at
    columns = [np.interp(at, time, column) for column in np.asarray(wrench).T]
    return replace(log, wrench_time_s=at, wrench_sensor=np.stack(columns, 1))


@pytest.mark.parametrize(("rate", "mm"), [(125, 4.0), (1000, 2.0)])
def test_other_rates_agree(tracker, sensor, failed, rate, mm):
    want = batch_posterior(sensor, failed)
    got = track(tracker, failed, [resampled(mf.log_from_felt(failed[i]), rate) for i in range(3)])
    apart = np.linalg.norm(np.asarray(got.pos_mean_world) - np.asarray(want.pos_mean_world), axis=1)
    assert 1000 * apart.max() < mm
    assert np.abs(got.type_probability - np.asarray(want.type_probability)).max() < 0.2


def test_what_is_measured_alike_is_read_alike(failed):
    """q and -q are one orientation; a tare may come from free motion; velocities from poses."""
    felt = failed[0]
    log = mf.log_from_felt(felt, start_s=2.0)
    tare = np.asarray(felt.tare_sensor, float)
    free = np.tile(tare, (100, 1)) + np.array([-1e-3, 1e-3]).repeat(50)[:, None]
    changed = replace(
        log,
        tip_quat_world=-np.asarray(log.tip_quat_world),
        wrench_time_s=np.concatenate([np.arange(100) * 0.01, np.arange(1.0, 2.0, 0.05), log.wrench_time_s]),
        wrench_sensor=np.concatenate([free, np.tile(tare, (20, 1)), log.wrench_sensor]),
        tare_sensor=None,
        free_s=(0.0, 0.995),
        tip_linvel_world=None,
        tip_angvel_world=None,
    )
    got = mf.felt_from_log(changed, int(felt.peg_type), felt.estimate_world)
    want = mf.felt_from_log(log, int(felt.peg_type), felt.estimate_world)
    np.testing.assert_allclose(got.tare_sensor, want.tare_sensor, atol=1e-6)
    for name in ("wrench_sensor", "tip_pos_world", "tip_quat_world", "action_world"):
        np.testing.assert_allclose(getattr(got.trace, name), getattr(want.trace, name), atol=1e-6)
    length = int(felt.length)
    way = np.asarray(log.tip_pos_world)[: length + 1]
    np.testing.assert_allclose(got.trace.tip_linvel_world, np.gradient(way, 0.1, axis=0)[1:], atol=1e-5)


def test_the_pose_before_the_first_command_is_the_start(tracker, failed):
    felt = failed[0]
    log = mf.log_from_felt(felt, start_s=2.0)
    start = mf.felt_from_log(log, int(felt.peg_type), felt.estimate_world).start
    assert start is not None
    np.testing.assert_allclose(start.pos_world[:2], felt.estimate_world, atol=1e-6)
    np.testing.assert_allclose(start.quat_world, [0, 1, 0, 0], atol=1e-6)
    late = _without(log, 0.0, 2.05, *POSES)
    assert mf.felt_from_log(late, int(felt.peg_type), felt.estimate_world).start is None
    changed = Config(sensor=SensorConfig(pose="start"))
    network: Any = ContactSensor(changed.sensor, nnx.Rngs(0))
    of_start = mf.BeliefTracker(mf.TrainedSensor(network, changed, "s"), np.array([felt.estimate_world]))
    of_start.choose("cross")
    with pytest.raises(mf.RequestError, match="expected one at rest in free space, before the first command"):
        of_start.update(0, late)
    assert np.isfinite(of_start.update(0, log).pos_mean_world).all()


@settings(max_examples=30, deadline=None)
@given(rate=st.floats(100, 1000), slope=st.floats(-50, 50), phase=st.floats(0, 0.01))
def test_a_wrench_that_grows_evenly_is_read_as_it_is(rate, slope, phase):
    """At any rate from 100 Hz to 1 kHz; a mean of samples may be off by what changes in half a step."""
    time = phase + np.arange(-20, 1.1 * rate) / rate
    poses = np.arange(-1, 12) / 10
    log = mf.SensorLog(
        wrench_time_s=time,
        wrench_sensor=np.outer(slope * time, np.ones(6)),
        pose_time_s=poses,
        tip_pos_world=np.tile([0.5, 0.0, 0.05], (13, 1)),
        tip_quat_world=np.tile([0.0, 1.0, 0.0, 0.0], (13, 1)),
        command_time_s=np.arange(10) / 10,
        command_world=np.zeros((10, 3)),
        tare_sensor=np.zeros(6),
    )
    got = mf.felt_from_log(log, 0, np.array([0.5, 0.0])).trace.wrench_sensor[..., 0].ravel()
    off = np.abs(got - slope * np.arange(500) * 0.002)
    assert off.max() <= abs(slope) * (1e-7 if rate < 499 else 0.001) + 1e-5


def _at(log: mf.SensorLog, name: str, row: int, value: Any) -> mf.SensorLog:
    array = np.array(getattr(log, name), float)
    array[row] = value
    return replace(log, **{name: array})


def _without(log: mf.SensorLog, low: float, high: float, *names: str) -> mf.SensorLog:
    time = np.asarray(getattr(log, names[0]))
    keep = (time < low) | (time > high)
    return replace(log, **{name: np.asarray(getattr(log, name))[keep] for name in names})


REFUSED = {
    r"wrench_time_s: no sample for 0.1\d+ s after 2.99\d s: at most 0.1 s can be interpolated": lambda log: (
        _without(log, 2.9971, 3.1, *ARRAYS)
    ),
    r"pose_time_s: no sample for 0.200 s after 1.000 s": lambda log: _without(
        log, 1.05, 1.15, *POSES
    ),
    r"wrench_time_s: no sample for 2.000 s after 7.998 s": lambda log: _without(log, 8.0, 20.0, *ARRAYS),
    "wrench_sensor: row 7 is invalid: expected finite": lambda log: _at(log, "wrench_sensor", 7, np.nan),
    "tip_pos_world: row 3 is invalid: expected finite": lambda log: _at(log, "tip_pos_world", 3, np.inf),
    r"wrench_time_s: 0.500000 s after 0.998000 s is invalid: times must increase": lambda log: _at(
        log, "wrench_time_s", 500, 0.5
    ),
    r"a quaternion of norm 0 at 0.300 s is invalid": lambda log: _at(log, "tip_quat_world", 3, 0.0),
    r"tip_pos_world: \(372.5, .*\) at 0.000 s is outside the workspace: expected metres": (
        lambda log: replace(log, tip_pos_world=1000 * np.asarray(log.tip_pos_world))
    ),
    r"command_time_s: .* of action 5 is invalid: expected .* actions start every 0.1 s": lambda log: _at(
        log, "command_time_s", 5, 0.55
    ),
    r"wrench_sensor: shape \(5000, 3\) is invalid: expected \(5000, 6\)": lambda log: replace(
        log, wrench_sensor=np.asarray(log.wrench_sensor)[:, :3]
    ),
    "tare_sensor: it is missing: expected the reading in free space, or free_s": lambda log: replace(
        log, tare_sensor=None
    ),
    r"free_s: \[-2.000, -1.000\] s cannot be used: it contains 0 wrenches": lambda log: replace(
        log, tare_sensor=None, free_s=(-2.0, -1.0)
    ),
    "wrench_sensor: list is invalid: expected numbers": lambda log: replace(
        log, wrench_sensor=[["a"]]
    ),
    r"pose_time_s: too few samples \(1\)": lambda log: replace(
        log, pose_time_s=log.pose_time_s[:1], tip_pos_world=log.tip_pos_world[:1],
        tip_quat_world=log.tip_quat_world[:1], tip_linvel_world=None, tip_angvel_world=None,
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_used_is_refused_in_one_line(what, tracker, failed):
    before = jax.tree.map(np.copy, tracker.belief)
    tracker.choose("cross")
    with pytest.raises(mf.RequestError, match=what) as error:
        tracker.update(0, REFUSED[what](mf.log_from_felt(failed[0])))
    assert "\n" not in str(error.value)
    jax.tree.map(np.testing.assert_array_equal, tracker.belief, before)


def test_it_goes_to_the_likeliest_hole_and_leaves_filled_ones(sensor):
    tracker = mf.BeliefTracker(sensor, np.array([[0.4, 0.1], [0.5, -0.1], [0.6, 0.1]]))
    assert tracker.choose("square") == 0
    sure = np.log(np.array([[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]], np.float32))
    tracker.belief = replace(tracker.belief, type_logp=sure)
    assert [tracker.choose(name) for name in ("cross", "rectangle", "square")] == [0, 1, 2]
    tracker.fill(2)
    assert tracker.choose("square") in (0, 1)
    for hole in (0, 1):
        tracker.fill(hole)
    with pytest.raises(mf.RequestError, match="all 3 holes are filled"):
        tracker.choose("square")
    for wrong in (lambda: tracker.choose("star"), lambda: tracker.fill(3), lambda: tracker.estimate(-1)):
        with pytest.raises(mf.RequestError):
            wrong()
    fresh = mf.BeliefTracker(sensor, np.array([[0.4, 0.1]]))
    with pytest.raises(mf.RequestError, match="call choose"):
        fresh.update(0, mf.SensorLog(*[np.zeros(1)] * 7))


def test_a_simulated_attempt_is_taken_as_its_log_is(tracker, sensor, failed):
    names = sensor.config.scene.names
    other = mf.BeliefTracker(sensor, failed.estimate_world)
    for hole in range(3):
        for each in (tracker, other):
            each.choose(names[int(failed.peg_type[hole])])
        one = tracker.update(hole, failed[hole])
        again = other.update(hole, mf.log_from_felt(failed[hole]))
        jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-3, atol=1e-6), one, again)


def test_an_attempt_of_another_peg_place_or_a_filled_hole_is_refused(tracker, failed):
    """Each would give a wrong belief in silence; the second is the same attempt, learned from twice."""
    tracker.update(0, failed[0])
    tracker.fill(2)
    tracker.choose("square")
    before = jax.tree.map(np.copy, tracker.belief)
    for what, hole, felt in (
        ("peg_type: 0 cannot be used: square is in hand", 1, replace(failed[1], peg_type=np.int32(0))),
        ("estimate_world: .* an attempt at hole 0 must start", 0, replace(failed[0], peg_type=np.int32(2))),
        ("hole 2 cannot be used: it is filled", 2, replace(failed[2], peg_type=np.int32(2))),
        ("hole: 0.5 is invalid", 0.5, failed[0]),
        ("felt: None cannot be used: expected a SensorLog or a Felt", 1, None),
    ):
        with pytest.raises(mf.RequestError, match=what):
            tracker.update(hole, felt)
    jax.tree.map(np.testing.assert_array_equal, tracker.belief, before)


@pytest.mark.parametrize("n", [0, 2.5, -1, "3"])
def test_counts_are_whole_numbers(n):
    for enter in (lambda: mf.draw_attempts(jax.random.key(0), n), lambda: mf.draw_holes(0, n)):
        with pytest.raises(mf.RequestError, match=r"n: .* expected a whole number"):
            enter()


@pytest.mark.parametrize("detections", [np.zeros((0, 2)), np.zeros(2), [[400.0, 100.0]], [[np.nan, 0.4]]])
def test_detections_are_places(detections, sensor):
    with pytest.raises(mf.RequestError, match="detections: "):
        mf.BeliefTracker(sensor, detections)


def test_beliefs_are_saved_and_loaded(tracker, sensor, failed, tmp_path):
    track(tracker, failed, [mf.log_from_felt(failed[i]) for i in range(3)])
    tracker.fill(1)
    tracker.choose("square")
    tracker.save(tmp_path / "belief.json")
    again = mf.BeliefTracker.load(tmp_path / "belief.json", sensor)
    jax.tree.map(np.testing.assert_array_equal, again.belief, tracker.belief)
    assert again.filled.tolist() == tracker.filled.tolist()
    assert again.tries.tolist() == tracker.tries.tolist()
    log = mf.log_from_felt(replace(failed[0], estimate_world=tracker.estimate(0)))
    one, other = (each.update(0, log) for each in (tracker, again))
    jax.tree.map(np.testing.assert_array_equal, one, other)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"format": 1', '"format": 9'),
        ('"sensor": "', '"sensor": "0'),
        ('"cross"', '"crass"'),
        ('"filled": [', '"filled": [true, '),
        ('"pos_cov": [', '"pos_cov": [[[0.0, 0.0], [0.0, 0.0]], '),
        ("{", "["),
    ],
)
def test_a_file_that_is_no_belief_is_refused(old, new, tracker, sensor, tmp_path):
    path = tmp_path / "belief.json"
    tracker.save(path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(mf.RequestError) as error:
        mf.BeliefTracker.load(path, sensor)
    assert "\n" not in str(error.value)


def test_a_missing_file_of_beliefs_is_refused(sensor, tmp_path):
    with pytest.raises(mf.RequestError, match="cannot be read"):
        mf.BeliefTracker.load(tmp_path / "none.json", sensor)


def test_the_script_of_20_lines_tracks_a_log_without_truth(failed, tmp_path):
    script = OWN / "online.py"
    assert len(script.read_text().splitlines()) <= 20
    fields = vars(mf.log_from_felt(failed[0]))
    np.savez(tmp_path / "attempt.npz", **{name: value for name, value in fields.items() if value is not None})
    x, y = np.asarray(failed.estimate_world)[0].tolist()
    argv = [sys.executable, str(script), str(tmp_path / "attempt.npz"), "cross", str(x), str(y)]
    done = subprocess.run(argv, capture_output=True, text=True, check=False, timeout=200)
    assert done.returncode == 0, done.stderr
    assert "cm from the detection" in done.stdout


def test_an_insertion_is_judged_by_what_was_felt(failed):
    """A peg that fits another hole, too: the filter decides, and a wrong hole counts as tried."""
    config = mf.load_sensor().config
    both = replace(config.task, success_probability=((0.2, 0.2, 0.2),) * 3, success_by_error=None)
    sensor = mf.load_sensor()
    tracker = mf.BeliefTracker(sensor, failed.estimate_world, replace(config, task=both))
    own = {}
    for hole in range(3):
        kind = int(failed.peg_type[hole])
        tracker.choose(tracker.config.scene.names[kind])
        own[hole] = tracker.judge_insertion(hole, failed[hole])
        assert own[hole] == (np.exp(tracker.belief.type_logp[hole, kind]) >= 0.5)
        assert tracker.tries[hole] == (not own[hole])
        expected = replace(sensor.config, task=both, wrist=SILENT, pose=EXACT, randomize=RandomizeConfig())
        prior = initial_belief(np.asarray(failed.estimate_world), config.detector.prior_std_m, 3)
        after = filter_update(expected, sensor.network, inserted=True)(
            prior, failed, jax.random.split(jax.random.key(0), 3)
        )
        np.testing.assert_allclose(
            tracker.belief.type_logp[hole], after.type_logp[hole], rtol=1e-3, atol=1e-5
        )
