"""The policy ``seek`` with a belief about poses: what it reports, and that the tool follows the rotation."""

from dataclasses import replace
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fakes import seen
from flax import nnx
from scipy.spatial.transform import Rotation

from mjx_fit.api import draw_attempts
from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.engines.select import make_engine
from mjx_fit.filters import frame
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.task.estimator import posterior
from mjx_fit.task.seek import plate_below, rocking, seek, turned_to_belief
from mjx_fit.types import Belief

N, ACTIONS, NOT = 2, 8, jnp.zeros((), bool)
NAMES = ("x", "y", "z", "yaw", "roll", "pitch")


def poses() -> Config:
    config = read_config(None, [f"filter.coordinates=[{', '.join(NAMES)}]", "control.push=force"])
    config = replace(config, wrist=config.wrist.without_errors(), pose=config.pose.without_errors())
    small = {"width": 16, "layers": 1, "heads": 2, "conv_channels": (4,) * 5, "causal": True}
    return replace(config, sensor=replace(config.sensor, **small))


def a_sensor(config: Config) -> ContactSensor:
    """A sensor whose answers depend on the trace."""
    sensor, rngs = ContactSensor.of(config, nnx.Rngs(3)), nnx.Rngs(4)
    for head in (sensor.position, sensor.match):
        head.last.kernel[...] = 2.0 * jax.random.normal(rngs.params(), head.last.kernel.shape)
    return sensor


@pytest.fixture(scope="module")
def visited():
    config = poses()
    sensor, drawn = a_sensor(config), draw_attempts(jax.random.key(1), N, config=config)
    estimate = jnp.asarray(drawn.estimate_world).at[:, 2:].set(jnp.array([0.002, 0.3, 0.05, -0.04]))
    prior = Belief(
        jnp.asarray(estimate) + jnp.array([0.003, -0.002, 0.001, 0.05, 0.01, -0.01]),
        jnp.broadcast_to(jnp.diag(jnp.array([4e-6, 9e-6, 1e-6, 1e-3, 4e-4, 1e-4])), (N, 6, 6)),
        jnp.log(jnp.broadcast_to(jnp.array([0.2, 0.3, 0.5]), (N, 3))),
    )
    attempts = replace(drawn, estimate_world=estimate, belief=prior)
    done = make_engine("native", config, seek(config, sensor)).run(attempts, ACTIONS)
    return config, sensor, prior, done


def test_the_report_is_the_belief_in_the_world(visited):
    config, sensor, prior, done = visited
    for got, want in zip(jax.tree.leaves(done.report), jax.tree.leaves(prior), strict=True):
        np.testing.assert_allclose(got[:, 0], want, rtol=2e-4, atol=1e-7)
    start, types = jnp.asarray(done.felt.estimate_world), jnp.zeros((3, 3))

    @jax.jit
    def after(count):
        """Return the filter's posterior in the frame of the estimate, carried to the world."""
        window = Window(ACTIONS, count=count)
        reading = jax.vmap(lambda felt: read_window(felt, jax.random.key(0), config, window))(done.felt)
        seen = frame.belief_in_frame(prior, start, NAMES)
        observed = sensor(reading)
        offset = frame.upright(start) - seen.mean_world
        turned = frame.frame_of(seen.mean_world, NAMES).rotation_world.inverse().log()
        offset = jnp.concatenate([offset[:, :3], turned[:, jnp.array([2, 0, 1])]], 1)
        observed = replace(observed, innovation=observed.innovation + offset)
        return frame.belief_in_world(
            posterior(seen, observed, done.felt.peg_type, types, config), start, NAMES
        )

    for j in range(1, int(np.min(done.felt.length))):
        want = after(j)
        np.testing.assert_allclose(done.report.mean_world[:, j], want.mean_world, atol=2e-5)
        np.testing.assert_allclose(done.report.cov[:, j], want.cov, atol=1e-6)


def test_the_tool_turns_towards_the_belief_no_faster_than_it_may(visited):
    config, _, _, done = visited
    turn, length = done.felt.trace.turn_world, int(np.min(done.felt.length))
    most = config.seek.turn_radps * 0.1
    for row in range(N):
        estimate = np.asarray(done.felt.estimate_world)[row, [4, 5, 3]]
        path = [Rotation.from_rotvec(estimate), *Rotation.from_rotvec(turn[row, :length])]
        steps = [(b * a.inv()).magnitude() for a, b in pairwise(path)]
        assert max(steps) <= most + 1e-5
        believed = Rotation.from_rotvec(np.asarray(done.report.mean_world)[row, length - 1][[4, 5, 3]])
        assert (believed * path[-1].inv()).magnitude() < (believed * path[0].inv()).magnitude()


