"""Checkpoints of a training run, with Orbax: ``best`` (a sensor) and ``last`` (all that resuming needs).

Trees are stored as flat dictionaries from the path of a leaf to a NumPy array, so that a checkpoint written
on an accelerator can be read on a CPU. Orbax writes under a temporary name and renames: a kill leaves the
checkpoint before.
"""

from pathlib import Path

import jax
import numpy as np
import orbax.checkpoint as ocp
from flax import nnx

from mjx_fit import config as config_
from mjx_fit import numerics, provenance
from mjx_fit.config import Config
from mjx_fit.errors import RequestError
from mjx_fit.sensors.model import ContactSensor
from mjx_fit.settings import N_TYPES

BEST, LAST = Path("checkpoints", "best"), Path("checkpoints", "last")

Arrays = dict[str, np.ndarray]


def to_arrays(tree) -> Arrays:
    """The leaves of a pytree by their paths, as NumPy arrays on the host."""
    return {name: np.asarray(leaf) for name, leaf in _named(tree).items()}


def from_arrays(template, arrays: Arrays):
    """The inverse of ``to_arrays``: a tree like the template, with the arrays as leaves.

    Raises:
        RequestError: The arrays do not fit the template.
    """
    expected = {name: leaf.shape for name, leaf in _named(template).items()}
    found = {name: leaf.shape for name, leaf in arrays.items()}
    if expected != found:
        name = sorted(expected.items() ^ found.items())[0][0]
        raise RequestError(
            f"checkpoint: {name}: shape {found.get(name)} does not fit the configuration: "
            f"it must be {expected.get(name)}"
        )
    return jax.tree.unflatten(
        jax.tree.structure(template), [jax.numpy.asarray(arrays[name]) for name in expected]
    )


def save(folder: Path, epochs_done: int, arrays: Arrays) -> None:
    """Store a checkpoint, then delete the one before it."""
    with _manager(folder, max_to_keep=1) as manager:
        manager.save(epochs_done, args=ocp.args.StandardSave(arrays))


def load(folder: Path) -> tuple[int, Arrays] | None:
    """The number of epochs done and the arrays of the newest checkpoint, or None where there is none.

    Raises:
        RequestError: The checkpoint cannot be read.
    """
    if not folder.is_dir():
        return None
    with _manager(folder, create=False) as manager:
        step = manager.latest_step()
        if step is None:
            return None
        try:
            return step, manager.restore(step, args=ocp.args.StandardRestore())
        except Exception as error:  # Orbax and what it stands on raise whatever they like
            what = " ".join(str(error).split())[:120]
            raise RequestError(f"checkpoint: {folder / str(step)} cannot be read: {what}") from None


def load_last(out: Path) -> tuple[int, Arrays | None]:
    """The number of epochs done and the arrays of a run's last checkpoint; 0 and None where there is none."""
    return load(out / LAST) or (0, None)


def load_sensor(run: Path) -> tuple[ContactSensor, Config]:
    """The best sensor of a training run, and the configuration that it was trained with.

    Raises:
        RequestError: The folder is missing, holds no run or no checkpoint, or one of another network.
    """
    numerics.require()
    run = Path(run)
    if not run.is_dir():
        raise RequestError(f"--run: {run} is not allowed: there is no such folder")
    if not (run / "config.yaml").is_file():
        raise RequestError(f"--run: {run} is not allowed: it holds no config.yaml, so it is no training run")
    checkpoint = load(run / BEST)
    if checkpoint is None:
        raise RequestError(f"--run: {run} is not allowed: it holds no checkpoint ({BEST}); train it first")
    config = config_.load(run / "config.yaml")
    abstract = nnx.eval_shape(lambda: ContactSensor(config.sensor, nnx.Rngs(0), N_TYPES))
    graphdef, template = nnx.split(abstract)
    return nnx.merge(graphdef, from_arrays(template, checkpoint[1])), config


def fingerprint_of(sensor: ContactSensor) -> str:
    """What tells a trained sensor from all others."""
    return provenance.fingerprint(to_arrays(nnx.state(sensor)))


def _named(tree) -> dict:
    """The leaves, abstract or not, by their paths."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}


def _manager(folder: Path, **options) -> ocp.CheckpointManager:
    # Orbax asks for absolute paths; synchronous, since a checkpoint takes 0.1 s and order matters.
    return ocp.CheckpointManager(
        folder.absolute(),
        options=ocp.CheckpointManagerOptions(enable_async_checkpointing=False, **options),
    )
