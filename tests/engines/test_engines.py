"""The two engines against each other, attempt by attempt."""

import dataclasses

import h5py
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.control import open_loop, policies
from mjx_fit.control.policies import SPIRAL
from mjx_fit.data import collect, hdf5_fields, reader
from mjx_fit.data.plan import Plan
from mjx_fit.data.schedule import draw_attempts, pair_of
from mjx_fit.engines import attempt_rules, failures, select
from mjx_fit.engines.mjx.engine import MjxEngine, rows_of
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.scene.build import simulation_scene
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.types import Attempt
from mjx_fit.utils.errors import RequestError

CONFIG = read_config(world_file("paper"))


def test_forces_are_pushes_and_not_artefacts(native):
    """A solver that stops too early shows as single steps of hundreds of newtons, some in every attempt."""
    attempts = draw_attempts(jax.random.key(5), jnp.arange(24), "spiral", CONFIG)
    done = native.run(attempts, 40)
    force = np.linalg.norm(
        (done.felt.trace.wrench_sensor - done.felt.tare_sensor[:, None, None])[..., :3], axis=-1
    )
    assert np.median(force[:, 10:]) > 5
    assert np.quantile(force.max((1, 2)), 0.9) < 120
    assert force.max() < 200


@pytest.mark.parametrize("n", [1, 2, 255, 512, 513, 4096])
def test_mjx_computes_few_enough_rows_at_once_on_a_cpu(n):
    rows = rows_of(n)
    assert rows <= (128 if jax.default_backend() == "cpu" else n)
    assert -(-n // rows) <= max(2, n // 100)


BROKEN, BROKEN_ACTION, MARK = 7, 2, 10
LEFT, LEFT_MARK = 3, 20
REMEMBERS_MARK = 30
PER_CONTACT_M, PER_NEWTON_M, AHEAD_S = 1e-4, 1e-4, 0.02


def _breakable() -> policies.Policy:
    """The library's policies; for an attempt that is marked, NaN in one action, or 30 cm in x in all from it,
    or a policy that counts the actions in which it felt contact and yields to the last force.

    The poison is in the batch, not in the program: another program may round differently everywhere. So whole
    batches run in it too, and most of this file needs one compilation of MJX, a minute on a CPU.
    """
    real = open_loop.shipped(CONFIG)

    def init(start, key):
        own = real.init(dataclasses.replace(start, policy=start.policy % MARK), key)
        return start.policy // MARK, jnp.int32(0), own

    def act(state, seen):
        mark, contacts, own = state
        contacts = contacts + seen.contact
        poison = (seen.step == BROKEN_ACTION) & (mark == 1)
        away = (seen.step >= BROKEN_ACTION) & (mark == LEFT_MARK // MARK)
        start = dataclasses.replace(seen.start, policy=seen.start.policy % MARK)
        own, command = real.act(own, dataclasses.replace(seen, start=start))
        command = command + jnp.where(poison, jnp.nan, 0)
        command += jnp.where(away, 0.3, 0) * jnp.array([1.0, 0, 0])
        x = PER_CONTACT_M * contacts + AHEAD_S * seen.tip_linvel_world[0]
        z = jnp.where(seen.step == 0, 0.0, -CONFIG.spiral.push_m)  # first it waits in the air
        yielding = jnp.stack([x, PER_NEWTON_M * seen.wrench_sensor[:, 2].mean(), z])
        return (mark, contacts, own), jnp.where(mark == REMEMBERS_MARK // MARK, yielding, command)

    return policies.Policy(init, act)


breakable = _breakable()


@pytest.fixture(scope="module")
def rollouts():
    attempts = draw_attempts(jax.random.key(7), jnp.arange(12), "mixed", CONFIG)
    active = np.arange(12) != 4
    simulators = NativeEngine(CONFIG, 2, breakable), MjxEngine(CONFIG, 2, breakable)
    for simulator in simulators:
        simulator.policy_name = None  # its data are stored as those of the library's own policies
    return attempts, [simulator.run(attempts, 4, active) for simulator in simulators], simulators, active


def test_a_policy_remembers_and_sees_what_the_robot_measures(rollouts):
    """Its commands, recomputed from the trace: contacts counted, force and velocity of the action before."""
    attempts, _, simulators, _ = rollouts
    asked = dataclasses.replace(attempts, policy=np.asarray(attempts.policy) + REMEMBERS_MARK)
    for simulator in simulators:
        done = simulator.run(asked, 4)
        trace, tare = done.felt.trace, done.felt.tare_sensor
        force = (trace.wrench_sensor - tare[:, None, None])[..., :3]
        touched = np.square(force).sum(-1).mean(-1) > CONFIG.wrist.contact_force_n**2
        assert not touched[:, 0].any()
        assert touched[:, -1].all()
        contacts = np.cumsum(touched, 1)
        for step in range(4):
            before, any_before = max(step - 1, 0), step > 0
            x = PER_CONTACT_M * contacts[:, before] + AHEAD_S * trace.tip_linvel_world[:, before, 0]
            y = PER_NEWTON_M * force[:, before, :, 2].mean(1)
            z = np.full_like(x, -CONFIG.spiral.push_m)
            want = np.stack([x, y, z], 1) * any_before
            ran = np.asarray(done.felt.length) > step
            # A mean of 50 samples, and the tare, are each known to 0.014 N.
            np.testing.assert_allclose(trace.action_world[ran, step], want[ran], atol=1e-5)


def test_a_rollout_needs_no_lapack(rollouts):
    """Its batched calls can wait for each other for ever inside XLA's pool of threads."""
    attempts, _, (_, mjx), active = rollouts
    half = jax.tree.map(lambda leaf: leaf[:6], attempts)
    lowered = mjx._jitted.lower(half, active[:6], actions=4, horizon=4)
    assert "lapack" not in lowered.as_text()


def test_engines_give_the_same_trace(rollouts):
    _, (in_c, in_mjx), *_ = rollouts
    assert jax.tree.structure(in_c) == jax.tree.structure(in_mjx)
    for a, b in zip(jax.tree.leaves(in_c), jax.tree.leaves(in_mjx), strict=True):
        assert a.shape == b.shape
        assert a.dtype == b.dtype
    # The draws are equal, so the first actions are; contact then makes the paths part, slowly in most worlds.
    assert np.abs(in_c.felt.trace.action_world - in_mjx.felt.trace.action_world)[:, 0].max() < 1e-6
    apart = np.abs(in_c.felt.trace.tip_pos_world - in_mjx.felt.trace.tip_pos_world).max(-1)
    assert apart[:, 0].max() < 2e-4
    assert np.median(apart) < 5e-4
    assert np.abs(in_c.felt.tare_sensor - in_mjx.felt.tare_sensor).max() < 1e-4
    first = np.abs(in_c.felt.trace.wrench_sensor - in_mjx.felt.trace.wrench_sensor)[:, 0, :20]
    assert np.median(first) < 1e-3


def test_both_engines_store_the_same_schema(rollouts, tmp_path):
    files = {}
    for simulator in rollouts[2]:
        plan = Plan(12, 4, "random", simulator.name, batch=12)
        collect.collect(CONFIG, tmp_path / simulator.name, plan, simulator)
        assert reader.describe(tmp_path / simulator.name)["engine"] == simulator.name
        files[simulator.name] = h5py.File(tmp_path / simulator.name / "shard-00000000.h5")
    with files["native"] as c, files["mjx"] as mjx:
        assert set(mjx) == set(c)
        for name in hdf5_fields.FIELDS:
            assert mjx[name].dtype == c[name].dtype
            assert dict(mjx[name].attrs) == dict(c[name].attrs)
            assert mjx[name].shape == c[name].shape
        start = (c["estimate_world"][:], mjx["estimate_world"][:])
        assert np.array_equal(*start)


def test_inactive_worlds_stand_still(rollouts):
    for rollout in rollouts[1]:
        assert rollout.felt.length[4] == 0
        assert not rollout.truth.inserted[4]
        assert np.abs(rollout.felt.trace.wrench_sensor[4]).max() == 0
        assert (np.delete(rollout.felt.length, 4) == 4).all()


def test_attempt_starts_at_rest_over_the_estimate(rollouts):
    attempts, (in_c, _), *_ = rollouts
    moved = in_c.felt.trace.tip_pos_world[:, 0, :2] - np.asarray(attempts.estimate_world)
    assert np.abs(np.delete(moved, 4, 0)).max() < 0.01
    # Free until it lands: the first sample is the weight of a peg that is just being let go.
    first = in_c.felt.trace.wrench_sensor[:, 0, 0] - in_c.felt.tare_sensor
    assert np.abs(np.delete(first, 4, 0)).max() < 2.0
    assert np.delete(in_c.felt.tare_sensor[:, 2], 4) == pytest.approx(-0.1 * 9.81, abs=1e-3)


def test_same_attempts_give_the_same_bytes(rollouts):
    attempts, first, simulators, active = rollouts
    for simulator, before in zip(simulators, first, strict=True):
        again = simulator.run(attempts, 4, active)
        for a, b in zip(jax.tree.leaves(before), jax.tree.leaves(again), strict=True):
            assert np.array_equal(a, b)


@pytest.fixture(scope="module")
def injected(rollouts):
    """For each engine the batch when it is whole, and when one of its worlds breaks."""
    attempts, whole, simulators, active = rollouts
    poisoned = dataclasses.replace(attempts, policy=attempts.policy.at[BROKEN].add(MARK))
    hurt = [simulator.run(poisoned, 4, active) for simulator in simulators]
    return list(zip(whole, hurt, strict=True))


def test_a_broken_world_is_flagged_frozen_and_alone(injected):
    """Its state stays that before the action that broke it; all other worlds are as they were, to the bit."""
    others = np.delete(np.arange(12), BROKEN)
    for whole, hurt in injected:
        assert np.array_equal(hurt.truth.valid, np.arange(12) != BROKEN)
        assert not hurt.truth.inserted[BROKEN]
        assert hurt.felt.length[BROKEN] == BROKEN_ACTION + 1
        for a, b in zip(jax.tree.leaves(hurt), jax.tree.leaves(whole), strict=True):
            assert np.array_equal(a[others], b[others])
        tip = mujoco_tip_pos(hurt.truth.end_qpos[BROKEN])
        assert tip == pytest.approx(hurt.felt.trace.tip_pos_world[BROKEN, BROKEN_ACTION - 1], abs=1e-5)
        assert np.isfinite(hurt.truth.end_qvel[BROKEN]).all()


def test_a_peg_that_left_its_plate_is_treated_likewise(rollouts, tmp_path, capsys):
    attempts, whole, simulators, active = rollouts
    away = dataclasses.replace(attempts, policy=attempts.policy.at[LEFT].add(LEFT_MARK))
    others = np.delete(np.arange(12), LEFT)
    for before, simulator in zip(whole, simulators, strict=True):
        done = simulator.run(away, 4, active)
        assert np.array_equal(done.truth.valid, np.arange(12) != LEFT)
        assert BROKEN_ACTION < done.felt.length[LEFT] <= 4
        for a, b in zip(jax.tree.leaves(done), jax.tree.leaves(before), strict=True):
            assert np.array_equal(a[others], b[others])
        last = done.felt.length[LEFT] - 1
        tip = mujoco_tip_pos(done.truth.end_qpos[LEFT])
        assert tip == pytest.approx(done.felt.trace.tip_pos_world[LEFT, last - 1], abs=1e-5)
        assert failures.report(done, attempts, np.arange(12), 4, CONFIG, tmp_path) == 1
        assert (
            f"episode 3: the peg left the socket in action {last}; it is left out" in capsys.readouterr().err
        )


def mujoco_tip_pos(qpos):
    model = simulation_scene(CONFIG.scene).models[0]
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data.site("tip").xpos


def test_a_broken_world_is_reported_and_can_be_replayed(rollouts, injected, tmp_path, capsys):
    attempts, (whole, _), *_ = rollouts
    for _, stopped in injected:
        ids = 100 + np.arange(12)
        assert failures.report(stopped, attempts, ids, 4, CONFIG, tmp_path) == 1
        assert "episode 107: the simulation turned non-finite in action 2" in capsys.readouterr().err
        # Done again without the injection, the action goes as it went in the batch that was whole.
        again = failures.replay(tmp_path / "broken-00000107.npz")
        row, there = (
            jax.tree.map(lambda leaf, i=i: leaf[i, BROKEN_ACTION], done.felt.trace)
            for i, done in ((0, again), (BROKEN, whole))
        )
        assert row.action_world == pytest.approx(there.action_world, abs=2e-4)
        assert row.tip_pos_world == pytest.approx(there.tip_pos_world, abs=2e-4)
        assert row.wrench_sensor[0] == pytest.approx(there.wrench_sensor[0], abs=1)
        assert np.abs(again.felt.trace.action_world[0, :BROKEN_ACTION]).max() == 0
    assert failures.report(whole, attempts, ids, 4, CONFIG, tmp_path) == 0


def test_an_episode_does_not_depend_on_its_batch(rollouts):
    """In other batches, another order and another engine the draws are equal; in C so is everything else."""
    attempts, (in_c, in_mjx), (native, mjx), _ = rollouts
    ids = np.array([9, 2, 11, 5, 0])
    asked = draw_attempts(jax.random.key(7), jnp.asarray(ids), "mixed", CONFIG)
    for a, b in zip(jax.tree.leaves(asked), jax.tree.leaves(attempts), strict=True):
        assert np.array_equal(plain(a), plain(b)[ids])
    for threads in (1, 2):
        again = NativeEngine(CONFIG, threads, breakable).run(asked, 4)
        for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(in_c), strict=True):
            assert np.array_equal(a, b[ids])
    some = native.run(draw_attempts(jax.random.key(7), jnp.arange(100), "mixed", CONFIG), 4)
    for a, b in zip(jax.tree.leaves(some), jax.tree.leaves(in_c), strict=True):
        assert np.array_equal(a[ids], b[ids])  # in blocks of 64 rows instead of 32
    others = np.concatenate([ids, np.arange(20, 27)])  # as many as were compiled for
    asked = draw_attempts(jax.random.key(7), jnp.asarray(others), "mixed", CONFIG)
    require_alike(mjx.run(asked, 4), in_mjx, ids)


@pytest.mark.slow
def test_an_episode_in_mjx_does_not_depend_on_the_number_of_worlds(rollouts):
    """It is compiled anew for each."""
    _, (_, in_mjx), (_, mjx), _ = rollouts
    ids = np.array([9, 2, 11, 5, 0])
    asked = draw_attempts(jax.random.key(7), jnp.asarray(ids), "mixed", CONFIG)
    require_alike(mjx.run(asked, 4), in_mjx, ids)


def require_alike(again, before, ids):
    """The same draws: the same tare and first action, within what rounding makes."""
    n = len(ids)
    assert np.abs(again.felt.tare_sensor[:n] - before.felt.tare_sensor[ids]).max() < 1e-5
    assert np.abs(again.felt.trace.action_world[:n] - before.felt.trace.action_world[ids])[:, 0].max() < 1e-6


def test_noise_of_a_reading_depends_on_its_key_alone(rollouts):
    """Whatever the engine that the trace came from, and whatever the batch, the noise is the same."""
    _, (in_c, in_mjx), *_ = rollouts
    keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(1), jnp.arange(12))

    def noise(rollouts, rows):
        def one(rollout, key):
            reading = read_window(rollout.felt, key, CONFIG, Window(4))
            clean = rollout.felt.trace.wrench_sensor - rollout.felt.tare_sensor
            return jnp.where(reading.mask[:, None, None], reading.wrench_sensor - clean, 0)

        chosen = jax.tree.map(lambda leaf: jnp.asarray(leaf)[rows], rollouts)
        return np.asarray(jax.vmap(one)(chosen, keys[rows]))

    whole = noise(in_c, np.arange(12))
    assert whole.std() > 0.01
    assert np.abs(noise(in_mjx, np.arange(12)) - whole).max() < 1e-4
    assert np.abs(noise(in_c, np.array([8, 3])) - whole[[8, 3]]).max() < 1e-4


def plain(leaf):
    is_key = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(leaf) if is_key else leaf)


