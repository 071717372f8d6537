"""Where sensors and filters meet: a failed attempt becomes a better belief (lines 9 to 11 of Algorithm 1)."""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Bool, Int, Key

from mjx_fit import numerics
from mjx_fit.config import Config
from mjx_fit.filters.belief import update_position, update_type
from mjx_fit.filters.success import success_probability
from mjx_fit.sensors.model import ContactSensor
from mjx_fit.task.entrance import require_update
from mjx_fit.traces import require_readable
from mjx_fit.types import Array, Belief, Interaction, Reading
from mjx_fit.wrist import read

Update = Callable[[Belief, Interaction, Key[Array, "n"]], Belief]
"""Beliefs about n holes before and after an attempt at each; keys are of the sensors' noise."""


def filter_update(
    config: Config,
    sensor: ContactSensor | None,
    learns_position: Bool[np.ndarray, "n"] | bool = True,
    learns_type: Bool[np.ndarray, "n"] | bool = True,
) -> Update:
    """Makes the update of position and type, from the failure itself and from what the sensor says of it.

    Beliefs whose attempt succeeded, or is not valid, stay as they are.

    Args:
        config: Gives α, the wrist's noise and the plate's height.
        sensor: The trained sensor; None: no row reads its trace.
        learns_position: Whether the trace updates the position, of all rows or of each.
        learns_type: Whether the trace updates the type; the failure does so all the same.

    The update raises ``RequestError`` where a field of a belief or an interaction is not what it must be.
    """
    numerics.require()
    hard = config.task.hard_match
    graph, state = nnx.split(sensor) if sensor is not None else (None, None)

    def learn(state, beliefs, interactions, keys, learns_position, learns_type):
        failed = interactions.valid & ~interactions.inserted
        alpha = success_probability(config, beliefs.pos_cov)
        updated = update_type(beliefs, None, interactions.peg_type, alpha, hard=hard)
        if graph is not None:
            observation = nnx.merge(graph, state)(readings(interactions, keys, config))
            moved = update_position(beliefs, observation)
            felt = update_type(beliefs, observation, interactions.peg_type, alpha, hard=hard)
            updated = Belief(
                pos_mean_world=_where(learns_position, moved.pos_mean_world, beliefs.pos_mean_world),
                pos_cov=_where(learns_position, moved.pos_cov, beliefs.pos_cov),
                type_logp=_where(learns_type, felt.type_logp, updated.type_logp),
            )
        return jax.tree.map(lambda new, old: _where(failed, new, old), updated, beliefs)

    compiled = jax.jit(learn)

    def update(beliefs: Belief, interactions: Interaction, keys: Key[Array, "n"]) -> Belief:
        require_update(beliefs, interactions, keys)
        n = len(interactions.length)
        # Traced, not constants: rows of any traits are computed alike.
        position, kind = (np.broadcast_to(one, n).copy() for one in (learns_position, learns_type))
        return compiled(state, beliefs, interactions, keys, position, kind)

    return update


def frame_update(config: Config, sensor: ContactSensor) -> Update:
    """Makes the update of the frame-by-frame baseline: what its sensor says of the last attempt, and R.

    It checks what it is given, as ``filter_update`` does.
    """
    numerics.require()
    graph, state = nnx.split(sensor)

    @jax.jit
    def update(state, beliefs: Belief, interactions: Interaction, keys: Key[Array, "n"]) -> Belief:
        seen = nnx.merge(graph, state)(readings(interactions, keys, config))
        failed = interactions.valid & ~interactions.inserted
        mean = interactions.estimate_world + seen.innovation
        return replace(
            beliefs,
            pos_mean_world=_where(failed, mean, beliefs.pos_mean_world),
            pos_cov=_where(failed, seen.pos_noise_cov, beliefs.pos_cov),
        )

    def checked(beliefs: Belief, interactions: Interaction, keys: Key[Array, "n"]) -> Belief:
        require_update(beliefs, interactions, keys)
        return update(state, beliefs, interactions, keys)

    return checked


def readings(
    interactions: Interaction, keys: Key[Array, "n"], config: Config, count: Int[Array, ""] | None = None
) -> Reading:
    """What the sensors are shown of attempts (n,): tared, with the wrist's noise from these keys.

    Args:
        interactions: The attempts.
        keys: Sources of the noise.
        config: Gives the noise of the wrist and the scene.
        count: Actions to read; the others are padding, so that it compiles once. None: all.

    Raises:
        RequestError: An interaction cannot be read (``mjx_fit.traces``).
    """
    require_readable(interactions)
    rows = interactions.trace.contact.shape[1]

    def one(interaction: Interaction, key: Key[Array, ""]) -> Reading:
        return read(interaction, key, config.wrist, config.scene, rows=rows, count=count)

    return jax.vmap(one)(interactions, keys)


def _where(condition: Bool[Array, "n"], new: Array, old: Array) -> Array:
    return jnp.where(condition.reshape(-1, *[1] * (new.ndim - 1)), new, old)
