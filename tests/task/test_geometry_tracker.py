"""The online tracker without a sensor: the geometry of the parts reads a robot's logs."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest

import mjx_fit as mf
from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.evaluation.calibration import calibrate
from mjx_fit.filters import chart
from mjx_fit.filters.updates import detected_belief
from mjx_fit.scene.placement import place_for_tool
from mjx_fit.task.estimator import filter_update

N = 3


@pytest.fixture(scope="module")
def config():
    whole = read_config(world_file("bench"), ["control.push=force"])
    return replace(whole, particles=replace(whole.particles, count=512, moves=4))


@pytest.fixture(scope="module")
def attempts(config):
    return mf.draw_attempts(jax.random.key(5), N, config=config)


@pytest.fixture(scope="module")
def felt(config, attempts):
    """What was felt in three attempts, none of which the peg goes in in."""
    return mf.make_engine("native", config).run(attempts).felt


@pytest.fixture(scope="module")
def tracked(config, attempts, felt):
    tracker = mf.BeliefTracker(None, np.asarray(attempts.estimate_world), config)
    for hole in range(N):
        tracker.choose(config.scene.names[int(felt.peg_type[hole])])
        tracker.update(hole, mf.log_from_felt(felt[hole], start_s=1.7e9, config=config))
    return tracker


def errors(config, mean, attempts):
    places = place_for_tool(attempts.hole_pos_world, attempts.physics, config)
    return np.asarray(chart.step_between(np.asarray(mean), places, config.filter.coordinates))


def test_a_log_tells_what_the_simulated_attempt_tells(config, attempts, felt, tracked):
    before = jax.tree.map(np.asarray, detected_belief(attempts.estimate_world, config))
    keys = jax.random.split(jax.random.key(7), N)
    want = filter_update(config, None, logged=True)(before, felt, keys)
    got, std = tracked.belief, np.sqrt(np.diagonal(want.cov, axis1=1, axis2=2))
    # Particles are other ones: rounding decides which moves are taken.
    assert (np.abs(got.mean_world - want.mean_world) < 1.5 * std).all()
    ratio = np.sqrt(np.diagonal(got.cov, axis1=1, axis2=2)) / std
    assert (ratio > 0.3).all()
    assert (ratio < 3).all()
    old, new = (errors(config, one.mean_world, attempts) for one in (before, got))
    assert np.median(np.abs(new[:, 2])) < 0.5 * np.median(np.abs(old[:, 2]))
    assert np.median(np.hypot(*new[:, :2].T)) < np.median(np.hypot(*old[:, :2].T))


@pytest.mark.slow
def test_the_errors_that_a_robot_may_have_are_reckoned_with_and_not_added(config, attempts, felt):
    """The noise key changes the particles alone; errors of the pose in the settings widen the belief."""
    before = jax.tree.map(lambda leaf: np.asarray(leaf)[:1], detected_belief(attempts.estimate_world, config))
    coarse = replace(config, pose=replace(config.pose, position_offset_m=0.004, height_offset_m=0.003))
    keys = jax.random.split(jax.random.key(7), 1)
    fine, wide = (filter_update(one, None, logged=True)(before, felt[:1], keys) for one in (config, coarse))
    std = [np.sqrt(np.diagonal(one.cov[0])) for one in (fine, wide)]
    assert (std[1][:3] > std[0][:3]).all()
    assert std[1][2] > 0.001
    # An error of 4 mm that was added would show in the mean.
    assert np.abs(wide.mean_world[0] - fine.mean_world[0])[:2].max() < 2 * std[0][:2].max()


def test_it_is_saved_and_loaded_without_a_sensor(config, tracked, tmp_path):
    file = tmp_path / "beliefs.json"
    tracked.save(file)
    again = mf.BeliefTracker.load(file, None, config)
    np.testing.assert_allclose(again.belief.cov, tracked.belief.cov, rtol=1e-6)
    np.testing.assert_array_equal(again._detected.mean_world, tracked._detected.mean_world)
    saved = json.loads(file.read_text())
    for wrong in ([[0.5, 0.1]], [[0.5, 0.1], [0.4]]):
        file.write_text(json.dumps(saved | {"detections": wrong}))
        with pytest.raises(mf.RequestError, match=r"detections: "):
            mf.BeliefTracker.load(file, None, config)
    file.write_text(json.dumps({name: saved[name] for name in saved if name != "detections"}))
    older = mf.BeliefTracker.load(file, None, config)
    np.testing.assert_allclose(older.belief.mean_world, tracked.belief.mean_world, rtol=1e-6)
    file.write_text(json.dumps(saved | {"sensor": "abc"}))
    with pytest.raises(mf.RequestError, match=r"sensor: 'abc' cannot be used: this tracker has 'geometry"):
        mf.BeliefTracker.load(file, None, config)


def test_every_attempt_knows_the_detection(config, attempts, felt):
    """A belief that contact misled is wrong about the detection (``particles.misled_chance``)."""
    detection, seen = np.asarray(attempts.estimate_world)[:1], []
    tracker = mf.BeliefTracker(None, detection, config)

    def update(beliefs, felt, keys):
        seen.append((beliefs.memory.before.mean_world, beliefs.mean_world))
        return replace(beliefs, mean_world=beliefs.mean_world + 0.001)

    tracker._update = update
    tracker.choose(config.scene.names[int(felt.peg_type[0])])
    for _ in range(2):
        tracker.update(0, replace(felt[0], estimate_world=tracker.estimate(0)))
    for known, _ in seen:
        np.testing.assert_array_equal(known, tracker._detected.mean_world)
    np.testing.assert_allclose(seen[1][1] - seen[0][1], 0.001, atol=1e-6)
    assert tracker.belief.memory is None


def test_detections_may_have_all_believed_coordinates(config):
    place = np.array([[0.5, 0.1, 0.002, 0.1, 0.01, -0.02]])
    tracker = mf.BeliefTracker(None, place, config)
    np.testing.assert_allclose(tracker.estimate(0), place[0], atol=1e-7)
    place[0, 3] = np.nan
    with pytest.raises(mf.RequestError, match=r"^detections: .* of hole 0 is invalid: expected finite"):
        mf.BeliefTracker(None, place, config)
    with pytest.raises(mf.RequestError, match=r"expected \(n, 2\) or \(n, 6\)"):
        mf.BeliefTracker(None, place[:, :3], config)


def test_the_calibration_of_trained_sensors_is_not_that_of_the_geometry(config, tmp_path):
    with pytest.raises(mf.RequestError, match=r"^config: filter\.reads: geometry cannot be used"):
        calibrate(config, tmp_path / "out.json", tmp_path, tmp_path, 0)


@pytest.mark.parametrize("config", [None, mf.Config()])
def test_without_a_sensor_the_settings_must_need_none(config):
    with pytest.raises(mf.RequestError, match=r"^sensor: None cannot be used: expected a trained sensor"):
        mf.BeliefTracker(None, np.array([[0.5, 0.1]]), config)