def spiral_attempts(peg, hole, error_m, n):
    keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(2), jnp.arange(n))
    place = np.tile(np.array([0.5, 0.1], np.float32), (n, 1))
    return Attempt(peg, hole, place, place + np.array([error_m, 0], np.float32), np.full(n, SPIRAL), keys)


def test_matched_pegs_enter_and_mismatched_never_do(native):
    """From the true position a matched peg goes in; no other peg ever does. Contact pushes up."""
    peg, hole = pair_of(np.array([0, 2, 4, 1, 3, 5, 7, 9, 11]), 3)
    done = native.run(spiral_attempts(peg, hole, 0.0, 9), CONFIG.task.attempt_actions)
    assert done.truth.inserted.tolist() == [True] * 3 + [False] * 6
    assert done.truth.valid.all()
    depth = native.scene.plate_top_m - done.felt.trace.tip_pos_world[..., 2]
    for i in range(3):
        last = done.felt.length[i] - 1
        assert depth[i, last] >= CONFIG.task.insertion_depth_m
        assert (depth[i, :last] < CONFIG.task.insertion_depth_m).all()
        assert np.abs(done.felt.trace.tip_pos_world[i, done.felt.length[i] :]).sum() == 0
    # The arm pushes the peg along the tool's axis: plus z of the sensor.
    pushing = (done.felt.trace.wrench_sensor - done.felt.tare_sensor[:, None, None])[3:, 5:, :, 2]
    assert np.median(pushing) > 5


