"""Array type of the host or the device."""

from typing import Any

import jax
import numpy as np

Array = jax.Array | np.ndarray
"""Leaf of a pytree: on the device inside computations, on the host outside."""


def is_off(value: Any) -> bool:
    """Return True for the plain number 0: a computation that it scales can be left out.

    Arrays, which may be traced, are never off.
    """
    return isinstance(value, int | float) and value == 0


def with_row(leaf: np.ndarray, row: int, value: np.ndarray) -> np.ndarray:
    """Return a copy of an array with another row."""
    changed = leaf.copy()
    changed[row] = value
    return changed
