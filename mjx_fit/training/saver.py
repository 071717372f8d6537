"""Keeps what is worth keeping of a training: the best sensor of each member, and what resuming needs."""

import math
import time
from pathlib import Path

import jax
import numpy as np
from flax import nnx
from jaxtyping import Float

from mjx_fit.training import checkpoint
from mjx_fit.training.step import TrainState


class Saver:
    """Writes ``best`` and ``last`` now and then, and says when to stop early.

    ``best`` goes first: should a kill fall between the two, the epochs after ``last`` are run again and come
    to the same best.
    """

    def __init__(self, out: Path, members: list[Path], every_s: float, patience: int):
        """Folder of ``last``, those of each member's ``best``, least time between two, epochs of patience."""
        self.out, self.members, self.every_s, self.patience = out, members, every_s, patience
        self.best_nll = np.full(len(members), math.inf)
        self.best_epoch = np.zeros(len(members), int)
        self.best: dict[int, checkpoint.Arrays] = {}
        self.saved_at = -math.inf  # the first epoch, which compiles, is worth keeping

    def resume(self, epochs_done: int, arrays: checkpoint.Arrays) -> None:
        """Take what was remembered out of the arrays of a checkpoint."""
        self.best_nll = np.array(arrays.pop("best_nll"), float).reshape(-1)
        self.best_epoch = np.array(arrays.pop("best_epoch", epochs_done), int).reshape(-1)

    def is_stale(self, epochs_done: int) -> bool:
        """Whether no member's validation has become better for so long that training is over."""
        return bool(self.patience) and bool((epochs_done - self.best_epoch >= self.patience).all())

    def after_epoch(
        self, epochs_done: int, state: TrainState, val_nll: Float[np.ndarray, "members"], epochs: int
    ) -> bool:
        """Keep what is worth keeping; whether this epoch was the last one."""
        for member in np.flatnonzero(val_nll < self.best_nll).tolist():
            self.best_nll[member], self.best_epoch[member] = val_nll[member], epochs_done
            own = state if len(self.members) == 1 else jax.tree.map(lambda leaf, m=member: leaf[m], state)
            self.best[member] = checkpoint.to_arrays(nnx.merge_state(own.params, own.scale))
        final = epochs_done == epochs or self.is_stale(epochs_done)
        if not final and time.monotonic() - self.saved_at < self.every_s:
            return False
        for member, arrays in self.best.items():
            checkpoint.save(self.members[member] / checkpoint.BEST, int(self.best_epoch[member]), arrays)
        self.best = {}
        remembered = {"best_nll": self.best_nll, "best_epoch": self.best_epoch}
        checkpoint.save(self.out / checkpoint.LAST, epochs_done, checkpoint.to_arrays(state) | remembered)
        self.saved_at = time.monotonic()
        return final
