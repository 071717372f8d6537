"""Save the checkpoints of a training run: the best sensor of each member, and the state for resuming."""

import errno
import math
import os
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import jax
import numpy as np
from flax import nnx
from jaxtyping import Float

from mjx_fit.training import checkpoint
from mjx_fit.training.step import TrainState
from mjx_fit.utils import files, locks
from mjx_fit.utils.filesystem import refuse_link, reserve

_NO_ROOM = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EMFILE,
    errno.ENFILE,
    errno.EROFS,
    errno.EIO,
    errno.ESTALE,
    errno.EACCES,
    errno.ENOENT,
)
"""System errors that are recognised in the messages of the storage library."""

_COPIES, _OVERHEAD, _DESCRIPTORS = 2, 2**15, 11
"""Needs of the storage library during a write: copies of the arrays, extra bytes per copy, open files."""


class Saver:
    """Write the checkpoints ``best`` and ``last`` periodically, and decide on early stopping.

    ``best`` is written first: after a kill between the two writes, the epochs since ``last`` are repeated and
    lead to the same best.
    """

    def __init__(self, out: Path, members: list[Path], every_s: float, patience: int):
        """Initialise a saver without checkpoints.

        Args:
            out: Folder of ``last``.
            members: Folder of each member's ``best``.
            every_s: Minimum time between two checkpoints, s.
            patience: Epochs without improvement before training stops; 0: never stop early.
        """
        self.out, self.members, self.every_s, self.patience = out, members, every_s, patience
        self.best_nll = np.full(len(members), math.inf)
        self.best_epoch = np.zeros(len(members), int)
        self.best: dict[int, checkpoint.Arrays] = {}
        self.saved_at = -math.inf  # save the first epoch, whose compilation is expensive

    def resume(self, epochs_done: int, arrays: checkpoint.Arrays) -> None:
        """Restore the best validation losses from the arrays of a checkpoint, and remove them there."""
        self.best_nll = np.array(arrays.pop("best_nll"), float).reshape(-1)
        self.best_epoch = np.array(arrays.pop("best_epoch", epochs_done), int).reshape(-1)

    def is_stale(self, epochs_done: int) -> bool:
        """Return True if no member's validation has improved within the patience, so training must stop."""
        return bool(self.patience) and bool((epochs_done - self.best_epoch >= self.patience).all())

    def after_epoch(
        self, epochs_done: int, state: TrainState, val_nll: Float[np.ndarray, "members"], epochs: int
    ) -> bool:
        """Save checkpoints if they are due; return True if this epoch was the last."""
        for member in np.flatnonzero(val_nll < self.best_nll).tolist():
            self.best_nll[member], self.best_epoch[member] = val_nll[member], epochs_done
            own = state if len(self.members) == 1 else jax.tree.map(lambda leaf, m=member: leaf[m], state)
            self.best[member] = checkpoint.to_arrays(nnx.merge_state(own.params, own.scale))
        final = epochs_done == epochs or self.is_stale(epochs_done)
        if not final and time.monotonic() - self.saved_at < self.every_s:
            return False
        for member, arrays in self.best.items():
            _save(self.members[member] / checkpoint.BEST, int(self.best_epoch[member]), arrays)
        self.best = {}
        remembered = {"best_nll": self.best_nll, "best_epoch": self.best_epoch}
        _save(self.out / checkpoint.LAST, epochs_done, checkpoint.to_arrays(state) | remembered)
        self.saved_at = time.monotonic()
        return final


def _save(folder: Path, epochs_done: int, arrays: checkpoint.Arrays) -> None:
    """Store a checkpoint.

    Raises:
        OSError: The disk is full, or a similar system error, which the storage library reports in many forms.
    """
    locks.require_all()
    for own in (folder.parent, folder):
        refuse_link(own)
    _require_room(folder, sum(array.nbytes for array in arrays.values()))
    # Exceptions in threads of the storage library surface here, so the hook need not print them too.
    hook, threading.excepthook = threading.excepthook, lambda _: None
    try:
        checkpoint.save(folder, epochs_done, arrays)
    except Exception as error:
        of_system = _of_system(error, folder)
        if of_system is None:
            raise
        raise of_system from error
    finally:
        threading.excepthook = hook


def _require_room(folder: Path, size: int) -> None:
    """Check with unnamed temporary files that a checkpoint of this size, bytes, fits on the disk.

    The storage library would fail with a traceback from each of its threads.

    Raises:
        OSError: There is not enough room; the error names the folder.
    """
    files.make_folder(folder)
    with ExitStack() as stack:
        try:
            file = stack.enter_context(tempfile.TemporaryFile(dir=folder))
            for _ in range(_DESCRIPTORS):
                stack.callback(os.close, os.dup(file.fileno()))
            for _ in range(_COPIES):
                file = stack.enter_context(tempfile.TemporaryFile(dir=folder))
                reserve(file.fileno(), size + _OVERHEAD)
        except OSError as error:
            error.filename = str(folder)
            raise


def _of_system(error: BaseException, folder: Path) -> OSError | None:
    """Find the system error in an exception, in its causes, or in their messages."""
    causes: list[BaseException] = [error]
    for cause in causes:
        more = [cause.__cause__, cause.__context__, *getattr(cause, "exceptions", ())]
        causes += [one for one in more if one is not None and one not in causes]
    for cause in causes:
        if isinstance(cause, OSError) and cause.errno is not None:
            return OSError(cause.errno, os.strerror(cause.errno), str(folder))
    words = " ".join(map(str, causes))
    for code in _NO_ROOM:
        if os.strerror(code) in words or errno.errorcode[code] in words:
            return OSError(code, os.strerror(code), str(folder))
    return None
