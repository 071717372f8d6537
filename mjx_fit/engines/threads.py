"""Run batches of worlds on host threads, and choose the batch sizes."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import math
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import mujoco
import numpy as np
from jaxtyping import Int

T = TypeVar("T")


def parts_of(n: int, threads: int, at_most: int) -> list[Int[np.ndarray, "m"]]:
    """Divide the ids 0 to n - 1 into parts of nearly equal size that keep all threads busy.

    Args:
        n: Number of ids.
        threads: Number of host threads.
        at_most: Maximum size of a part.
    """
    rounds = max(1, -(-n // (threads * at_most)))
    return [part for part in np.array_split(np.arange(n), threads * rounds) if len(part)]


def on_threads(threads: int, work: Callable[[T], None], items: Iterable[T]) -> None:
    """Process all items on a thread pool; raise the first exception."""
    pool = ThreadPoolExecutor(threads)
    try:
        for _ in pool.map(work, items):
            pass
    finally:
        # Do not wait: after Ctrl-C the results of the other threads are not needed.
        pool.shutdown(wait=False, cancel_futures=True)


def even_batch(n: int, at_most: int) -> int:
    """Return the batch size for n attempts: equal batches with little padding in the last one."""
    return math.ceil(n / math.ceil(n / at_most))


def silence_mujoco() -> None:
    """Suppress MuJoCo's log file in the working folder; ``Truth.valid`` reports diverged simulations.

    A handler that the caller has set stays in place.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda message: None)
