"""Random keys: one seed, with a separate root key for each use.

Keys ``jax.random.fold_in(key, i)`` and ``jax.random.split(key)[i]`` are identical. No key in this library is
both split and folded into, since different draws would then be correlated.
"""

import zlib

import jax
from jaxtyping import Key

from mjx_fit.utils import numerics
from mjx_fit.utils.errors import require


def root_key(seed: int, use: str) -> Key[jax.Array, ""]:
    """Create the root key of all random draws in one use of a seed.

    Args:
        seed: Seed from the command line.
        use: Name of the use, so that data sets and evaluations with the same seed have different episodes.

    Raises:
        RequestError: A process setting would change random draws.
    """
    numerics.require()
    return jax.random.fold_in(numerics.key(seed), zlib.crc32(use.encode()))


def require_seed(seed: int) -> None:
    """Check a seed.

    Raises:
        RequestError: The seed does not fit into 32 bits.
    """
    require("--seed", seed, 0, 2**32 - 1)
