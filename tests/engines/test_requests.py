"""Invalid arguments from Python that engines, sensors and filters refuse: one line that names the field."""

import dataclasses
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fakes import FakeEngine
from flax import nnx
from synthetic import make_rollouts, with_truth

from mjx_fit.config.schema import Config
from mjx_fit.control import policies
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines import requests
from mjx_fit.engines.mjx.engine import MjxEngine
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.filters.updates import initial_belief
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.task.after_attempts import after_failures
from mjx_fit.task.estimator import filter_update, frame_update, readings
from mjx_fit.task.estimator_input import require_update
from mjx_fit.utils.errors import RequestError

CONFIG = Config()
N = 4


@pytest.fixture(scope="module")
def attempts():
    return draw_attempts(jax.random.key(0), jnp.arange(N), "mixed", CONFIG)


@pytest.fixture(scope="module")
def mjx():
    return MjxEngine(CONFIG, 1)


def at(leaf, value, row=1):
    """The leaf as a NumPy array with another value in one row."""
    array = np.array(leaf)
    array[row] = value
    return array


def believed(attempts):
    return initial_belief(attempts.estimate_world, 0.01, CONFIG.scene.n_types)


REFUSED = {
    "peg_type of row 1: 7 is invalid: expected 0 to 2": lambda a: {"peg_type": at(a.peg_type, 7)},
    "hole_type of row 1: -1": lambda a: {"hole_type": at(a.hole_type, -1)},
    "policy of row 1: 2 is invalid: expected 0 to 1": lambda a: {"policy": at(a.policy, 2)},
    r"hole_pos_world of row 1: \(1.5, 0\) m": lambda a: {"hole_pos_world": at(a.hole_pos_world, (1.5, 0))},
    r"hole_pos_world of row 1: \(nan, 0\)": lambda a: {"hole_pos_world": at(a.hole_pos_world, (np.nan, 0))},
    r"estimate_world of row 1: \(0.5, inf\)": lambda a: {
        "estimate_world": at(a.estimate_world, (0.5, np.inf))
    },
    r"estimate_world of row 1: \(-0.5, 0\)": lambda a: {"estimate_world": at(a.estimate_world, (-0.5, 0))},
    r"hole_type: int32 \(3,\)": lambda a: {"hole_type": a.hole_type[:3]},
    r"peg_type: float32 \(4,\) is invalid: expected integers": lambda a: {
        "peg_type": np.asarray(a.peg_type, np.float32)
    },
    r"hole_pos_world: float32 \(4, 3\)": lambda a: {"hole_pos_world": np.full((N, 3), 0.5, np.float32)},
    "peg_type: list is invalid: expected a NumPy or JAX array": lambda a: {"peg_type": [0] * N},
    r"belief: cov: float32 \(4, 3, 3\) is invalid: expected floats \(4, 2, 2\)": lambda a: {
        "belief": dataclasses.replace(believed(a), cov=jnp.zeros((N, 3, 3)))
    },
    "belief: cov of row 1: .* expected finite, symmetric and positive definite": lambda a: {
        "belief": dataclasses.replace(believed(a), cov=at(believed(a).cov, -1e-4 * np.eye(2)))
    },
    "belief: type_logp of row 1: .* expected exponentials that sum to 1": lambda a: {
        "belief": dataclasses.replace(believed(a), type_logp=at(believed(a).type_logp, np.nan))
    },
    r"elsewhere_per_s: float32 \(3,\)": lambda a: {"elsewhere_per_s": jnp.zeros(3)},
    "elsewhere_per_s of row 1: nan": lambda a: {"elsewhere_per_s": at(jnp.zeros(N), np.nan)},
    r"key: shape \(3,\)": lambda a: {"key": a.key[:3]},
    "key: uint32 is invalid: expected keys": lambda a: {"key": jax.random.key_data(a.key)},
    "key: rbg is invalid": lambda a: {"key": jax.random.split(jax.random.key(0, impl="rbg"), N)},
}


@pytest.mark.parametrize("what", REFUSED)
def test_attempts_that_cannot_be_run_are_refused_by_both_engines(what, attempts, native, mjx):
    wrong = dataclasses.replace(attempts, **REFUSED[what](attempts))
    for engine in (native, mjx):
        with pytest.raises(RequestError, match=what):
            engine.run(wrong, 2)


