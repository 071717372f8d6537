"""The mirrored reading against the simulation of the mirrored world."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import make_rollouts

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.measurement import PoseConfig, WristConfig
from mjx_fit.control import policies
from mjx_fit.data.mirror import mirror_belief, mirror_place, mirror_reading
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.sensors.force_torque import centre_of_pressure, touched
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.task.effort import effort_of
from mjx_fit.types import Attempt, Belief, Reading

ACTIONS = 12


def circle(side):
    """A pressed circle, run through to the one or to the other side; nothing of it is random."""

    def command(seen):
        angle = 0.5 * seen.step
        return jnp.array([0.003 * jnp.cos(angle), side * 0.003 * jnp.sin(angle), -0.004])

    return policies.stateless(command)


def attempts(side: float) -> Attempt:
    """Every pair of peg and hole, a centimetre and a half beside the hole, away from the plane."""
    peg, hole = np.divmod(np.arange(9), 3)
    place = np.tile([0.5, 0.12], (9, 1)) + np.arange(9)[:, None] * [0.01, 0.015]
    estimate = place + np.array([0.008, 0.011])
    mirror = np.array([1, side])
    keys = jax.random.split(jax.random.key(0), 9)
    return Attempt(
        jnp.asarray(peg),
        jnp.asarray(hole),
        jnp.asarray(place * mirror, jnp.float32),
        jnp.asarray(estimate * mirror, jnp.float32),
        jnp.zeros(9, int),
        keys,
    )


def test_the_mirrored_reading_is_that_of_the_mirrored_world():
    config = Config(wrist=WristConfig().without_errors(), pose=PoseConfig().without_errors())
    readings = []
    for side in (1.0, -1.0):
        done = NativeEngine(config, threads=2, policy=circle(side)).run(attempts(side), ACTIONS)
        assert touched(done.felt, config.wrist)[:, 1:].any(1).all()
        readings.append(
            jax.vmap(lambda one, key: read_window(one, key, config, Window(ACTIONS)))(
                jax.tree.map(jnp.asarray, done.felt), jax.random.split(jax.random.key(1), 9)
            )
        )
    here, there = readings
    mirrored = mirror_reading(here)
    # The links' inertias are not quite symmetric, and impacts make little differences large. A wrong sign
    # makes a correlation negative.
    for name, axes, least in (
        ("wrench_sensor", 6, 0.5),
        ("pressure_tip", 2, 0.9),
        ("tip_pos_estimate", 2, 0.99),
        ("tip_linvel_world", 2, 0.95),
        ("action_world", 2, 0.99),
    ):
        pair = (np.asarray(getattr(x, name)) for x in (mirrored, there))
        a, b = (x.mean(2) if x.ndim == 4 else x for x in pair)
        for axis in range(axes):
            correlation = np.corrcoef(a[..., axis].ravel(), b[..., axis].ravel())[0, 1]
            assert correlation > least, (name, axis, correlation)
    np.testing.assert_allclose(mirrored.tip_quat_world, there.tip_quat_world, atol=2e-3)
    assert (np.asarray(mirrored.tip_quat_world)[..., 1] > 0.9).all()


def test_mirroring_twice_changes_nothing_and_a_belief_turns_with_its_hole():
    rng = np.random.default_rng(0)
    cov = np.array([[4.0, 1.0], [1.0, 2.0]]) * 1e-6
    belief = Belief(jnp.array([0.5, 0.1]), jnp.asarray(cov), jnp.log(jnp.ones(3) / 3))
    twice = mirror_belief(mirror_belief(belief))
    jax.tree.map(np.testing.assert_array_equal, twice, belief)
    draws = rng.multivariate_normal([0.5, 0.1], cov, 20_000)
    mirrored = np.asarray(mirror_place(draws))
    once = mirror_belief(belief)
    np.testing.assert_allclose(mirrored.mean(0), once.pos_mean_world, atol=1e-4)
    np.testing.assert_allclose(np.cov(mirrored.T), once.pos_cov, atol=1e-7)


def test_the_centre_of_pressure_is_where_the_force_acts():
    """A force at a point of the lower face, in the sensor's frame: x as the world's, y and z turned."""
    rng = np.random.default_rng(1)
    lever = 0.07
    for _ in range(20):
        at_world, force_world = (
            rng.uniform(-0.02, 0.02, 2),
            np.append(rng.normal(0, 3, 2), -rng.uniform(5, 30)),
        )
        flip = np.array([1.0, -1.0, -1.0])
        point, force = flip * np.append(at_world, -lever), flip * force_world
        wrench = np.concatenate([force, np.cross(point, force)])
        np.testing.assert_allclose(centre_of_pressure(jnp.asarray(wrench), lever), at_world, atol=1e-6)
    nothing = centre_of_pressure(jnp.zeros(6), lever)
    np.testing.assert_array_equal(nothing, [0, 0])


def test_a_mirrored_reading_turns_as_rigid_bodies_do():
    """With S the reflection, by matrices: positions and forces are S v, rotations S R S, and a torque or an
    angular velocity w, which is the skew matrix of x -> w x x, is S [w] S."""
    rng = np.random.default_rng(3)
    n, reflection = 40, np.diag([1.0, -1.0, 1.0])
    down = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
    turned = Rotation.from_rotvec(rng.normal(0, 0.4, (n, 3))) * down
    quat = turned.as_quat(scalar_first=True)
    quat *= np.sign(quat[:, 1:2])  # as ``control.tip_quaternion`` has it
    vector, axial, wrench = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), rng.normal(size=(n, 50, 6))
    reading = Reading(
        wrench_sensor=wrench,
        pressure_tip=vector[:, :2],
        tip_pos_estimate=vector,
        tip_quat_world=quat,
        tip_linvel_world=vector,
        tip_angvel_world=axial,
        contact=np.ones(n),
        action_world=vector,
        mask=np.ones(n, bool),
        peg_type=np.array(0),
    )
    mirrored = mirror_reading(reading)
    rotation = Rotation.from_quat(np.asarray(mirrored.tip_quat_world), scalar_first=True).as_matrix()
    np.testing.assert_allclose(rotation, reflection @ turned.as_matrix() @ reflection, atol=1e-12)
    assert (np.asarray(mirrored.tip_quat_world)[:, 1] > 0).all()
    for name in ("tip_pos_estimate", "tip_linvel_world", "action_world"):
        np.testing.assert_allclose(getattr(mirrored, name), vector @ reflection, atol=1e-12)
    np.testing.assert_allclose(mirrored.pressure_tip, (vector @ reflection)[:, :2], atol=1e-12)
    np.testing.assert_allclose(mirrored.wrench_sensor[..., :3], wrench[..., :3] @ reflection, atol=1e-12)
    for before, after in (
        (axial, mirrored.tip_angvel_world),
        (wrench[:, 0, 3:], mirrored.wrench_sensor[:, 0, 3:]),
    ):
        for a, b in zip(before, after, strict=True):
            skew = np.cross(np.eye(3), a)
            np.testing.assert_allclose(np.cross(np.eye(3), b), reflection @ skew @ reflection, atol=1e-12)


def test_a_touch_has_a_centre_of_pressure_on_the_face():
    """A hundredth of a newton with a torque of the noise's size would put it a metre away."""
    for torque in ([0.0, -1.0], [1.0, 0.0], [-1.0, 1.0]):
        got = centre_of_pressure(jnp.array([0, 0, 0.01, *torque, 0]), 0.07)
        np.testing.assert_allclose(
            got, 0.04 * np.array([-np.sign(torque[1]), -np.sign(torque[0])]), rtol=1e-6
        )


def test_the_peak_force_is_the_largest_of_the_real_samples():
    """By a loop: tared, of all samples of all actions that were performed, the force without the torque."""
    data = jax.tree.map(np.asarray, make_rollouts(6, actions=5, min_length=1).felt)
    # What the tare is taken from is no small matter, nor is a torque.
    tare = 30 + 10 * np.asarray(data.tare_sensor)
    wrench = np.asarray(data.trace.wrench_sensor) + tare[:, None, None]
    wrench[..., 3:] *= 100
    wrench[np.arange(5) >= data.length[:, None]] = 0
    data = replace(data, tare_sensor=tare, trace=replace(data.trace, wrench_sensor=wrench))
    assert data.length.min() < 5
    for i, got in enumerate(effort_of(data).peak_force_n):
        force = [
            np.linalg.norm(sample[:3] - tare[i, :3]) for row in wrench[i, : data.length[i]] for sample in row
        ]
        assert got == pytest.approx(max(force), rel=1e-5)
