"""Train a contact sensor through the differentiable filters.

The random key of an epoch is ``fold_in(root, epoch)``: a resumed run gives the same learning curve as an
uninterrupted one.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.data.batches import n_batches, placed
from mjx_fit.data.episode import Episode
from mjx_fit.data.windows import Sample, chains, windows_of
from mjx_fit.sensors.contact_sensor import ContactSensor, InputScale
from mjx_fit.training import checkpoint, run_folder, start
from mjx_fit.training.compatibility import first_holes
from mjx_fit.training.epoch import run_epoch
from mjx_fit.training.journal import Journal
from mjx_fit.training.loss import Loss
from mjx_fit.training.run import Lineage, Run, held
from mjx_fit.training.saver import Saver
from mjx_fit.training.split import usable_sides
from mjx_fit.training.step import Recipe, TrainState, optimizer
from mjx_fit.types import Array
from mjx_fit.utils import numerics, provenance
from mjx_fit.utils.errors import RequestError, WorkError
from mjx_fit.utils.progress import COMPILING, Progress
from mjx_fit.utils.randomness import require_seed, root_key

SCALE_WINDOWS = 512
"""Maximum number of windows from which the input normalisation is estimated."""


@held
def train(
    data: Episode,
    config: Config,
    run: Run,
    *,
    on_epoch: Callable[[dict], None] | None = None,
    checkpoint_every_s: float = 30.0,
) -> bool:
    """Train a sensor, or resume its training; ``checkpoint.load_sensor(run.out)`` loads the best one.

    The members of an ensemble train together under vmap. They share one train/validation split; each has its
    own weights, windows and noise. Member 0 equals the sensor trained alone, except that early stopping waits
    for all members.

    Args:
        data: Episodes, stacked along one leading axis.
        config: Full configuration. With a constant learning rate, ``train.epochs`` and ``train.patience`` may
            exceed their values at the first start: the result equals a run with the larger values throughout.
        run: Output folder, seed, number of sensors and initial weights.
        on_epoch: Callback that receives the metrics of each epoch (first member) once they are stored.
        checkpoint_every_s: Minimum time between two checkpoints, s; the last epoch always gets one.

    Returns:
        False if the run was already complete.

    Raises:
        RequestError: The folder holds something else, or the data or the configuration cannot be used.
        WorkError: The loss is no longer finite.
    """
    numerics.require()
    require_seed(run.seed)
    split = usable_sides(data, config, run.seed)
    sides = _examples(data, config, split[0]), _examples(data, config, split[1])
    begun = _open(data, config, run, checkpoint_every_s)
    saver, folders = begun.saver, begun.folders
    if begun.epochs_done >= config.train.epochs or saver.is_stale(begun.epochs_done):
        return False
    for folder in folders:
        run_folder.require_same_arithmetic(folder)
    init_keys, epoch_roots, val_key = _keys(run)
    recipe, state = _begin(data, sides[0], config, init_keys, begun.starts)
    placed_data = _placed(data, run.members)
    for folder, lineage in zip(folders, begun.lineages, strict=True):
        run_folder.write(folder, config, lineage, first_holes(data), np.asarray(data.sequence), split)
    if begun.arrays is not None:
        state = checkpoint.from_arrays(state, begun.arrays)
    journal = Journal(folders, begun.epochs_done, tensorboard=run.tensorboard)
    progress = Progress(_title(config, split), config.train.epochs, begun.epochs_done, COMPILING)
    with journal, progress as show:
        for epoch in range(begun.epochs_done, config.train.epochs):
            began = time.monotonic()
            key = jax.vmap(partial(jax.random.fold_in, data=epoch))(epoch_roots)
            own_key = key if run.members > 1 else key[0]
            state, *losses = run_epoch(recipe, state, placed_data, sides, own_key, val_key)
            rows = _metrics(epoch, run.members, *losses, seconds=time.monotonic() - began)
            journal.append(rows)
            val_nll = np.array([row["val_nll"] for row in rows])
            is_last = saver.after_epoch(epoch + 1, state, val_nll, config.train.epochs)
            if on_epoch is not None:
                on_epoch(rows[0])
            show(epoch + 1, f"val_nll {val_nll.mean():.3f} (prior {rows[0]['prior_nll']:.3f})")
            if is_last:
                break
    return True


@dataclass(frozen=True)
class _Begun:
    """State of a run as stored in its folders.

    Attributes:
        folders: Folder of each member.
        starts: Initial sensor of each member; None: new weights.
        lineages: Origin of each member's sensor.
        saver: Writer of the checkpoints.
        epochs_done: Number of stored epochs.
        arrays: Training state after them; None: no checkpoint exists.
    """

    folders: list[Path]
    starts: list[start.Start | None]
    lineages: list[Lineage]
    saver: Saver
    epochs_done: int
    arrays: dict[str, Any] | None


def _open(data: Episode, config: Config, run: Run, checkpoint_every_s: float) -> _Begun:
    """Check that the folders are new or hold this run, and read its last checkpoint."""
    data_id = provenance.fingerprint(data)
    folders = run.folders()
    starts = start.read(run.init, config, run.members, run.inside)
    start.require_unseen(starts, data, data_id, config, run.seed)
    lineages = [Lineage(run.seed, data_id, origin) for origin in start.origins(starts)]
    for folder, lineage in zip(folders, lineages, strict=True):
        run_folder.check(folder, config, lineage)
    epochs_done, arrays = checkpoint.load_last(run.out / run.inside)
    saver = Saver(run.out / run.inside, folders, checkpoint_every_s, config.train.patience)
    if arrays is not None:
        saver.resume(epochs_done, arrays)
        if len(saver.best_nll) != run.members:
            raise RequestError(
                f"--members: {run.members} cannot be used: {run.out} was started with {len(saver.best_nll)}"
            )
    return _Begun(folders, starts, lineages, saver, epochs_done, arrays)


def _placed(data: Episode, members: int) -> Episode:
    """Place the data on the device, or on the host if they do not fit."""
    there = placed(data)
    if members > 1 and isinstance(there.episode, np.ndarray):
        raise RequestError(f"--members: {members} cannot be used: the data exceed device memory; train one")
    return there


def _examples(data: Episode, config: Config, episodes: Int[np.ndarray, "n"]) -> Int[np.ndarray, "m *length"]:
    """Return the units from which examples are sampled: single episodes, or chains of them."""
    return episodes if config.train.sequence == 1 else chains(data, episodes, config.train.sequence)


def _title(config: Config, episodes) -> str:
    kind = " the frame-by-frame baseline" if config.sensor.reference == "final" else ""
    n, m = map(len, episodes)
    return f"train{kind} on {n:,}, validate on {m:,}: epoch"


def _keys(run: Run) -> tuple[Key[Array, "members"], Key[Array, "members"], Key[Array, ""]]:
    """Derive the weight and epoch keys of each member, and the validation key shared by all members."""
    init, epochs, validation = jax.random.split(root_key(run.seed, "train"), 3)
    first = jnp.stack([init, epochs])
    own = jnp.stack(
        [
            jax.random.split(root_key(run.seed, f"train: member {member}")) if member else first
            for member in range(run.member, run.member + run.members)
        ]
    )
    return own[:, 0], own[:, 1], validation


def _begin(
    data: Episode,
    train_ids: Int[np.ndarray, "n *length"],
    config: Config,
    keys: Key[Array, "members"],
    starts: list[start.Start | None],
) -> tuple[Recipe, TrainState]:
    """Create the initial training state: new sensors with normalised inputs, or sensors trained before.

    The input normalisation of a new sensor is fitted to windows of the training episodes. The states of
    several members are stacked.
    """
    static = run_folder.identity(config)
    steps = n_batches(train_ids, config.train.batch_size)
    graphdefs, states = zip(*(_new(data, train_ids, static, steps, key) for key in keys), strict=True)
    states = tuple(map(start.begin, starts, states))
    together = states[0] if len(keys) == 1 else jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)
    return Recipe(graphdefs[0], static, steps), together


def _new(data, train_ids, config: Config, steps: int, key) -> tuple[nnx.GraphDef, TrainState]:
    weight_key, order_key, window_key = jax.random.split(key, 3)
    sensor = ContactSensor.of(config, nnx.Rngs(weight_key))
    sensor.fit_input_scale(_some_windows(data, train_ids, config, order_key, window_key).reading)
    graphdef, params, scale = nnx.split(sensor, nnx.Param, InputScale)
    return graphdef, TrainState(params, scale, optimizer(config, steps).init(params))


def _some_windows(data, train_ids, config, order_key, window_key) -> Sample:
    windows = train_ids[train_ids >= 0]
    ids = np.asarray(jax.random.permutation(order_key, windows)[:SCALE_WINDOWS])
    rows = jax.tree.map(lambda leaf: leaf[ids], data)
    return windows_of(rows, ids, window_key, config)


def _metrics(epoch: int, members: int, training: Loss, validation: Loss, *, seconds: float) -> list[dict]:
    """Return the lines of ``metrics.jsonl``: training terms by name, validation terms as ``val_...``."""
    rows = []
    for member in range(members):
        train_terms, val_terms = (
            {name: float(np.reshape(term, -1)[member]) for name, term in vars(loss).items()}
            for loss in (training, validation)
        )
        if not all(map(math.isfinite, [*train_terms.values(), *val_terms.values()])):
            who = f" of member {member}" if members > 1 else ""
            raise WorkError(f"training diverged: the loss{who} of epoch {epoch} is not finite")
        del train_terms["prior_nll"]
        prior_nll = val_terms.pop("prior_nll")
        row = {"epoch": epoch, **train_terms, **{f"val_{name}": term for name, term in val_terms.items()}}
        rows.append(row | {"prior_nll": prior_nll, "seconds": round(seconds, 3)})
    return rows