@pytest.mark.parametrize(
    ("what", "asked"),
    [
        ("actions: 0 is invalid: expected a whole number from 1 to", {"actions": 0}),
        ("actions: -3", {"actions": -3}),
        ("actions: 1000000000000 is", {"actions": 10**12}),
        ("actions: 2.5", {"actions": 2.5}),
        ("actions: True", {"actions": True}),
        ("horizon: 2 is invalid: expected a whole number from 3", {"actions": 3, "horizon": 2}),
        (r"active: int64 \(4,\)", {"actions": 3, "active": np.ones(N, int)}),
        (r"active: bool \(5,\)", {"actions": 3, "active": np.ones(N + 1, bool)}),
    ],
)
def test_what_else_an_engine_refuses(what, asked, attempts, native, mjx):
    for engine in (native, mjx):
        with pytest.raises(RequestError, match=what):
            engine.run(attempts, **asked)


@pytest.mark.parametrize("threads", [0, -1, 1.5, None, 10**9])
def test_engines_need_threads(threads):
    for kind in (NativeEngine, MjxEngine):
        with pytest.raises(RequestError, match=r"threads: .* expected a whole number from 1"):
            kind(CONFIG, threads)


def test_no_batch_and_no_attempt_are_refused(attempts, native):
    with pytest.raises(RequestError, match="attempts: dict is invalid: expected an Attempt"):
        native.run(vars(attempts), 2)
    with pytest.raises(RequestError, match=r"peg_type: shape \(0,\)"):
        native.run(jax.tree.map(lambda leaf: leaf[:0], attempts), 2)
    with pytest.raises(RequestError, match=r"peg_type: shape \(\)"):
        native.run(jax.tree.map(lambda leaf: leaf[0], attempts), 2)


def test_rows_that_are_not_active_may_hold_anything(attempts, native):
    wrong = dataclasses.replace(
        attempts, peg_type=at(attempts.peg_type, 99, 0), hole_pos_world=at(attempts.hole_pos_world, np.nan, 0)
    )
    done = native.run(wrong, 1, np.arange(N) > 0)
    assert done.felt.length.tolist() == [0, 1, 1, 1]


def test_the_whole_workspace_and_what_a_detector_makes_of_it_is_accepted():
    """With more than six holes it is widest: a corner, and the largest error that may be configured."""
    for x, y in ((0.35, 0.0), (0.65, 0.4), (0.65, -0.4)):
        hole = np.full((1, 2), (x, y), np.float32)
        for error in (-0.03, 0.03):
            asked = draw_attempts(jax.random.key(0), jnp.arange(1), "spiral", CONFIG)
            asked = dataclasses.replace(asked, hole_pos_world=hole, estimate_world=hole + np.float32(error))
            requests.require_attempts(asked, 1, None, None, CONFIG)


def test_mujoco_writes_no_log_into_the_working_folder(tmp_path, monkeypatch, attempts):
    """The library's own user, who has not called ``runtime.configure``."""
    import mujoco

    monkeypatch.chdir(tmp_path)
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(None)
    try:
        wild = NativeEngine(CONFIG, 1, policies.stateless(lambda seen: jnp.full(3, jnp.nan)))
        assert not wild.run(attempts, 2).truth.valid.any()
        model = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
        )
        data = mujoco.MjData(model)
        data.qpos[0] = np.nan
        mujoco.mj_step(model, data)
        assert not list(tmp_path.iterdir())
    finally:
        mujoco.set_mju_user_warning(before)


# --- sensors and filters


def sound(n=N, actions=3):
    """What was felt in n attempts of whole length, with quaternions of straight down."""
    done = make_rollouts(n, actions, min_length=actions).felt
    upright = jnp.broadcast_to(jnp.array([0.0, 1, 0, 0]), done.trace.tip_quat_world.shape)
    return dataclasses.replace(done, trace=dataclasses.replace(done.trace, tip_quat_world=upright))


def traced(done, **leaves):
    return dataclasses.replace(done, trace=dataclasses.replace(done.trace, **leaves))


