"""Training of the contact sensor through the differentiable filters.

An epoch is one dispatch: a scan over batches of fresh windows, then over the validation windows, with the
data on the device throughout. Its randomness is ``fold_in(root, epoch)``: a run that was killed and continued
gives the same curve as one that was not.
"""

import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import nnx
from jaxtyping import Float, Int, Key, PyTree

from mjx_fit import provenance
from mjx_fit.config import Config
from mjx_fit.dataset.episode import Episode
from mjx_fit.dataset.reader import equal_batches
from mjx_fit.dataset.windows import sample_windows, split, usable
from mjx_fit.errors import RequestError, WorkError
from mjx_fit.progress import Progress
from mjx_fit.randomness import require_seed, root_key
from mjx_fit.sensors.model import ContactSensor, InputScale
from mjx_fit.shapes import SHAPES
from mjx_fit.training import checkpoint, run_folder
from mjx_fit.training.loss import Loss, filter_loss, weighted_sum
from mjx_fit.types import Array, pytree

SCALE_WINDOWS = 512
"""Windows from which the scaling of the inputs is estimated, at most."""


@pytree
class TrainState:
    """What a step of training changes, and the input scaling, which it does not."""

    params: PyTree[Float[Array, "..."]]
    scale: PyTree[Float[Array, "..."]]
    opt_state: optax.OptState


def train(
    data: Episode,
    config: Config,
    out: Path,
    seed: int,
    *,
    on_epoch: Callable[[dict], None] | None = None,
    checkpoint_every_s: float = 30.0,
) -> None:
    """Train a sensor, or continue its training; ``checkpoint.load_sensor(out)`` loads the best one.

    Args:
        data: Episodes, stacked along one leading axis.
        config: Everything; without ``train.epochs`` it must be the one that the folder was begun with.
        out: Folder of the run.
        seed: Root of weights, split, windows, noise.
        on_epoch: Called with the metrics of each epoch once they are stored.
        checkpoint_every_s: Least time between two checkpoints, s; the last epoch always gets one.

    Raises:
        RequestError: The folder holds something else, or data or configuration cannot be trained with.
        WorkError: The loss is no longer finite.
    """
    out = Path(out)
    require_seed(seed)
    train_ids, val_ids = _usable_split(data, config, seed)
    data_id = provenance.fingerprint(data)
    run_folder.check(out, config, seed, data_id)
    epochs_done, arrays = checkpoint.load(out / checkpoint.LAST) or (0, None)
    if epochs_done >= config.train.epochs:
        return
    data = jax.tree.map(jnp.asarray, data)
    init_key, epoch_root, val_key = jax.random.split(root_key(seed, "train"), 3)
    graphdef, state = _initial_state(data, train_ids, config, init_key)
    run_folder.write(out, config, seed, data_id)
    run_folder.keep_metrics(out, epochs_done)
    saver = _Saver(out, checkpoint_every_s)
    if arrays is not None:
        saver.best_nll = float(arrays.pop("best_nll"))
        state = checkpoint.from_arrays(state, arrays)
    static = run_folder.without_epochs(config)
    run_epoch = partial(
        _run_epoch, graphdef, static, data=data, train_ids=train_ids, val_ids=val_ids, val_key=val_key
    )
    epochs = range(epochs_done, config.train.epochs)
    with Progress("train: epoch", config.train.epochs, epochs_done) as show:
        for epoch in epochs:
            began = time.monotonic()
            state, *losses = run_epoch(state, key=jax.random.fold_in(epoch_root, epoch))
            row = _metrics(epoch, *losses) | {"seconds": round(time.monotonic() - began, 3)}
            run_folder.append_metrics(out, row)
            saver.after_epoch(epoch + 1, state, row["val_nll"], final=epoch == epochs[-1])
            if on_epoch is not None:
                on_epoch(row)
            show(epoch + 1, f"val_nll {row['val_nll']:.3f} (prior {row['prior_nll']:.3f})")


class _Saver:
    """Writes ``best`` and ``last`` now and then.

    ``best`` goes first: should a kill fall between the two, the epochs after ``last`` are run again and come
    to the same best.
    """

    def __init__(self, out: Path, every_s: float):
        self.out, self.best_nll, self.every_s = out, math.inf, every_s
        self.best: tuple[int, checkpoint.Arrays] | None = None
        self.saved_at = -math.inf  # the first epoch, which compiles, is worth keeping

    def after_epoch(self, epochs_done: int, state: TrainState, val_nll: float, *, final: bool) -> None:
        if val_nll < self.best_nll:
            self.best_nll = val_nll
            self.best = epochs_done, checkpoint.to_arrays(nnx.merge_state(state.params, state.scale))
        if not final and time.monotonic() - self.saved_at < self.every_s:
            return
        if self.best is not None:
            checkpoint.save(self.out / checkpoint.BEST, *self.best)
            self.best = None
        arrays = checkpoint.to_arrays(state) | {"best_nll": np.asarray(self.best_nll)}
        checkpoint.save(self.out / checkpoint.LAST, epochs_done, arrays)
        self.saved_at = time.monotonic()


