"""Checkpoints of a training run: ``best`` (a sensor) and ``last`` (the full state for resuming).

A checkpoint stores a tree as a flat dictionary from leaf paths to NumPy arrays, so a CPU can read one from an
accelerator. The writer creates it under a temporary name and renames it, so a kill leaves the previous one
intact. The digests of its files reveal damage before any array is read.
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
from mjx_fit.utils import numerics, provenance, resources
from mjx_fit.utils.errors import RequestError

BEST, LAST = Path("checkpoints", "best"), Path("checkpoints", "last")
FRAME_BY_FRAME = "frame_by_frame"
"""Folder of the baseline's training, inside the run folder."""
ARRAYS = "default"
"""Folder of the arrays, inside a step."""
_MAY_BE_INFINITE = "best_nll"
"""Infinite until an epoch has improved the validation."""


def to_arrays(tree) -> Arrays:
    """Return the leaves of a pytree by path, as NumPy arrays on the host."""
    return {name: np.asarray(leaf) for name, leaf in _named(tree).items()}


def from_arrays(template, arrays: Arrays):
    """Invert ``to_arrays``: return a tree like the template, with the arrays as leaves.

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
                f"expected {expected.get(name)}"
            )
    return jax.tree.unflatten(
        jax.tree.structure(template), [jax.numpy.asarray(arrays[name]) for name in wanted]
    )


def save(folder: Path, epochs_done: int, arrays: Arrays) -> None:
    """Store a checkpoint, then delete the previous one."""
    step_folder.write(folder, epochs_done, lambda place: stored_arrays.write(place / ARRAYS, arrays))


def load(folder: Path) -> tuple[int, Arrays] | None:
    """Load the newest checkpoint: the number of completed epochs and the arrays, or None if none exists.

    A checkpoint from an earlier version without digests loads with a warning on stderr.

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
    """Warn once per step."""
    print(
        f"mjx-fit: {step} has no {step_folder.DIGESTS}: an earlier version wrote it, and damage to it "
        "may go undetected",
        file=sys.stderr,
    )


def _require_finite(step: Path, arrays: Arrays) -> None:
    for name, leaf in arrays.items():
        if not np.isfinite(leaf).all():
            raise RequestError(f"checkpoint: {step} cannot be used: {name[:80]!a} has non-finite numbers")


def load_last(out: Path) -> tuple[int, Arrays | None]:
    """Load a run's last checkpoint: number of completed epochs and arrays; 0 and None if none exists."""
    return load(out / LAST) or (0, None)


def load_sensor(run: Path) -> tuple[ContactSensor, Config]:
    """Load the best sensor of a training run and the configuration of its training.

    Raises:
        RequestError: The folder is missing, holds no run or no checkpoint, or the network differs.
    """
    numerics.require()
    run = Path(run)
    if not run.is_dir():
        named = ", ".join(resources.SHIPPED_RUNS)
        raise RequestError(f"--run: {run} is invalid: there is no such folder; expected one, or {named}")
    if not (run / "config.yaml").is_file():
        raise RequestError(
            f"--run: {run} cannot be used: it holds no config.yaml, so it is not a training run"
        )
    checkpoint = load(run / BEST)
    if checkpoint is None:
        raise RequestError(f"--run: {run} cannot be used: it holds no checkpoint ({BEST}); train it first")
    config = read_stored_config(run / "config.yaml")
    abstract = nnx.eval_shape(lambda: ContactSensor.of(config, nnx.Rngs(0)))
    _require_finite(run / BEST, checkpoint[1])
    graphdef, template = nnx.split(abstract)
    return nnx.merge(graphdef, from_arrays(template, checkpoint[1])), config


def fingerprint_of(sensor: ContactSensor) -> str:
    """Return the fingerprint that identifies a trained sensor."""
    return provenance.fingerprint(to_arrays(nnx.state(sensor)))


def _named(tree) -> dict:
    """Return the leaves, abstract or concrete, by path."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}
