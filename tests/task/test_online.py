"""Samples one at a time: the beliefs of the batch, and of another algorithm; no memory, no compilation."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mjx_fit as mf
from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.filters.updates import detected_belief
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.sensors.reading import Window, read_window, without_errors
from mjx_fit.task.advice import Adviser, Searched
from mjx_fit.task.attempt_samples import REST_S
from mjx_fit.task.estimator import posterior
from mjx_fit.task.online import OnlineTracker
from mjx_fit.utils.errors import RequestError

EQUAL = 1e-4
COMPILED = "/jax/core/compile/backend_compile_duration"


class Sample(NamedTuple):
    time_s: float
    what: str
    values: tuple[np.ndarray, ...]


@pytest.fixture(scope="module")
def failed(native) -> mf.Felt:
    attempts = mf.draw_attempts(jax.random.key(3), 2)
    return native.run(attempts, active=np.array([False, True])).felt[1]


@pytest.fixture(scope="module")
def sensor():
    return mf.load_sensor("gentle")


@pytest.fixture(scope="module")
def made(sensor, failed):
    return OnlineTracker(mf.BeliefTracker(sensor, np.array([failed.estimate_world, [0.5, -0.1]])))


@pytest.fixture
def online(made, failed):
    """One that has just begun, with beliefs as they were detected."""
    own = made.tracker
    made.tracker = mf.BeliefTracker(own.sensor, np.array([failed.estimate_world, [0.5, -0.1]]))
    made.tracker._update, made.tracker._confirm = own._update, own._confirm
    made.tracker.choose(own.config.scene.names[int(failed.peg_type)])
    made.begin(0)
    yield made
    made.tracker = own


def samples_of(felt: mf.Felt, begin_s: float = 7.0, twist: bool = True) -> list[Sample]:
    """An attempt as a robot sends it: at rest first, then 500 Hz wrenches and 10 Hz poses."""
    log = mf.log_from_felt(felt, start_s=begin_s)
    assert log.tip_linvel_world is not None
    assert log.tip_angvel_world is not None
    twists = [np.concatenate([log.tip_linvel_world, log.tip_angvel_world], 1)] if twist else []
    rest = begin_s - REST_S + 0.002 * np.arange(round(REST_S / 0.002))
    found = [Sample(time, "wrench", (np.asarray(felt.tare_sensor),)) for time in rest]
    found += map(Sample, log.wrench_time_s, ["wrench"] * len(log.wrench_time_s), zip(log.wrench_sensor))
    poses = zip(log.tip_pos_world, log.tip_quat_world, *twists, strict=True)
    found += map(Sample, log.pose_time_s, ["pose"] * len(log.pose_time_s), poses)
    found += map(Sample, log.command_time_s, ["command"] * len(log.command_time_s), zip(log.command_world))
    return sorted(found, key=lambda one: one.time_s)


def send(online: OnlineTracker, samples: list[Sample]) -> None:
    add = {"wrench": online.add_wrench, "pose": online.add_pose, "command": online.add_command}
    for time, what, values in samples:
        add[what](time, *values)


@pytest.mark.parametrize("twist", [True, False])
def test_it_says_what_the_same_log_says_at_once(twist, online, failed):
    samples, told = samples_of(failed, twist=twist), {}
    for k in range(0, len(samples), 1300):
        send(online, samples[k : k + 1300])
        told[online.samples.actions] = online.belief()
    send(online, samples[k + 1300 :])
    n = int(failed.length)
    assert online.samples.actions == n
    config = online.tracker.config
    batch = mf.BeliefTracker(online.tracker.sensor, np.asarray(failed.estimate_world)[None])
    batch.choose(config.scene.names[int(failed.peg_type)])
    log = mf.log_from_felt(failed)
    if not twist:
        log = replace(log, tip_linvel_world=None, tip_angvel_world=None)
    want, got = batch.update(0, log), online.end()
    for name in ("mean_world", "cov", "type_logp"):
        np.testing.assert_allclose(getattr(got, name), getattr(want, name), atol=EQUAL, rtol=EQUAL)
    assert len(told) > 3
    assert online.tracker.tries[0] == 1


def test_beliefs_on_the_way_are_those_of_the_sensor_that_keeps_what_it_read(online, failed, sensor):
    """An independent algorithm: action by action, each row read once (``ContactSensor.add``)."""
    config, samples, sent = online.tracker.config, samples_of(failed), 0
    prior = jax.tree.map(lambda leaf: leaf[0], online.tracker.prior(0))
    add = jax.jit(sensor.network.add)
    for n in (1, 4, 15):
        upto = next(i for i, one in enumerate(samples) if one.time_s > 7.0 + 0.1 * n + 0.05)
        send(online, samples[sent:upto])
        sent = upto
        assert online.samples.actions == n
        felt = online.tracker.read(0, online.samples.log())
        reading = read_window(felt, jax.random.key(0), without_errors(config), Window(n))
        past = sensor.network.begin(config.task.attempt_actions)
        for j in range(n):
            rows = {name: leaf[j : j + 1] for name, leaf in vars(reading).items() if name != "peg_type"}
            past, seen = add(past, replace(reading, **rows), jnp.asarray(j))
        want, got = posterior(prior, seen, felt.peg_type, jnp.zeros((3, 3)), config), online.belief()
        np.testing.assert_allclose(got.mean_world, want.mean_world, atol=EQUAL)
        np.testing.assert_allclose(got.cov, want.cov, atol=1e-7)
        np.testing.assert_allclose(np.exp(got.type_logp), np.exp(want.type_logp), atol=EQUAL)
    assert np.abs(got.mean_world - prior.mean_world).max() > 1e-3


def test_nothing_is_compiled_and_no_memory_is_taken_after_it_was_made(online, failed):
    compiled = []

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        if event == COMPILED:
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    buffers = online.samples._wrench, online.samples._pose, online.samples._twist, online.samples._command
    held = [id(one._values) for one in buffers]
    samples = samples_of(failed)
    for number in range(3):
        own = [one._replace(time_s=one.time_s + 100 * number) for one in samples]
        online.begin(0)
        for k in range(0, len(own), 500):
            send(online, own[k : k + 500])
            online.advise()
        online.end()
        assert online.tracker.choose(online.tracker.config.scene.names[int(failed.peg_type)]) in (0, 1)
        online.tracker.belief = online.tracker._detected
    assert compiled == []
    assert [id(one._values) for one in buffers] == held
    jax.jit(lambda x: x * 1.2345)(jnp.ones(17))
    assert compiled


def test_a_long_rest_is_forgotten(online, failed):
    samples = samples_of(failed, 1000.0)
    for time in np.arange(0, 999.0, 0.01):
        online.add_wrench(time, np.full(6, 9.0))
        online.add_pose(time, np.array([0.5, 0, 0.1]), np.array([0.0, 1, 0, 0]))
    send(online, samples)
    assert online.samples.actions == int(failed.length)
    np.testing.assert_allclose(
        online.tracker.read(0, online.samples.log()).tare_sensor, failed.tare_sensor, atol=1e-6
    )


def test_samples_that_come_late_or_are_no_numbers_are_left_out(online, failed):
    samples, rng = samples_of(failed), np.random.default_rng(0)
    whole = samples[:2000]
    send(online, whole)
    want = online.belief()
    online.begin(0)
    wrong = [one._replace(values=(np.full(6, np.nan),)) for one in whole if one.what == "wrench"]
    mixed = []
    for one in whole:
        mixed.append(one)
        if one.what == "wrench" and rng.random() < 0.1:
            mixed += [
                one,
                one._replace(time_s=one.time_s - 0.01),
                wrong[0]._replace(time_s=one.time_s + 1e-4),
            ]
    send(online, mixed)
    assert online.samples.left_out == len(mixed) - len(whole) > 100
    np.testing.assert_array_equal(online.belief().mean_world, want.mean_world)


def test_missing_samples_are_said(online, failed):
    samples = [one for one in samples_of(failed) if one.what == "command" or not 7.4 < one.time_s < 7.6]
    send(online, samples[:2000])
    with pytest.raises(RequestError, match=r"wrench_time_s: no sample for 0\.2"):
        online.belief()


def test_short_gaps_are_bridged(online, failed):
    """Half of the wrenches are lost: the belief moves by less than half of what is uncertain."""
    samples, rng = samples_of(failed)[:4000], np.random.default_rng(1)
    send(online, samples)
    want = online.belief()
    online.begin(0)
    send(online, [one for one in samples if one.what != "wrench" or rng.random() < 0.5])
    away = np.abs(online.belief().mean_world - want.mean_world)
    assert (away < 0.5 * np.sqrt(np.diagonal(want.cov))).all()


def test_what_is_missing_at_the_start_is_said(online):
    with pytest.raises(RequestError, match=r"0 wrenches in the 0\.5 s before the first command are not"):
        online.add_command(1.0, np.zeros(3))
    online._hole = None
    for ask in (online.belief, online.advise, online.end):
        with pytest.raises(RequestError, match=r"no attempt has begun: call begin\(hole\)"):
            ask()


def test_it_advises_by_belief_force_and_height(online, failed):
    samples = samples_of(failed)
    send(online, samples[:3000])
    config, belief = online.tracker.config, online.belief()
    first = online.advise()
    assert first.what in ("go on", "recentre", "next hole")
    # The other hole is the better one as soon as this one is surely of another type.
    peg = int(failed.peg_type)
    others = np.full(3, np.log(0.4995), np.float32)
    others[peg] = np.log(0.001)
    online._belief = replace(belief, type_logp=others)
    online._path_m = 0.01
    assert (online.advise().what, online.advise().hole) == ("next hole", 1)
    # A hole of the right type that is believed a centimetre away is searched for there.
    sure = np.full(3, np.log(0.005), np.float32)
    sure[peg] = np.log(0.99)
    there = np.asarray(belief.mean_world) + np.array([0.01, 0], np.float32)
    online._belief = replace(belief, type_logp=sure, mean_world=there, cov=np.eye(2, dtype=np.float32) * 1e-7)
    online._centre, online._path_m = np.asarray(failed.estimate_world), 0.01
    advice = online.advise()
    assert advice.what == "recentre"
    np.testing.assert_allclose(advice.place_world, there, atol=1e-6)
    assert online.advise().what == "go on"  # it is told once
    last = samples[2999].time_s
    here, down = np.asarray(online.samples._pose.values[-1, :3]), np.array([0.0, 1, 0, 0])
    for i in range(20):
        online.add_wrench(last + 0.002 * (i + 1), np.array([0, 0, 200.0, 0, 0, 0]))
    assert "at most 60 N" in online.advise().why
    online.add_pose(
        online.samples._pose.last_s + 0.09, here - [0, 0, config.task.insertion_depth_m + 0.004], down
    )
    assert online.advise().what == "stop"
    assert "the peg is in" in online.advise().why


@pytest.mark.parametrize(
    ("what", "values", "expected"),
    [
        ("add_wrench", (np.zeros(5),), r"^online: wrench: shape \(5,\) is invalid: expected \(6,\)$"),
        ("add_wrench", (3.0,), r"^online: wrench: shape \(\) is invalid"),
        ("add_pose", (np.zeros(3), np.zeros(3)), r"^online: pose: shape \(6,\) is invalid: expected \(7,\)$"),
        ("add_pose", (np.zeros(3), np.ones(4), np.zeros(3)), r"^online: twist: shape \(3,\) is invalid"),
    ],
)
def test_a_sample_of_another_shape_is_refused(what, values, expected, online):
    with pytest.raises(RequestError, match=expected):
        getattr(online, what)(0.0, *values)


def test_a_time_that_is_no_number_is_left_out(online):
    for time in (np.inf, np.nan, -np.inf):
        online.add_wrench(time, np.zeros(6))
    online.add_wrench(0.0, np.zeros(6))
    assert online.samples.left_out == 3


def test_a_peg_is_in_below_the_top_that_is_believed():
    """The same height of the tool, over sockets that are believed 12 mm apart in height."""
    config = read_config(world_file("bench"))
    here = np.array([0.5, 0.1, plate_top_m(config.scene) - 0.006])
    searched = Searched(here[:2], 0.01, here, 1.0)
    said = []
    for height in (-0.004, 0.008):
        place = np.array([[0.5, 0.1, height, 0.0, 0.0, 0.0]], np.float32)
        belief = jax.tree.map(lambda leaf: leaf[0], detected_belief(jnp.asarray(place), config))
        said.append(Adviser(config, 60.0).advise(belief, searched, None, None).what)
    assert said[0] != "stop"
    assert said[1] == "stop"


def test_a_tracker_without_a_sensor_is_refused():
    tracker = mf.BeliefTracker(None, np.array([[0.5, 0.1]]), read_config(world_file("bench")))
    with pytest.raises(RequestError, match=r"^online: a tracker without a sensor cannot be used"):
        OnlineTracker(tracker)