def test_only_a_peg_in_its_hole_is_inserted(scene):
    """Beside the plate, and under it, a tip may be as low."""
    top, hole = scene.plate_top_m, np.zeros(2, np.float32)
    floor = top - CONFIG.scene.hole_depth_m
    heights = top, top - 0.0101, floor, floor - 0.01, -0.3, 0.02
    places = np.array([[0.09 * (i == 5), 0, height] for i, height in enumerate(heights)])
    inserted = attempt_rules.is_inserted(places, hole, scene.config, 0.01)
    assert inserted.tolist() == [False, True, True, False, False, False]
    # To any side, as far as 2 cm; and a peg exactly as deep as it must be is in.
    ring = 0.019 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1], [0.7, 0.7]])
    deep = np.full((5, 1), top - 0.02)
    assert attempt_rules.is_inserted(np.hstack([ring, deep]), hole, scene.config, 0.02 - 1e-9).all()
    assert not attempt_rules.is_inserted(np.hstack([1.1 * ring, deep]), hole, scene.config, 0.01)[:4].any()
    assert attempt_rules.is_inserted(np.array([0, 0, floor]), hole, scene.config, top - floor)


def test_auto_is_native_on_a_cpu_and_unknown_engines_are_refused():
    assert select.resolve("auto") == ("native" if jax.default_backend() == "cpu" else "mjx")
    with pytest.raises(RequestError, match="--engine: 'warp9' is invalid: choose from auto, mjx, native"):
        select.resolve("warp9")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_mjx_inserts_matched_pegs_only():
    """The whole length of an attempt, which takes MJX minutes on a CPU."""
    simulator = MjxEngine(CONFIG, 2)
    peg, hole = pair_of(np.array([0, 2, 4, 1, 3, 5, 7, 9, 11]), 3)
    done = simulator.run(spiral_attempts(peg, hole, 0.0, 9), CONFIG.task.attempt_actions)
    assert done.truth.inserted.tolist() == [True] * 3 + [False] * 6
    assert done.truth.valid.all()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_hundred_mismatched_attempts_from_the_detector_never_insert(native):
    attempts = draw_attempts(jax.random.key(0), jnp.arange(1, 241, 2), "spiral", CONFIG)
    assert (np.asarray(attempts.peg_type) != np.asarray(attempts.hole_type)).all()
    done = native.run(attempts, CONFIG.task.attempt_actions)
    assert not done.truth.inserted.any()
    assert done.truth.valid.all()


@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["native", pytest.param("mjx", marks=pytest.mark.slow)])
def test_a_thousand_worlds_run(name):
    n = 1024
    attempts = draw_attempts(jax.random.key(0), jnp.arange(n), "mixed", CONFIG)
    simulator = NativeEngine(CONFIG, 2) if name == "native" else MjxEngine(CONFIG, 2)
    done = simulator.run(attempts, 2)
    assert done.truth.valid.all()
    assert (done.felt.length == 2).all()