def poisoned(leaf, value=np.nan, place=(1, 2)):
    array = np.array(leaf)
    array[place] = value
    return array


BELIEF = initial_belief(jnp.full((N, 2), 0.5), 0.01, 3)
KEYS = jax.random.split(jax.random.key(1), N)
UNREADABLE = {
    r"trace.wrench_sensor: shape \(4, 3, 12, 6\) is invalid: expected \(4, 3, 50, 6\)": lambda d: traced(
        d, wrench_sensor=d.trace.wrench_sensor[:, :, :12]
    ),
    r"trace.wrench_sensor: shape \(4, 3, 50, 3\)": lambda d: traced(
        d, wrench_sensor=d.trace.wrench_sensor[..., :3]
    ),
    r"trace.tip_pos_world: shape \(4, 2, 3\)": lambda d: traced(
        d, tip_pos_world=d.trace.tip_pos_world[:, :2]
    ),
    r"tare_sensor: shape \(4, 3\)": lambda d: dataclasses.replace(d, tare_sensor=d.tare_sensor[:, :3]),
    r"trace.wrench_sensor: the value at \(1, 2\) is invalid: expected a finite": lambda d: traced(
        d, wrench_sensor=poisoned(d.trace.wrench_sensor, np.inf)
    ),
    r"trace.tip_linvel_world: the value at \(1, 2\) is invalid": lambda d: traced(
        d, tip_linvel_world=poisoned(d.trace.tip_linvel_world)
    ),
    r"tare_sensor: the value at \(1, 0\) is invalid": lambda d: dataclasses.replace(
        d, tare_sensor=poisoned(d.tare_sensor)
    ),
    r"tip_quat_world: \[0.0, 2.0, 0.0, 0.0\] is invalid: its norm is 2, expected 1 within 1%": lambda d: (
        traced(d, tip_quat_world=d.trace.tip_quat_world * 2)
    ),
    "length: 4 is invalid: expected a whole number from 0 to 3": lambda d: dataclasses.replace(
        d, length=at(d.length, 4)
    ),
    "length: -1": lambda d: dataclasses.replace(d, length=at(d.length, -1)),
    "peg_type: 3 is invalid": lambda d: dataclasses.replace(d, peg_type=at(d.peg_type, 3)),
}
NO_BELIEF = {
    r"mean_world of row 1: \[nan, ": lambda b: dataclasses.replace(
        b, mean_world=poisoned(b.mean_world, place=(1, 0))
    ),
    "cov of row 1: .* expected finite, symmetric and positive definite": lambda b: dataclasses.replace(
        b, cov=at(b.cov, [[1e-4, 2e-4], [2e-4, 1e-4]])
    ),
    "cov of row 1: .*-0.0001": lambda b: dataclasses.replace(b, cov=at(b.cov, -1e-4 * np.eye(2))),
    r"cov of row 1: \[inf": lambda b: dataclasses.replace(b, cov=at(b.cov, np.inf)),
    "cov of row 1: .*5e-05": lambda b: dataclasses.replace(b, cov=at(b.cov, [[1e-4, 5e-5], [0, 1e-4]])),
    "type_logp of row 1: .* expected exponentials that sum to 1": lambda b: dataclasses.replace(
        b, type_logp=at(b.type_logp, 0.0)
    ),
    r"type_logp: float64 \(4, 4\) is invalid": lambda b: dataclasses.replace(b, type_logp=np.zeros((N, 4))),
}


@pytest.fixture(scope="module")
def sensor():
    return ContactSensor(CONFIG.sensor, nnx.Rngs(0))


@pytest.mark.parametrize("what", UNREADABLE)
def test_traces_that_cannot_be_read_are_refused_wherever_they_enter(what, sensor):
    wrong = UNREADABLE[what](sound())
    for enter in (
        lambda: readings(wrong, KEYS, CONFIG),
        lambda: filter_update(CONFIG, None)(BELIEF, wrong, KEYS),
        lambda: filter_update(CONFIG, sensor)(BELIEF, wrong, KEYS),
        lambda: frame_update(CONFIG, sensor)(BELIEF, wrong, KEYS),
    ):
        with pytest.raises(RequestError, match=what):
            enter()


