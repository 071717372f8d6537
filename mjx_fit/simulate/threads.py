"""Host threads for batches of worlds."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from jaxtyping import Int

T = TypeVar("T")


def parts_of(n: int, threads: int, at_most: int) -> list[Int[np.ndarray, "m"]]:
    """Divides ids 0 to n - 1 into parts of nearly equal size, as many as keep all threads busy.

    Args:
        n: Number of ids.
        threads: Host threads.
        at_most: Largest part.
    """
    rounds = max(1, -(-n // (threads * at_most)))
    return [part for part in np.array_split(np.arange(n), threads * rounds) if len(part)]


def on_threads(threads: int, work: Callable[[T], None], items: Iterable[T]) -> None:
    """Does the work for every item, on so many threads at once; raises what the first to fail raised."""
    pool = ThreadPoolExecutor(threads)
    try:
        for _ in pool.map(work, items):
            pass
    finally:
        # Without waiting: after Ctrl-C nobody wants the other threads' results.
        pool.shutdown(wait=False, cancel_futures=True)
