"""Training of a contact sensor through the differentiable filters.

The randomness of an epoch is ``fold_in(root, epoch)``: a run that was killed and continued gives the same
curve as one that was not.
"""

import math
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from flax import nnx
from jaxtyping import Int, Key

from mjx_fit import provenance
from mjx_fit.config import Config
from mjx_fit.dataset.episode import Episode
from mjx_fit.dataset.reader import n_batches, placed
from mjx_fit.dataset.windows import Sample, chains, windows_of
from mjx_fit.errors import WorkError
from mjx_fit.progress import Progress
from mjx_fit.randomness import require_seed, root_key
from mjx_fit.sensors.model import ContactSensor, InputScale
from mjx_fit.shapes import SHAPES
from mjx_fit.training import checkpoint, run_folder
from mjx_fit.training.epoch import run_epoch
from mjx_fit.training.loss import Loss
from mjx_fit.training.sides import usable_sides
from mjx_fit.training.step import Recipe, TrainState, optimizer
from mjx_fit.types import Array

SCALE_WINDOWS = 512
"""Windows from which the scaling of the inputs is estimated, at most."""


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
        config: Everything; with a constant learning rate, ``train.epochs`` may be more than when the folder
            was begun.
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
    episodes = usable_sides(data, config, seed)
    sides = _examples(data, config, episodes[0]), _examples(data, config, episodes[1])
    data_id = provenance.fingerprint(data)
    run_folder.check(out, config, seed, data_id)
    epochs_done, arrays = checkpoint.load_last(out)
    saver = _Saver(out, checkpoint_every_s, config.train.patience)
    if arrays is not None:
        saver.resume(epochs_done, arrays)
    if epochs_done >= config.train.epochs or saver.is_stale(epochs_done):
        return
    init_key, epoch_root, val_key = jax.random.split(root_key(seed, "train"), 3)
    recipe, state = _begin(data, sides[0], config, init_key)
    run_folder.write(out, config, seed, data_id, np.asarray(data.sequence), episodes)
    run_folder.keep_metrics(out, epochs_done)
    if arrays is not None:
        state = checkpoint.from_arrays(state, arrays)
    data = placed(data)
    with Progress(_title(config, episodes), config.train.epochs, epochs_done) as show:
        for epoch in range(epochs_done, config.train.epochs):
            began = time.monotonic()
            state, *losses = run_epoch(
                recipe, state, data, sides, jax.random.fold_in(epoch_root, epoch), val_key
            )
            row = _metrics(epoch, *losses) | {"seconds": round(time.monotonic() - began, 3)}
            run_folder.append_metrics(out, row)
            is_last = saver.after_epoch(epoch + 1, state, row["val_nll"], config.train.epochs)
            if on_epoch is not None:
                on_epoch(row)
            show(epoch + 1, f"val_nll {row['val_nll']:.3f} (prior {row['prior_nll']:.3f})")
            if is_last:
                return


class _Saver:
    """Writes ``best`` and ``last`` now and then, and says when to stop early.

    ``best`` goes first: should a kill fall between the two, the epochs after ``last`` are run again and come
    to the same best.
    """

    def __init__(self, out: Path, every_s: float, patience: int):
        self.out, self.every_s, self.patience = out, every_s, patience
        self.best_nll, self.best_epoch = math.inf, 0
        self.best: checkpoint.Arrays | None = None
        self.saved_at = -math.inf  # the first epoch, which compiles, is worth keeping

    def resume(self, epochs_done: int, arrays: checkpoint.Arrays) -> None:
        """Take what was remembered out of the arrays of a checkpoint."""
        self.best_nll = float(arrays.pop("best_nll"))
        self.best_epoch = int(arrays.pop("best_epoch", epochs_done))

    def is_stale(self, epochs_done: int) -> bool:
        """Whether validation has not become better for so long that training is over."""
        return bool(self.patience) and epochs_done - self.best_epoch >= self.patience

    def after_epoch(self, epochs_done: int, state: TrainState, val_nll: float, epochs: int) -> bool:
        """Keep what is worth keeping; whether this epoch was the last one."""
        if val_nll < self.best_nll:
            self.best_nll, self.best_epoch = val_nll, epochs_done
            self.best = checkpoint.to_arrays(nnx.merge_state(state.params, state.scale))
        final = epochs_done == epochs or self.is_stale(epochs_done)
        if not final and time.monotonic() - self.saved_at < self.every_s:
            return False
        if self.best is not None:
            checkpoint.save(self.out / checkpoint.BEST, self.best_epoch, self.best)
            self.best = None
        remembered = {"best_nll": np.asarray(self.best_nll), "best_epoch": np.asarray(self.best_epoch)}
        checkpoint.save(self.out / checkpoint.LAST, epochs_done, checkpoint.to_arrays(state) | remembered)
        self.saved_at = time.monotonic()
        return final


def _examples(data: Episode, config: Config, episodes: Int[np.ndarray, "n"]) -> Int[np.ndarray, "m *length"]:
    """Episodes as what examples are drawn from: one by one, or in chains."""
    return episodes if config.train.sequence == 1 else chains(data, episodes, config.train.sequence)


def _title(config: Config, episodes) -> str:
    kind = " frame by frame" if config.sensor.reference == "final" else ""
    n, m = map(len, episodes)
    return f"train{kind} on {n:,}, validate on {m:,}: epoch"


def _begin(
    data: Episode, train_ids: Int[np.ndarray, "n *length"], config: Config, key: Key[Array, ""]
) -> tuple[Recipe, TrainState]:
    """A sensor with new weights, its inputs scaled to windows of the training episodes."""
    weight_key, order_key, window_key = jax.random.split(key, 3)
    sensor = ContactSensor(config.sensor, nnx.Rngs(weight_key), len(SHAPES))
    static = run_folder.identity(config)
    sensor.fit_input_scale(_some_windows(data, train_ids, static, order_key, window_key).reading)
    graphdef, params, scale = nnx.split(sensor, nnx.Param, InputScale)
    steps = n_batches(train_ids, config.train.batch_size)
    state = TrainState(params, scale, optimizer(static, steps).init(params))
    return Recipe(graphdef, static, steps), state


def _some_windows(data, train_ids, config, order_key, window_key) -> Sample:
    windows = train_ids[train_ids >= 0]
    ids = np.asarray(jax.random.permutation(order_key, windows)[:SCALE_WINDOWS])
    rows = jax.tree.map(lambda leaf: leaf[ids], data)
    return windows_of(rows, ids, window_key, config)


def _metrics(epoch: int, training: Loss, validation: Loss) -> dict:
    """One line of ``metrics.jsonl``: training terms by their names, validation terms as ``val_...``."""
    train_terms, val_terms = ({k: float(v) for k, v in vars(loss).items()} for loss in (training, validation))
    if not all(map(math.isfinite, [*train_terms.values(), *val_terms.values()])):
        raise WorkError(f"training diverged: the loss of epoch {epoch} is not finite")
    del train_terms["prior_nll"]
    prior_nll = val_terms.pop("prior_nll")
    row = {"epoch": epoch, **train_terms, **{f"val_{name}": value for name, value in val_terms.items()}}
    return row | {"prior_nll": prior_nll}