@pytest.mark.parametrize("what", NO_BELIEF)
def test_what_is_no_belief_is_refused(what, sensor):
    wrong = NO_BELIEF[what](BELIEF)
    for update in (filter_update(CONFIG, sensor), frame_update(CONFIG, sensor)):
        with pytest.raises(RequestError, match=what):
            update(wrong, sound(), KEYS)


def test_keys_of_noise_are_keys_one_for_each(sensor):
    for keys in (KEYS[:3], jax.random.key_data(KEYS)):
        with pytest.raises(RequestError, match="keys: "):
            filter_update(CONFIG, sensor)(BELIEF, sound(), keys)


def test_one_trace_is_read_as_it_is_or_refused():
    one = jax.tree.map(lambda leaf: leaf[1], sound())
    read_window(one, KEYS[0], CONFIG, Window(3))
    for what, wrong in (
        (r"shape \(3, 12, 6\)", traced(one, wrench_sensor=one.trace.wrench_sensor[:, :12])),
        (
            r"wrench_sensor: the value at \(0, 2\) is invalid",
            traced(one, wrench_sensor=poisoned(one.trace.wrench_sensor, place=(2,))),
        ),
    ):
        with pytest.raises(RequestError, match=what):
            read_window(wrong, KEYS[0], CONFIG, Window(3))


def test_a_sensor_refuses_readings_that_are_none(sensor):
    """Those of another robot, made without ``wrist.read``."""
    reading = readings(sound(), KEYS, CONFIG)
    sensor(reading)
    for what, wrong in (
        (
            r"reading.wrench_sensor: shape \(4, 3, 12, 6\)",
            {"wrench_sensor": reading.wrench_sensor[:, :, :12]},
        ),
        (
            "reading.tip_pos_estimate: the value at",
            {"tip_pos_estimate": reading.tip_pos_estimate * np.nan},
        ),
        ("reading.peg_type: 5", {"peg_type": at(reading.peg_type, 5)}),
    ):
        with pytest.raises(RequestError, match=what):
            sensor(dataclasses.replace(reading, **wrong))


def test_what_does_not_count_may_be_anything():
    """Padding behind the last action, the last action of a simulation that diverged, sums that overflow."""
    done = sound()
    short = dataclasses.replace(done, length=at(done.length, 2))
    require_update(BELIEF, traced(short, wrench_sensor=poisoned(done.trace.wrench_sensor)), KEYS, CONFIG)
    whole = with_truth(make_rollouts(N, 3, min_length=3), inserted=np.zeros(N, bool))
    diverged = with_truth(whole, valid=at(whole.truth.valid, False))
    diverged = dataclasses.replace(
        diverged, felt=traced(done, tip_quat_world=poisoned(done.trace.tip_quat_world))
    )
    after = after_failures(filter_update(CONFIG, None), BELIEF, diverged, KEYS)
    changed = np.any(np.asarray(after.type_logp) != np.asarray(BELIEF.type_logp), axis=1)
    assert changed.tolist() == [True, False, True, True]
    huge = np.full(done.trace.wrench_sensor.shape, 3e38, np.float32)  # whose sum is not finite
    require_update(BELIEF, traced(done, wrench_sensor=huge), KEYS, CONFIG)


def test_fake_engines_of_tests_give_what_is_accepted(attempts):
    require_update(BELIEF, FakeEngine().run(attempts, 2, np.zeros(N, bool)).felt, KEYS, CONFIG)


def test_checks_cost_little():
    n = 1000
    many = jax.tree.map(np.asarray, sound(n, 20))
    beliefs = initial_belief(jnp.full((n, 2), 0.5), 0.01, 3)
    keys = jax.random.split(jax.random.key(1), n)
    asked = draw_attempts(jax.random.key(0), jnp.arange(n), "mixed", CONFIG)

    def best(work):
        times = []
        for _ in range(5):
            began = time.perf_counter()
            work()
            times.append(time.perf_counter() - began)
        return min(times)

    assert best(lambda: requests.require_attempts(asked, 100, None, None, CONFIG)) < 0.01
    assert best(lambda: require_update(beliefs, many, keys, CONFIG)) < 0.1  # 6 million numbers of wrenches
