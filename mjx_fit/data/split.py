"""Train/validation split by sequence, so that no hole is on both sides."""

import numpy as np
from jaxtyping import Int

from mjx_fit.utils.errors import RequestError


def split_sequences(
    sequences: Int[np.ndarray, "episodes"], fraction: float, seed: int
) -> tuple[Int[np.ndarray, "training"], Int[np.ndarray, "validation"]]:
    """Draw the indices of training and validation episodes, at least one of each.

    All episodes of a sequence share a hole and go to the same side.

    Args:
        sequences: Sequence of each episode.
        fraction: Share of validation sequences.
        seed: Seed of the draw.

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
