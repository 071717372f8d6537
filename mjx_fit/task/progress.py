"""Beliefs while an attempt lasts: all of its actions so far are read, and its outcome is open."""

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Key

from mjx_fit.config.schema import Config
from mjx_fit.filters.frame import observation_in_world
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.sensors.reading import without_errors
from mjx_fit.task.estimator import Update, posterior, readings
from mjx_fit.types import Belief, Felt


def progress_update(config: Config, sensor: ContactSensor, *, logged: bool = True) -> Update:
    """Make the update of beliefs by the first actions of attempts.

    Unlike ``filter_update`` it knows no outcome. The sensor reads the trace anew each time, so any sensor
    serves, also one that looks ahead; ``attempt_readers`` has those that keep what they have read.

    Args:
        config: Defines the scene and the filters.
        sensor: The trained sensor.
        logged: As in ``filter_update``.
    """
    graph, state = nnx.split(sensor)
    seen_as, names = without_errors(config) if logged else config, config.filter.coordinates
    open_ = jnp.zeros((config.scene.n_types,) * 2)

    @jax.jit
    def learn(state, beliefs: Belief, felt: Felt, keys: Key[jax.Array, "n"]) -> Belief:
        seen = nnx.merge(graph, state)(readings(felt, keys, seen_as))
        seen = observation_in_world(seen, felt.estimate_world, names)
        return posterior(beliefs, seen, felt.peg_type, open_, config)

    return lambda beliefs, felt, keys: learn(state, beliefs, felt, keys)
