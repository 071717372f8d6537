"""One training step as a pure function: loss of a batch of windows, gradient and optimiser update."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import optax
from flax import nnx
from jaxtyping import Float, Key, PyTree

from mjx_fit.config.schema import Config
from mjx_fit.data.windows import Sample
from mjx_fit.training.loss import (
    Loss,
    every_action_loss,
    filter_loss,
    frame_by_frame_loss,
    sequence_loss,
    weighted_sum,
)
from mjx_fit.types import Array, Observation, pytree


class Recipe(NamedTuple):
    """Static settings of a training step; hashable, as a static argument of jit must be.

    Attributes:
        graphdef: Structure of the sensor, without its arrays.
        config: Configuration, with its sections ``sensor`` and ``train`` in use.
        steps_per_epoch: Number of steps per epoch, for the learning-rate schedule.
    """

    graphdef: nnx.GraphDef
    config: Config
    steps_per_epoch: int


@pytree
class TrainState:
    """Trainable state (parameters, optimiser) and the fixed input normalisation."""

    params: PyTree[Float[Array, "..."]]
    scale: PyTree[Float[Array, "..."]]
    opt_state: optax.OptState


def optimizer(config: Config, steps_per_epoch: int) -> optax.GradientTransformation:
    """Return the AdamW optimiser; it equals Adam if the weight decay is zero."""
    train = config.train
    rate = train.learning_rate
    if train.schedule == "cosine":
        rate = optax.cosine_decay_schedule(rate, train.epochs * steps_per_epoch)
    return optax.adamw(rate, b2=train.adam_b2, weight_decay=train.weight_decay)


def train_step(
    recipe: Recipe,
    state: TrainState,
    sample: Sample,
    weight: Float[Array, "n *length"],
    dropout: Key[Array, ""],
) -> tuple[TrainState, Loss]:
    """Take one optimiser step on the mean loss over the windows with weight 1.

    Args:
        recipe: Static settings of the step.
        state: State before the step.
        sample: Batch of n windows, or n chains of windows.
        weight: Weight of each window: 1 to include it, 0 to ignore it.
        dropout: Seed of the dropout.

    Returns:
        The new state, and the summed loss terms before the step.
    """
    key = dropout if recipe.config.sensor.dropout else None

    def mean_loss(params):
        sums = _losses(recipe, params, state.scale, sample, weight, key)
        return sums.total / weight.sum(), sums

    grads, sums = jax.grad(mean_loss, has_aux=True)(state.params)
    optimizer_ = optimizer(recipe.config, recipe.steps_per_epoch)
    updates, opt_state = optimizer_.update(grads, state.opt_state, state.params)
    return TrainState(optax.apply_updates(state.params, updates), state.scale, opt_state), sums


def validation_step(
    recipe: Recipe, state: TrainState, sample: Sample, weight: Float[Array, "n *length"]
) -> Loss:
    """Sum the loss terms over the windows with weight 1, without dropout."""
    return _losses(recipe, state.params, state.scale, sample, weight, None)


train_step_jit = partial(jax.jit, static_argnums=0, donate_argnums=1)(train_step)
validation_step_jit = partial(jax.jit, static_argnums=0)(validation_step)


def _losses(recipe, params, scale, sample, weight, dropout) -> Loss:
    sensor = nnx.merge(recipe.graphdef, params, scale)
    rngs = None if dropout is None else nnx.Rngs(dropout=dropout)
    seen = sensor(sample.reading, rngs, every_row=every_action(recipe.config))
    return weighted_sum(_loss_of(recipe.config)(seen, sample), weight)


def every_action(config: Config) -> bool:
    """Return whether the loss is taken after every action; the baseline reads whole windows."""
    return config.train.every_action and config.sensor.reference == "estimate"


def _loss_of(config: Config) -> Callable[[Observation, Sample], Loss]:
    coordinates = config.filter.coordinates
    if config.sensor.reference == "final":
        return partial(frame_by_frame_loss, coordinates=coordinates)
    if every_action(config):
        return partial(every_action_loss, coordinates=coordinates)
    if config.train.sequence > 1:
        return partial(sequence_loss, config=config)
    return partial(filter_loss, coordinates=coordinates)
