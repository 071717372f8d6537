"""Array type of the host or the device."""

import jax
import numpy as np

Array = jax.Array | np.ndarray
"""Leaf of a pytree: on the device inside computations, on the host outside."""
