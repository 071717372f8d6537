"""Sums over small leading axes, written out term by term.

Where the worlds are the last axis, a sum of terms is plain arithmetic on rows of worlds, which a compiler turns into
vector instructions and fuses with what surrounds it. XLA's own reductions go through one number at a time on a
CPU: 35 times slower for a product of (8, 3, 7, 128) with (7, 128), summed over the 7.
"""

from functools import reduce
from operator import add

from jaxtyping import Float

from mjx_fit.types import Array


def total(x: Float[Array, "*n"], axis: int = 0) -> Float[Array, "*m"]:
    """The sum along an axis."""
    index = (slice(None),) * axis
    return reduce(add, (x[(*index, i)] for i in range(x.shape[axis])))


def times(matrix: Float[Array, "n m *b"], vector: Float[Array, "m *b"]) -> Float[Array, "n *b"]:
    """Matrix times vector."""
    return reduce(add, (matrix[:, i] * vector[i] for i in range(len(vector))))
