"""Run batches of worlds on host threads, and choose the batch sizes."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import math
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
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


class OneByOne:
    """Threads that do something for the first time do so one after the other.

    Two threads that call a jitted function for the first time would both compile it, and JAX has crashed
    where both stored the result.
    """

    def __init__(self) -> None:
        self._lock, self._known = threading.Lock(), set[Hashable]()

    @contextmanager
    def at_first(self, what: Hashable) -> Iterator[None]:
        """Hold the others back until this was done once; later it holds nobody back."""
        if what in self._known:
            yield
            return
        with self._lock:
            yield
        self._known.add(what)


def even_batch(n: int, at_most: int) -> int:
    """Return the batch size for n attempts: equal batches with little padding in the last one."""
    return math.ceil(n / math.ceil(n / at_most))


def silence_mujoco() -> None:
    """Suppress MuJoCo's log file in the working folder; ``Truth.valid`` reports diverged simulations.

    A handler that the caller has set stays in place.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda message: None)