def test_the_tool_stops_at_the_belief():
    config = poses()
    belief = Belief(jnp.array([0.4, 0, 0, 0.02, 0, 0.01]), jnp.eye(6), jnp.zeros(3))
    turn = jnp.zeros(3)
    for _ in range(5):
        turn = turned_to_belief(turn, belief, config)
    np.testing.assert_allclose(turn, [0, 0.01, 0.02], atol=1e-6)


def test_the_tool_rocks_by_believed_standard_deviations():
    """Over a long time it reaches what ``seek.rock`` allows in yaw, and tilts by it in all directions."""
    config = read_config(None, ["filter.coordinates=[x, y, yaw, roll, pitch]", "seek.rock=1.5"])
    std = np.array([0.01, 0.01, 0.1, 0.03, 0.02])
    belief = Belief(jnp.zeros(5), jnp.diag(jnp.square(jnp.asarray(std))), jnp.zeros(3))
    turns = np.asarray(jax.vmap(lambda step: rocking(step, belief, NOT, config))(jnp.arange(600)))
    np.testing.assert_allclose(turns.max(0), 1.5 * std[[3, 4, 2]], rtol=0.02)
    np.testing.assert_allclose(turns.min(0), -1.5 * std[[3, 4, 2]], rtol=0.02)
    np.testing.assert_allclose(((turns[:, :2] / (1.5 * std[[3, 4]])) ** 2).sum(1), 1, rtol=1e-4)
    yaw = read_config(None, ["filter.coordinates=[x, y, yaw]", "seek.rock=1.5"])
    planar = Belief(jnp.zeros(3), jnp.diag(jnp.array([1.0, 1, 0.01])), jnp.zeros(3))
    alone = rocking(jnp.asarray(7), planar, NOT, yaw)
    np.testing.assert_allclose(alone, [0, 0, turns[7, 2]], rtol=1e-5)


def test_the_tool_tilts_more_while_the_hole_may_be_far():
    config = read_config(None, ["filter.coordinates=[x, y, yaw]", "seek.probe_radpm=5"])
    belief = Belief(jnp.zeros(3), jnp.diag(jnp.array([1e-4, 3e-4, 0.01])), jnp.zeros(3))
    turns = np.asarray(jax.vmap(lambda step: rocking(step, belief, NOT, config))(jnp.arange(100)))
    np.testing.assert_allclose(np.hypot(turns[:, 0], turns[:, 1]), 5 * np.sqrt(2e-4), rtol=1e-5)
    np.testing.assert_array_equal(turns[:, 2], 0)
    np.testing.assert_array_equal(rocking(jnp.asarray(7), belief, ~NOT, config), 0)
    most = replace(config, seek=replace(config.seek, probe_most_rad=0.02))
    np.testing.assert_allclose(jnp.linalg.norm(rocking(jnp.asarray(7), belief, NOT, most)), 0.02, rtol=1e-5)


def test_the_plate_below_the_tool_is_the_believed_plane():
    """By its equation: n · (p - c) = 0, with c the believed place of the socket's top and n its normal."""
    config, rng = poses(), np.random.default_rng(2)
    for _ in range(5):
        place = rng.uniform(-1, 1, 6) * [0.02, 0.02, 0.004, 0.2, 0.05, 0.05]
        cov = np.diag(rng.uniform(0.1, 1, 6) ** 2)
        belief = Belief(jnp.asarray(place), jnp.asarray(cov), jnp.zeros(3))
        tip = rng.uniform(-0.02, 0.02, 3) + np.array([0, 0, 0.05])
        normal = Rotation.from_rotvec(place[[4, 5, 3]]).as_matrix()[:, 2]
        top = np.append(place[:2], plate_top_m(config.scene) + place[2])
        height = top[2] - normal[:2] @ (tip[:2] - top[:2]) / normal[2]
        found = plate_below(belief, seen(tuple(tip)), config)
        assert found is not None
        # Along the normal instead of straight down: by less than the tilt's square.
        assert float(found.height_m) == pytest.approx(height, abs=0.01 * abs(tip[2] - height) + 1e-6)
        assert float(found.std_m) == pytest.approx(np.sqrt(cov[2, 2]), rel=1e-5)
    assert plate_below(belief, seen(), read_config(None, [])) is None


def test_a_peg_in_the_air_does_not_rock():
    config = replace(poses(), seek=replace(poses().seek, rock=3.0))
    drawn = draw_attempts(jax.random.key(1), 1, config=config)
    prior = Belief(
        jnp.asarray(drawn.estimate_world), 1e-2 * jnp.eye(6)[None], jnp.full((1, 3), -jnp.log(3.0))
    )
    attempts = replace(drawn, belief=prior)
    raised = replace(config, scene=replace(config.scene, start_height_m=0.015))
    turns = []
    for one in (raised, config):
        turn = make_engine("native", one, seek(one)).run(attempts, 5).felt.trace.turn_world
        assert turn is not None
        turns.append(turn[0])
    np.testing.assert_array_equal(turns[0][:2], 0)
    assert np.abs(turns[1]).max() > 0.05
