"""What policies may do besides commands: read like the learned sensor, report, give up; both engines."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mjx_fit.api import draw_attempts
from mjx_fit.config.schema import Config
from mjx_fit.control.policies import Policy
from mjx_fit.engines.select import make_engine
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.utils.errors import RequestError

N, ACTIONS = 5, 9
DOWN = jnp.array([0.0, 0.0, -0.004])


def counted(state, seen):
    """Press; report the number of the action and where the sensor would place the TCP."""
    read = seen.reading
    return {"step": seen.step, "place": read.tip_pos_estimate[0], "force": read.wrench_sensor[0]}, DOWN


FIRST = {"step": jnp.int32(-1), "place": jnp.zeros(3), "force": jnp.zeros((50, 6))}
READER = Policy(lambda start, key: FIRST, counted, "reader", reads=True, report=lambda state: state)
QUITTER = Policy(
    lambda start, key: (jnp.int32(0), start.peg_type),
    lambda state, seen: ((state[0] + 1, state[1]), DOWN),
    gives_up=lambda state: state[0] >= 3 + state[1],
)


@pytest.fixture(scope="module")
def exact() -> Config:
    config = Config()
    return replace(config, wrist=config.wrist.without_errors(), pose=config.pose.without_errors())


@pytest.mark.parametrize("engine", ["native", pytest.param("mjx", marks=pytest.mark.slow)])
def test_a_policy_reads_its_last_action_as_the_trace_is_read_later(engine, exact):
    attempts = draw_attempts(jax.random.key(1), N, config=exact)
    done = make_engine(engine, exact, READER).run(attempts, ACTIONS)
    whole = jax.vmap(lambda felt: read_window(felt, jax.random.key(0), exact, Window(ACTIONS)))(done.felt)
    assert (done.report["step"] == np.arange(ACTIONS)).all()
    read, later = done.report["place"][:, 1:], np.asarray(whole.tip_pos_estimate)[:, :-1]
    np.testing.assert_allclose(read, later, atol=1e-6)
    np.testing.assert_allclose(
        done.report["force"][:, 1:], np.asarray(whole.wrench_sensor)[:, :-1], rtol=1e-4, atol=1e-3
    )


@pytest.mark.parametrize("engine", ["native", pytest.param("mjx", marks=pytest.mark.slow)])
def test_an_attempt_ends_when_its_policy_gives_up(engine, exact):
    attempts = draw_attempts(jax.random.key(1), N, config=exact)
    done = make_engine(engine, exact, QUITTER).run(attempts, ACTIONS)
    assert done.report is None
    assert (done.felt.length == 3 + np.asarray(attempts.peg_type)).all()
    assert done.truth.valid.all()
    assert not done.truth.inserted.any()
    assert not np.asarray(done.felt.trace.wrench_sensor)[np.arange(N), done.felt.length].any()


@pytest.mark.parametrize("engine", ["native", pytest.param("mjx", marks=pytest.mark.slow)])
def test_a_policy_knows_which_rows_of_a_batch_count(engine, exact):
    """Those that are over do not, nor those that fill the batch up."""
    told = []

    def act(state, seen):
        jax.debug.callback(lambda *row: told.append([int(one) for one in row]), seen.step, seen.running)
        return QUITTER.act(state, seen)

    attempts = draw_attempts(jax.random.key(1), N, config=exact)
    done = make_engine(engine, exact, QUITTER._replace(act=act)).run(attempts, ACTIONS)
    jax.effects_barrier()
    counting = [sum(running for at, running in told if at == step) for step in range(ACTIONS)]
    assert counting == [int((done.felt.length > step).sum()) for step in range(ACTIONS)]
    assert len(told) > sum(counting)


def test_what_is_reported_stays_with_its_attempt_when_others_end(exact):
    """Blocks shrink as attempts end; 40 attempts share one."""

    def act(state, seen):
        return (state[0] + 1, state[1]), DOWN

    def init(start, key):
        return jnp.int32(0), start.estimate_world

    policy = Policy(
        init, act, report=lambda state: state[1], gives_up=lambda state: state[0] >= 1 + 2 * (state[1][1] > 0)
    )
    attempts = draw_attempts(jax.random.key(4), 40, config=exact)
    done = make_engine("native", exact, policy).run(attempts, 5)
    there = np.asarray(attempts.estimate_world)
    assert (done.felt.length == np.where(there[:, 1] > 0, 3, 1)).all()
    for i in range(40):
        assert (done.report[i, : done.felt.length[i]] == there[i]).all()
        assert not done.report[i, done.felt.length[i] :].any()


def test_a_report_is_selected_with_its_attempt(exact):
    attempts = draw_attempts(jax.random.key(1), 2, config=exact)
    done = make_engine("native", exact, READER).run(attempts, 2)
    assert (done[1].report["step"] == [0, 1]).all()


def test_a_policy_that_ends_by_anything_but_a_bool_is_refused(exact):
    policy = Policy(lambda start, key: jnp.int32(0), lambda state, seen: (state, DOWN), gives_up=lambda n: n)
    with pytest.raises(RequestError, match=r"^--policy: gives_up of the policy is int32 \(\): "):
        make_engine("native", exact, policy)
