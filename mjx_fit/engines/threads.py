"""Host threads for batches of worlds, and the sizes of batches."""

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


def even_batch(n: int, at_most: int) -> int:
    """Size of the batches that n attempts are run in: of one shape, with little padding in the last."""
    return math.ceil(n / math.ceil(n / at_most))


def silence_mujoco() -> None:
    """Keeps MuJoCo's warnings out of a file in the working folder: what breaks is in ``Truth.valid``.

    A caller that has set a handler of its own keeps it.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda message: None)
