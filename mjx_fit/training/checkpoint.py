"""Checkpoints of a training run: ``best`` (a sensor) and ``last`` (all that resuming needs).

Trees are stored as flat dictionaries from the path of a leaf to a NumPy array, so that a checkpoint written
on an accelerator can be read on a CPU. Each is written under a temporary name and renamed, so that a kill
leaves the checkpoint before; and each carries the digests of its files, so that damage is noticed before it
is read.
"""

import sys
from functools import cache
from pathlib import Path

import jax
import numpy as np
from flax import nnx

from mjx_fit.config.files import read_stored_config
from mjx_fit.config.schema import Config
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.training import step_folder, stored_arrays
from mjx_fit.training.stored_arrays import Arrays
from mjx_fit.utils import numerics, provenance
from mjx_fit.utils.errors import RequestError

BEST, LAST = Path("checkpoints", "best"), Path("checkpoints", "last")
FRAME_BY_FRAME = "frame_by_frame"
"""Folder of the baseline's training, in that of the run."""
ARRAYS = "default"
"""Where in a step its arrays are."""
_MAY_BE_INFINITE = "best_nll"
"""As long as no epoch has been any good."""


def to_arrays(tree) -> Arrays:
    """The leaves of a pytree by their paths, as NumPy arrays on the host."""
    return {name: np.asarray(leaf) for name, leaf in _named(tree).items()}


def from_arrays(template, arrays: Arrays):
    """The inverse of ``to_arrays``: a tree like the template, with the arrays as leaves.

    Raises:
        RequestError: The arrays do not fit the template.
    """
    wanted = _named(template)
    for word, form in (("shape", lambda leaf: leaf.shape), ("type", lambda leaf: str(leaf.dtype))):
        expected = {name: form(leaf) for name, leaf in wanted.items()}
        found = {name: form(leaf) for name, leaf in arrays.items()}
        if expected != found:
            name = sorted({*expected.items()} ^ {*found.items()})[0][0]
            raise RequestError(
                f"checkpoint: {name[:80]}: {word} {found.get(name)} does not fit the configuration: "
                f"it must be {expected.get(name)}"
            )
    return jax.tree.unflatten(
        jax.tree.structure(template), [jax.numpy.asarray(arrays[name]) for name in wanted]
    )


def save(folder: Path, epochs_done: int, arrays: Arrays) -> None:
    """Store a checkpoint, then delete the one before it."""
    step_folder.write(folder, epochs_done, lambda place: stored_arrays.write(place / ARRAYS, arrays))


def load(folder: Path) -> tuple[int, Arrays] | None:
    """The number of epochs done and the arrays of the newest checkpoint, or None where there is none.

    One that was written before checkpoints had digests is read all the same, and stderr says so.

    Raises:
        RequestError: The checkpoint is damaged or cannot be read.
    """
    step = folder
    try:
        step = step_folder.newest(folder)
        if step is None:
            return None
        has_digests = step_folder.require_whole(step)
        arrays = stored_arrays.read(step / ARRAYS)
    except (OSError, ValueError) as error:
        raise RequestError(f"checkpoint: {step} cannot be read: {error}") from None
    if not has_digests:
        _require_finite(step, {name: leaf for name, leaf in arrays.items() if name != _MAY_BE_INFINITE})
        _warn(step)
    return int(step.name), arrays


@cache
def _warn(step: Path) -> None:
    """Once for each."""
    print(
        f"mjx-fit: {step} has no {step_folder.DIGESTS}: it was made by an earlier version, and damage to it "
        "may not be noticed",
        file=sys.stderr,
    )


def _require_finite(step: Path, arrays: Arrays) -> None:
    for name, leaf in arrays.items():
        if not np.isfinite(leaf).all():
            raise RequestError(f"checkpoint: {step} cannot be used: {name[:80]!a} holds no finite numbers")


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
        raise RequestError(f"--run: {run} is invalid: there is no such folder")
    if not (run / "config.yaml").is_file():
        raise RequestError(f"--run: {run} cannot be used: it holds no config.yaml, so it is no training run")
    checkpoint = load(run / BEST)
    if checkpoint is None:
        raise RequestError(f"--run: {run} cannot be used: it holds no checkpoint ({BEST}); train it first")
    config = read_stored_config(run / "config.yaml")
    abstract = nnx.eval_shape(lambda: ContactSensor(config.sensor, nnx.Rngs(0), config.scene.n_types))
    _require_finite(run / BEST, checkpoint[1])
    graphdef, template = nnx.split(abstract)
    return nnx.merge(graphdef, from_arrays(template, checkpoint[1])), config


def fingerprint_of(sensor: ContactSensor) -> str:
    """What tells a trained sensor from all others."""
    return provenance.fingerprint(to_arrays(nnx.state(sensor)))


def _named(tree) -> dict:
    """The leaves, abstract or not, by their paths."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}
