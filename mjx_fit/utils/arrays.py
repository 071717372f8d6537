"""Arrays of either kind."""

import jax
import numpy as np

Array = jax.Array | np.ndarray
"""What a pytree's leaf may be: on the device inside a computation, on the host outside."""
