"""Where randomness comes from: one seed, and a root key for each use of it.

``jax.random.fold_in(key, i)`` and ``jax.random.split(key)[i]`` are the same key. So no key is both split and
folded into in this library; a draw would show through in another one.
"""

import zlib

import jax
from jaxtyping import Key

from mjx_fit.utils import numerics
from mjx_fit.utils.errors import require


def root_key(seed: int, use: str) -> Key[jax.Array, ""]:
    """The key that everything random in one use of a seed comes from.

    Args:
        seed: As given on the command line.
        use: What for: data sets and evaluations of the same seed must not meet the same episodes.

    Raises:
        RequestError: A setting of the process would change what is drawn.
    """
    numerics.require()
    return jax.random.fold_in(numerics.key(seed), zlib.crc32(use.encode()))


def require_seed(seed: int) -> None:
    """Checks a seed.

    Raises:
        RequestError: It does not fit 32 bits.
    """
    require("--seed", seed, 0, 2**32 - 1)