def _usable_split(data: Episode, config: Config, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Training and validation episodes: divided first, so that a dropped one does not move the others."""
    if config.train.min_window > config.train.max_window:
        raise RequestError(
            f"config: train.min_window: {config.train.min_window} is not allowed: "
            f"it must be at most train.max_window, {config.train.max_window}"
        )
    keep = usable(data)
    sides = split(np.asarray(data.sequence), config.train.validation_fraction, seed)
    train_ids, val_ids = (ids[keep[ids]] for ids in sides)
    if not len(train_ids) or not len(val_ids):
        raise RequestError(
            f"--data: {len(train_ids)} training and {len(val_ids)} validation interactions are not allowed: "
            "at least one of each must be valid and long enough"
        )
    return train_ids, val_ids


def _initial_state(
    data: Episode, train_ids: Int[np.ndarray, "n"], config: Config, key: Key[Array, ""]
) -> tuple[nnx.GraphDef, TrainState]:
    """A sensor with new weights, its inputs scaled to windows of the training episodes."""
    weight_key, order_key, window_key = jax.random.split(key, 3)
    sensor = ContactSensor(config.sensor, nnx.Rngs(weight_key), len(SHAPES))
    episodes = jax.random.permutation(order_key, train_ids)[:SCALE_WINDOWS]
    windows = sample_windows(data, episodes, window_key, run_folder.without_epochs(config))
    sensor.fit_input_scale(windows.reading)
    graphdef, params, scale = nnx.split(sensor, nnx.Param, InputScale)
    return graphdef, TrainState(params, scale, _optimizer(config).init(params))


def _optimizer(config: Config) -> optax.GradientTransformation:
    return optax.adam(config.train.learning_rate, b2=config.train.adam_b2)


@partial(jax.jit, static_argnums=(0, 1), donate_argnums=2)
def _run_epoch(
    graphdef: nnx.GraphDef,
    config: Config,
    state: TrainState,
    *,
    data: Episode,
    train_ids: Int[Array, "n"],
    val_ids: Int[Array, "m"],
    val_key: Key[Array, ""],
    key: Key[Array, ""],
) -> tuple[TrainState, Loss, Loss]:
    """One window from every training episode, then one from every validation episode, the same in each epoch.

    Returns:
        The new state, and the mean losses over the training (while it changed) and the validation windows.
    """
    order_key, window_key, dropout_key = jax.random.split(key, 3)

    def loss(params, episodes, weight, windows, dropout):
        sample = sample_windows(data, episodes, windows, config)
        sensor = nnx.merge(graphdef, params, state.scale)
        rngs = None if dropout is None else nnx.Rngs(dropout=dropout)
        sums = weighted_sum(filter_loss(sensor(sample.reading, rngs), sample), weight)
        return sums.total / weight.sum(), sums

    def train_step(carry, batch):
        params, opt_state = carry
        episodes, weight, step = batch
        dropout = jax.random.fold_in(dropout_key, step) if config.sensor.dropout else None
        grads, sums = jax.grad(loss, has_aux=True)(params, episodes, weight, window_key, dropout)
        updates, opt_state = _optimizer(config).update(grads, opt_state, params)
        return (optax.apply_updates(params, updates), opt_state), sums

    def val_step(params, batch):
        episodes, weight = batch
        return params, loss(params, episodes, weight, val_key, None)[1]

    ids, weight = equal_batches(jax.random.permutation(order_key, train_ids), config.train.batch_size)
    batches = ids, weight, jnp.arange(len(ids))
    (params, opt_state), training = jax.lax.scan(train_step, (state.params, state.opt_state), batches)
    _, validation = jax.lax.scan(val_step, params, equal_batches(val_ids, config.train.batch_size))
    return (
        TrainState(params, state.scale, opt_state),
        jax.tree.map(lambda sums: sums.sum() / len(train_ids), training),
        jax.tree.map(lambda sums: sums.sum() / len(val_ids), validation),
    )


def _metrics(epoch: int, training: Loss, validation: Loss) -> dict:
    """One line of ``metrics.jsonl``: training terms by their names, validation terms as ``val_...``."""
    train_terms, val_terms = ({k: float(v) for k, v in vars(loss).items()} for loss in (training, validation))
    if not all(map(math.isfinite, [*train_terms.values(), *val_terms.values()])):
        raise WorkError(f"training diverged: the loss of epoch {epoch} is not finite")
    del train_terms["prior_nll"]
    prior_nll = val_terms.pop("prior_nll")
    row = {"epoch": epoch, **train_terms, **{f"val_{name}": value for name, value in val_terms.items()}}
    return row | {"prior_nll": prior_nll}
