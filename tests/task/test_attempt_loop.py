"""The one loop around attempts: what is asked, simulated, learned and given, in which order."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from fakes import FakeEngine

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.learning import SensorConfig
from mjx_fit.control.policies import SPIRAL
from mjx_fit.filters.updates import initial_belief
from mjx_fit.task.attempt_loop import Try, attempt_rounds, spirals_at
from mjx_fit.training.sensor_loader import TrainedSensor

N = 3
KEYS = jax.random.split(jax.random.key(0), N)


def test_a_round_is_asked_for_simulated_learned_from_and_taken_before_the_next():
    told, engine = [], FakeEngine()
    start = np.zeros((N, 2), np.float32)
    types = np.arange(N)
    attempts = spirals_at(types, types, start, start, KEYS)
    belief = initial_belief(jnp.zeros((N, 2)), 0.01, 3)
    active = np.array([True, False, True])

    def next_try():
        number = len([word for word in told if word == "asked"])
        told.append("asked")
        # The last round teaches nothing: it has no keys of noise.
        return None if number == 2 else Try(attempts, active, belief, KEYS if number == 0 else None)

    def update(beliefs, felt, keys):
        assert keys is KEYS
        told.append("learned")
        return replace(beliefs, mean_world=beliefs.pos_mean_world + 1)

    for tried in attempt_rounds(next_try, engine, update, 2):
        told.append("taken")
        assert np.array_equal(tried.rollouts.felt.length > 0, active)
        moved = tried.beliefs.pos_mean_world - belief.pos_mean_world
        # The middle one has a peg that matches, close to its hole: it is in, and its belief stays.
        expected = (told.count("taken") == 1) & ~np.asarray(tried.rollouts.truth.inserted)
        assert (np.asarray(moved) == expected[:, None]).all()
    assert told == ["asked", "learned", "taken", "asked", "taken", "asked"]
    assert len(engine.seen) == 2
    assert (np.asarray(attempts.policy) == SPIRAL).all()


def test_a_trained_sensor_brings_its_network_and_tells_what_else_differs():
    trained = replace(
        Config(), sensor=SensorConfig(width=16), wrist=replace(Config().wrist, force_noise_n=0.3)
    )
    network = None
    sensor = TrainedSensor(network, trained, "f")  # pyright: ignore[reportArgumentType]
    adapted = sensor.adapt(Config())
    assert adapted == replace(Config(), sensor=trained.sensor)
    (difference,) = sensor.differences(Config())
    assert difference.startswith("wrist.force_noise_n is 0.3 there")
    assert sensor.differences(adapted) == [difference]
