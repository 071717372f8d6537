"""Iterate over a data set in batches of windows, from device memory if it fits, otherwise from the host."""

import math
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.data.episode import Episode
from mjx_fit.data.windows import Sample, windows_of
from mjx_fit.types import Array

DEVICE_SHARE = 0.5
"""Maximum share of the device's free memory for a data set; the rest is left for the computation."""


def placed(data: Episode, free_bytes: int | None = None) -> Episode:
    """Move the data set to the device if it fits there; otherwise keep it as NumPy arrays on the host.

    Args:
        data: Stacked episodes.
        free_bytes: Free memory of the device; None: as reported by the device, or unlimited if it reports
            nothing.
    """
    if free_bytes is None:
        stats = jax.devices()[0].memory_stats()
        free_bytes = stats["bytes_limit"] - stats["bytes_in_use"] if stats else None
    size = sum(leaf.nbytes for leaf in jax.tree.leaves(data))
    fits = free_bytes is None or size <= DEVICE_SHARE * free_bytes
    return jax.tree.map(jnp.asarray if fits else np.asarray, data)


def batches(
    data: Episode, episodes: Int[np.ndarray, "n *length"], key: Key[Array, ""], config: Config
) -> Iterator[tuple[Sample, Float[Array, "batch *length"]]]:
    """Iterate once over the episodes in random order, drawing a new window from each.

    The same key gives the same order, windows and noise, regardless of batch size and memory location.

    Args:
        data: Data set, on the device or on the host.
        episodes: Indices of the episodes to use, or ``windows.chains`` of them.
        key: Random key of the order, windows, noise and type priors.
        config: Configuration; ``train.batch_size`` is the maximum number of windows per batch.

    Yields:
        Batches of equal shape, on the device, and the weight of each window: 0 for padding.
    """
    if not len(episodes):
        return
    *order, window_key = in_order(jnp.asarray(episodes), key, config.train.batch_size)
    for ids, weight in zip(*order, strict=True):
        rows = np.asarray(ids) if isinstance(data.episode, np.ndarray) else ids
        yield (
            windows_of(jax.tree.map(lambda leaf, rows=rows: leaf[rows], data), ids, window_key, config),
            weight,
        )


def in_order(
    episodes: Int[Array, "n *length"], key: Key[Array, ""], batch_size: int
) -> tuple[Int[Array, "steps batch *length"], Float[Array, "steps batch *length"], Key[Array, ""]]:
    """Shuffle the episodes into batches; return the batches, their weights and the key of their windows."""
    order_key, window_key = jax.random.split(key)
    return *equal_batches(jax.random.permutation(order_key, episodes), batch_size), window_key


def n_batches(episodes: Int[Array, "n *length"], batch_size: int) -> int:
    """Number of batches in one pass; a chain of length K counts as K windows."""
    return math.ceil(len(episodes) / max(1, batch_size // math.prod(episodes.shape[1:])))


def equal_batches(
    episodes: Int[Array, "n *length"], batch_size: int
) -> tuple[Int[Array, "steps batch *length"], Float[Array, "steps batch *length"]]:
    """Divide episodes into ``n_batches`` batches of equal size, at most ``batch_size`` windows each.

    Equal sizes leave fewer empty slots than there are batches. Empty slots repeat an episode with weight
    zero; missing attempts of a chain also have weight zero.
    """
    n, steps = len(episodes), n_batches(episodes, batch_size)
    places = jnp.arange(steps * math.ceil(n / steps))
    taken = episodes[places % n]
    weight = (places < n).reshape(-1, *[1] * (episodes.ndim - 1)) & (taken >= 0)
    if episodes.ndim > 1:
        # Windows of weight zero are still computed: use a valid episode, since the last one may be diverged.
        taken = jnp.where(taken >= 0, taken, taken[:, :1])
    shape = (steps, -1, *episodes.shape[1:])
    return taken.reshape(shape), weight.astype(float).reshape(shape)
