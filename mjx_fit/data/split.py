"""Train/validation split by sequence, so that no hole is on both sides."""

import numpy as np
from jaxtyping import Int

from mjx_fit.utils.errors import RequestError


def split_sequences(
    sequences: Int[np.ndarray, "episodes"], fraction: float, seed: int
) -> tuple[Int[np.ndarray, "training"], Int[np.ndarray, "validation"]]:
    """Indices of the training and of the validation episodes, at random, at least one of each.

    A sequence, whose episodes share a hole, goes to one side as a whole.

    Args:
        sequences: Which sequence each episode belongs to.
        fraction: Share of the sequences that goes to validation.
        seed: Source of the choice.

    Raises:
        RequestError: There are fewer than two sequences.
    """
    ids, of_episode = np.unique(sequences, return_inverse=True)
    n = len(ids)
    if n < 2:
        raise RequestError(f"--data: {n} holes with a peg cannot be used: training needs at least 2")
    n_validation = min(max(1, round(fraction * n)), n - 1)
    chosen = np.zeros(n, bool)
    chosen[np.random.default_rng(seed).permutation(n)[:n_validation]] = True
    return np.flatnonzero(~chosen[of_episode]), np.flatnonzero(chosen[of_episode])
