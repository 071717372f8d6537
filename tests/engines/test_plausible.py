"""Attempts outside the range of the model are stopped, named, counted and left out of training."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic import make_episodes

from mjx_fit.config.schema import Config
from mjx_fit.control import open_loop, policies
from mjx_fit.data import collect, reader
from mjx_fit.data.episode import happened
from mjx_fit.data.plan import Plan
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines import failures, plausible
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.scene.robot import PANDA
from mjx_fit.training import train
from mjx_fit.training.run import Run

CONFIG = Config()
SCENE = CONFIG.scene
LIMIT_NM = np.array(PANDA.torque_limit_nm, np.float32)
PUSHES = {
    "the peg left the socket": (0.05, 0, 0),
    "degrees (at most 45 are plausible)": (0, 0, -1.0),
    "a joint reached 2.0 s at its torque limit": (0, 0, -0.1),
}


def pushing(push):
    """An engine in which attempts of one policy are pushed by so much (m) in each action instead."""

    pushed = policies.stateless(lambda seen: jnp.asarray(push, jnp.float32))
    engine = NativeEngine(CONFIG, 1, policies.by_name(open_loop.spiral(CONFIG.spiral), pushed))
    engine.policy_name = None  # its data are stored as those of the library's own policies
    return engine


def half_pushed(n=8):
    attempts = draw_attempts(jax.random.key(0), jnp.arange(n), "spiral", CONFIG)
    return dataclasses.replace(attempts, policy=np.arange(n) % 2)


@pytest.mark.parametrize("why", PUSHES)
def test_what_left_is_stopped_named_and_alone(why, native, tmp_path, capsys):
    attempts, n, actions = half_pushed(), 8, 24
    engine = pushing(PUSHES[why])
    done = engine.run(attempts, actions)
    pushed = np.arange(n) % 2 == 1
    assert not done.truth.valid[pushed].any()
    assert done.truth.valid[~pushed].all()
    assert not done.truth.inserted[pushed].any()
    assert (done.felt.length[pushed] < actions).all()
    # The others are, to the bit, as they are without any that left.
    alone = engine.run(attempts, actions, ~pushed)
    for a, b in zip(jax.tree.leaves(done), jax.tree.leaves(alone), strict=True):
        assert np.array_equal(a[~pushed], b[~pushed])
    # Where it ended is the state before its last action, from which that action can be done again.
    first = int(np.flatnonzero(pushed)[0])
    assert failures.report(done, attempts, np.arange(n), actions, CONFIG, tmp_path) == 4
    assert failures.kept_in(tmp_path) == 4
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 4
    assert any(why in line for line in said)
    assert all(
        f"in action {done.felt.length[i] - 1}; it is left out" in line
        for i, line in zip((1, 3, 5, 7), said, strict=True)
    )
    last = int(done.felt.length[first]) - 1
    one, row = jax.tree.map(lambda leaf: leaf[first : first + 1], attempts), slice(first, first + 1)
    again = engine.act(
        one,
        np.asarray(done.truth.end_qpos)[row],
        np.asarray(done.truth.end_qvel)[row],
        last,
        actions,
        jax.tree.map(lambda leaf: leaf[row], failures.goals_before(done, CONFIG)),
    )
    assert again.felt.trace.tip_pos_world[0, last] == pytest.approx(
        done.felt.trace.tip_pos_world[first, last], abs=1e-3
    )


def quaternion(axis, degrees):
    """Straight down, turned by an angle about an axis: the product of the two quaternions, x not negative."""
    half = np.radians(degrees) / 2
    a, b, c, d = np.cos(half), *(np.sin(half) * np.asarray(axis) / np.linalg.norm(axis))
    product = np.array([-b, a, d, -c])  # (a, b, c, d) times (0, 1, 0, 0)
    return (product * np.sign(product[1])).astype(np.float32)


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda axis: np.linalg.norm(axis) > 0.1), st.floats(0, 90))
def test_tilt_is_the_whole_angle_to_straight_down(axis, degrees):
    if abs(degrees - plausible.MOST_TILT_DEG) < 0.01:
        return
    over = (np.array([0.5, 0, 0.045], np.float32), quaternion(axis, degrees), np.array([0.5, 0], np.float32))
    for kind in (np.asarray, jnp.asarray):  # both engines ask
        tip, turned, hole = map(kind, over)
        lost = plausible.is_lost(tip, turned, hole, SCENE)
        assert bool(lost) == (degrees > plausible.MOST_TILT_DEG)


@pytest.mark.parametrize(
    ("x", "y", "z", "lost"),
    [
        (0.0, 0.0, 0.045, False),
        (0.079, -0.079, 0.045, False),
        (0.081, 0.0, 0.045, True),
        (0.0, -0.081, 0.045, True),
        (0.0, 0.0, 0.01, False),  # on the floor of the hole
        (0.0, 0.0, 0.0085, False),
        (0.0, 0.0, 0.007, True),
        (0.0, 0.0, -0.2, True),
        (0.0, 0.0, 0.4, False),  # lifted: nothing is wrong with that
    ],
)
def test_the_plate_ends_where_it_ends(x, y, z, lost):
    hole = np.array([0.4, -0.1], np.float32)
    at = np.array([0.4 + x, -0.1 + y, z], np.float32)
    assert bool(plausible.is_lost(at, quaternion((1, 0, 0), 0), hole, SCENE)) is lost
    wider = dataclasses.replace(SCENE, plate_half_width_m=0.1)
    assert not plausible.is_lost(np.array([0.481, -0.1, 0.045]), quaternion((1, 0, 0), 0), hole, wider)


@given(st.lists(st.booleans(), max_size=30))
def test_only_actions_in_a_row_at_a_limit_count(throughout):
    held, longest, run = np.zeros(1, np.int32), 0, 0
    for whole in throughout:
        held = plausible.actions_at_limit(held, np.array([whole]))
        run = run + 1 if whole else 0
        longest = max(longest, run)
        assert held[0] == run
    assert held.dtype == np.int32


def test_a_torque_is_at_its_limit_at_the_limit_of_any_joint():
    inside = 0.999 * LIMIT_NM
    assert not plausible.at_limit(inside, PANDA)
    for joint in range(7):
        for sign in (-1, 1):
            torque = inside.copy()
            torque[joint] = sign * LIMIT_NM[joint]
            assert plausible.at_limit(torque, PANDA)


def test_many_are_counted_and_not_all_named(tmp_path, capsys):
    attempts = half_pushed(30)
    done = pushing((0.3, 0, 0)).run(attempts, 2)
    assert failures.report(done, attempts, np.arange(30), 2, CONFIG, tmp_path) == 15
    said = capsys.readouterr().err.splitlines()
    assert len(said) == failures.MOST_LINES + 1
    assert "5 more episodes of this batch are left out, too" in said[-1]
    assert failures.kept_in(tmp_path) == 15


def test_a_data_set_counts_them_and_training_leaves_them_out(tmp_path, monkeypatch, capsys):
    plan = Plan(12, 3, "mixed", "native", batch=6)
    collect.collect(CONFIG, tmp_path / "data", plan, pushing((0.3, 0, 0)))
    assert collect.invalid_in(tmp_path / "data") == ", 6 invalid (excluded from training)"
    assert reader.describe(tmp_path / "data")["invalid"] == 6
    data = reader.load(tmp_path / "data")
    assert happened(data).sum() == 6
    assert "6 invalid" in capsys.readouterr().err
    monkeypatch.setattr(train, "train", lambda *args, **kwargs: False)
    train.train_with_baseline(data, CONFIG, Run(tmp_path / "run", 0))
    assert capsys.readouterr().err == "mjx-fit: 6 of 12 interactions are invalid and left out\n"
    train.train_with_baseline(make_episodes(), CONFIG, Run(tmp_path / "run", 0))
    assert capsys.readouterr().err == ""
