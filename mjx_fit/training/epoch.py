"""Run one epoch: a window from every training episode, then one from every validation episode.

An epoch is a single dispatch if the data are on the device, and proceeds batch by batch if they are on the
host. Both variants use the same windows in the same order.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int, Key

from mjx_fit.data.batches import batches, in_order
from mjx_fit.data.episode import Episode
from mjx_fit.data.windows import sample_windows
from mjx_fit.training.loss import Loss
from mjx_fit.training.step import (
    Recipe,
    TrainState,
    train_step,
    train_step_jit,
    validation_step,
    validation_step_jit,
)
from mjx_fit.types import Array


def run_epoch(
    recipe: Recipe,
    state: TrainState,
    data: Episode,
    sides: tuple[Int[np.ndarray, "n *length"], Int[np.ndarray, "m *length"]],
    key: Key[Array, "*members"],
    val_key: Key[Array, ""],
) -> tuple[TrainState, Loss, Loss]:
    """Train for one epoch and validate: one sensor, or the members of an ensemble with one key each.

    Args:
        recipe: Static settings of the step.
        state: State before the epoch, stacked over the members of an ensemble; its buffers are donated.
        data: All episodes, on the device (JAX arrays) or on the host (NumPy arrays).
        sides: Train/validation split: indices of episodes, or chains of them.
        key: Seed of the order, windows, noise and dropout of the epoch.
        val_key: Seed for validation, identical in all epochs to make them comparable.

    Returns:
        The new state, the mean training loss (accumulated while the state changes) and the mean validation
        loss.
    """
    if isinstance(data.episode, np.ndarray):
        run = _from_host
    else:
        run = _members_on_device if key.ndim else _on_device
    state, training, validation = run(recipe, state, data, sides, key, val_key)
    return state, _mean(training, sides[0]), _mean(validation, sides[1])


def _epoch(recipe, state, data, sides, key, val_key):
    pass_key, dropout_key = jax.random.split(key)
    config = recipe.config

    def train_batch(state, batch):
        ids, weight, step = batch
        sample = sample_windows(data, ids, window_key, config)
        return train_step(recipe, state, sample, weight, jax.random.fold_in(dropout_key, step))

    def validate_batch(state, batch):
        ids, weight = batch
        sample = sample_windows(data, ids, val_window_key, config)
        return state, validation_step(recipe, state, sample, weight)

    ids, weight, window_key = in_order(sides[0], pass_key, config.train.batch_size)
    state, training = jax.lax.scan(train_batch, state, (ids, weight, jnp.arange(len(ids))))
    *val_batches, val_window_key = in_order(sides[1], val_key, config.train.batch_size)
    _, validation = jax.lax.scan(validate_batch, state, tuple(val_batches))
    return state, training, validation


_on_device = partial(jax.jit, static_argnums=0, donate_argnums=1)(_epoch)


@partial(jax.jit, static_argnums=0, donate_argnums=1)
def _members_on_device(recipe, states, data, sides, keys, val_key):
    def member(state, key):
        return _epoch(recipe, state, data, sides, key, val_key)

    return jax.vmap(member)(states, keys)


def _from_host(recipe, state, data, sides, key, val_key):
    pass_key, dropout_key = jax.random.split(key)
    training, validation = [], []
    for step, (sample, weight) in enumerate(batches(data, sides[0], pass_key, recipe.config)):
        dropout = jax.random.fold_in(dropout_key, step)
        state, sums = train_step_jit(recipe, state, sample, weight, dropout)
        training.append(sums)
    for sample, weight in batches(data, sides[1], val_key, recipe.config):
        validation.append(validation_step_jit(recipe, state, sample, weight))
    return state, _stacked(training), _stacked(validation)


def _mean(sums: Loss, episodes: Int[np.ndarray, "n *length"]) -> Loss:
    n = int((episodes >= 0).sum())
    return jax.tree.map(lambda term: np.sum(term, axis=-1) / n, sums)


def _stacked(losses: list[Loss]) -> Loss:
    return jax.tree.map(lambda *terms: np.stack(terms), *losses)
