"""Passes over a data set in batches of windows: from the device where it fits, from the host where not."""

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
"""Share of the device's free memory that a data set may take; the rest is for what is computed with it."""


def placed(data: Episode, free_bytes: int | None = None) -> Episode:
    """The data set on the device if it fits there, otherwise as NumPy arrays on the host.

    Args:
        data: Stacked episodes.
        free_bytes: Free memory of the device; None: as the device says, and any amount where it says nothing.
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
    """One pass: a fresh window from each of the episodes, in an order drawn from the key.

    The same key gives the same order, windows and noise, wherever the data are and however large the batches.

    Args:
        data: The data set, on the device or on the host.
        episodes: Indices of those that take part, or ``windows.chains`` of them.
        key: Source of the order, of windows, noise and type priors.
        config: ``train.batch_size`` is the most windows in a batch.

    Yields:
        Batches of one shape, on the device, and the weight of each window: 0 for those that only fill up.
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
    """The batches of one pass in an order drawn from the key, their weights, and the key of their windows."""
    order_key, window_key = jax.random.split(key)
    return *equal_batches(jax.random.permutation(order_key, episodes), batch_size), window_key


def n_batches(episodes: Int[Array, "n *length"], batch_size: int) -> int:
    """In how many batches a pass goes over these; a chain counts as many windows as it is long."""
    return math.ceil(len(episodes) / max(1, batch_size // math.prod(episodes.shape[1:])))


def equal_batches(
    episodes: Int[Array, "n *length"], batch_size: int
) -> tuple[Int[Array, "steps batch *length"], Float[Array, "steps batch *length"]]:
    """Cut into ``n_batches`` batches of equal size, at most ``batch_size`` windows.

    Equal sizes leave fewer places over than there are batches; those repeat an episode, with weight zero, as
    has a place in a chain where there is none.
    """
    n, steps = len(episodes), n_batches(episodes, batch_size)
    places = jnp.arange(steps * math.ceil(n / steps))
    taken = episodes[places % n]
    weight = (places < n).reshape(-1, *[1] * (episodes.ndim - 1)) & (taken >= 0)
    if episodes.ndim > 1:
        # A window that does not count is still computed: not of whatever stands last, which may be broken.
        taken = jnp.where(taken >= 0, taken, taken[:, :1])
    shape = (steps, -1, *episodes.shape[1:])
    return taken.reshape(shape), weight.astype(float).reshape(shape)
