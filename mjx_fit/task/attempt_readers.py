"""Readers of an attempt in progress: a belief after every action, by a trained sensor or by geometry."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Float, Key

from mjx_fit.config.schema import Config
from mjx_fit.control.policies import PolicyInput, PolicyStart
from mjx_fit.filters import chart, frame
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.task import geometry
from mjx_fit.task.estimator import posterior
from mjx_fit.task.estimator_input import require_no_sensor
from mjx_fit.types import Array, Belief

Past = Any
"""What a reader keeps of the attempt so far."""
_THINKING = 2**22 - 1
"""Offset that separates the keys of particles from those of policies and of errors."""


class Reader(NamedTuple):
    """Reader of an attempt in progress.

    Attributes:
        begin: Maps the belief before the attempt, the initial information and the key of the attempt to what
            the reader keeps.
        add: Maps what it keeps, the belief before the attempt and the input after an action to what it keeps
            then, and the belief.
        places: Maps what it keeps to points (k, 2) that stand for where the hole may be, m; None: the belief
            tells.
    """

    begin: Callable[[Belief, PolicyStart, Key[Array, ""]], Past]
    add: Callable[[Past, Belief, PolicyInput], tuple[Past, Belief]]
    places: Callable[[Past], Float[Array, "k 2"]] | None = None


def reader_of(config: Config, sensor: ContactSensor | None) -> Reader | None:
    """Return the reader that a configuration asks for (``filter.reads``); None: there is no sensor.

    Raises:
        RequestError: The sensor cannot read an attempt in progress, or geometry is asked for beside it.
    """
    if config.filter.reads == "geometry":
        require_no_sensor(sensor)
        return by_geometry(config)
    return None if sensor is None else by_sensor(sensor, config)


def by_sensor(sensor: ContactSensor, config: Config) -> Reader:
    """Return the reader whose sensor reads the trace so far, and whose filter conditions the prior on it.

    Raises:
        RequestError: The sensor cannot read an attempt in progress.
    """
    rows, names = config.task.attempt_actions, config.filter.coordinates
    sensor.begin(rows)  # raises for a sensor that cannot
    graph, weights = nnx.split(sensor)

    def begin(prior: Belief, start: PolicyStart, key: Key[Array, ""]) -> Past:
        return nnx.merge(graph, weights).begin(rows)

    def add(past: Past, prior: Belief, seen: PolicyInput) -> tuple[Past, Belief]:
        assert seen.reading is not None
        # A copy of the sensor for each trace of JAX.
        past, observation = nnx.merge(graph, weights).add(past, seen.reading, seen.step - 1)
        # The sensor answers relative to the start, the filter asks relative to the mean.
        offset = chart.step_between(prior.mean_world, frame.padded(seen.start.estimate_world, names), names)
        observation = replace(observation, innovation=observation.innovation + offset)
        open_ = jnp.zeros((config.scene.n_types,) * 2)
        return past, posterior(prior, observation, seen.start.peg_type, open_, config)

    return Reader(begin, add)


def by_geometry(config: Config) -> Reader:
    """Return the reader that asks which places explain the contact so far (``mjx_fit.task.geometry``)."""
    names = config.filter.coordinates

    def begin(prior: Belief, start: PolicyStart, key: Key[Array, ""]) -> Past:
        estimate = frame.padded(start.estimate_world, names)
        own = jax.random.fold_in(key, _THINKING)
        return geometry.begin(prior, estimate, start.peg_type, own, config)

    def add(past: Past, prior: Belief, seen: PolicyInput) -> tuple[Past, Belief]:
        assert seen.reading is not None
        key = jax.random.fold_in(seen.attempt_key, _THINKING)
        past = geometry.add(past, seen.reading, seen.step - 1, seen.running, key, config)
        return past, geometry.belief_of(past, config)

    def places(past: Past) -> Float[Array, "k 2"]:
        return geometry.places_of(past, config)

    return Reader(begin, add, places if config.particles.remember else None)
