"""Beliefs in observations, against the sensor on rollouts of the engine."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("gymnasium")
from gymnasium.vector import AutoresetMode

from mjx_fit import load_sensor
from mjx_fit.config.files import read_config
from mjx_fit.control.policies import stateless
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.envs import InsertionVectorEnv
from mjx_fit.envs.belief import COMPONENTS, BeliefReading
from mjx_fit.envs.observation import POSITION_M, commanded
from mjx_fit.filters.updates import detected_belief
from mjx_fit.utils.errors import RequestError

ACTIONS, EVERY, N = 6, 3, 2
ACTION = np.array([0.2, -0.1, 0.5], np.float32)


@pytest.fixture(scope="module")
def sensor():
    return load_sensor()


@pytest.fixture(scope="module")
def config(sensor):
    return sensor.adapt(read_config(None, [f"task.attempt_actions={ACTIONS}", "spiral.radius_m=0.005"]))


def test_the_observed_belief_is_the_sensors_about_the_actions_so_far(sensor, config):
    env = InsertionVectorEnv(
        N, config=config, belief=BeliefReading(sensor, EVERY), autoreset_mode=AutoresetMode.SAME_STEP
    )
    first, _ = env.reset(seed=3)
    attempts = env._worlds._drawn()
    assert first.shape == env.observation_space.shape
    prior = config.detector.prior_std_m / POSITION_M
    wanted = np.tile([0, 0, prior, prior, 1 / 3], (N, 1))
    np.testing.assert_allclose(first[:, -COMPONENTS:], wanted, atol=1e-6)

    seen = [first, *(env.step(np.tile(ACTION, (N, 1)))[0] for _ in range(ACTIONS))]
    tails = np.stack([one[:, -COMPONENTS:] for one in seen])
    np.testing.assert_array_equal(tails[EVERY - 1], tails[0])
    np.testing.assert_array_equal(tails[EVERY], tails[ACTIONS - 1])
    np.testing.assert_allclose(tails[ACTIONS], tails[0], atol=1e-6)  # the next episodes

    press = stateless(lambda _: commanded(jnp.asarray(ACTION)), "press")
    felt = NativeEngine(config, 1, press).run(attempts, EVERY, horizon=ACTIONS).felt
    felt = replace(
        felt,
        trace=jax.tree.map(
            lambda leaf: np.pad(leaf, ((0, 0), (0, ACTIONS - EVERY), *[(0, 0)] * (leaf.ndim - 2))), felt.trace
        ),
    )
    reader = env._worlds._reader
    assert reader is not None
    belief = reader._update(detected_belief(attempts.estimate_world, config), felt, attempts.key)
    apart = np.asarray(belief.mean_world - attempts.estimate_world) / POSITION_M
    std = np.sqrt(np.diagonal(np.asarray(belief.cov), axis1=1, axis2=2)) / POSITION_M
    own = np.exp(np.asarray(belief.type_logp))[np.arange(N), np.asarray(attempts.peg_type)]
    np.testing.assert_allclose(tails[EVERY], np.column_stack([apart, std, own]), atol=1e-3)
    assert np.abs(tails[EVERY] - tails[0]).max() > 0.01


@pytest.mark.parametrize(
    ("every", "message"),
    [
        (0, f"belief: every: 0 is out of range: expected 1 to {ACTIONS}"),
        (ACTIONS + 1, "belief: every: 7 is out of range"),
    ],
)
def test_what_cannot_be_read_is_refused(sensor, config, every, message):
    with pytest.raises(RequestError, match=message):
        InsertionVectorEnv(N, config=config, belief=BeliefReading(sensor, every))


def test_worlds_begin_one_by_one(sensor, config):
    """An episode that ends alone leaves the beliefs of the others as they are."""
    env = InsertionVectorEnv(
        N, config=config, belief=BeliefReading(sensor, EVERY), autoreset_mode=AutoresetMode.DISABLED
    )
    env.reset(seed=3)
    for _ in range(EVERY):
        seen, *_ = env.step(np.tile(ACTION, (N, 1)))
    again, _ = env.reset(options={"reset_mask": np.array([True, False])})
    prior = config.detector.prior_std_m / POSITION_M
    np.testing.assert_allclose(again[0, -COMPONENTS:], [0, 0, prior, prior, 1 / 3], atol=1e-6)
    np.testing.assert_array_equal(again[1], seen[1])
    assert not np.allclose(again[1, -COMPONENTS:], again[0, -COMPONENTS:], atol=1e-3)


def test_a_sensor_alone_is_no_reading(sensor, config):
    with pytest.raises(RequestError, match=r"belief: .* is invalid: expected BeliefReading"):
        InsertionVectorEnv(N, config=config, belief=sensor)
