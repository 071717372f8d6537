"""Small matrices and vectors, with the worlds as the last axis, written out entry by entry.

Every number is then a contiguous row of worlds, and a sum that is written out term by term is plain
arithmetic on such rows, which a compiler turns into vector instructions and fuses with what surrounds it.
XLA's own reductions and batched products of small matrices handle one number at a time on a CPU, many times
slower; a library's batched Cholesky is one call for each matrix on a CPU and a kernel launch of its own on a
GPU.

Most functions take any number of world axes, including none; ``largest`` takes one.
"""

from collections.abc import Callable
from functools import reduce
from operator import add
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from mjx_fit.utils.arrays import Array


def total(x: Float[Array, "*n"], axis: int = 0) -> Float[Array, "*m"]:
    """The sum along an axis."""
    index = (slice(None),) * axis
    return reduce(add, (x[(*index, i)] for i in range(x.shape[axis])))


def times(matrix: Float[Array, "n m *b"], vector: Float[Array, "m *b"]) -> Float[Array, "n *b"]:
    """Matrix times vector."""
    return reduce(add, (matrix[:, i] * vector[i] for i in range(len(vector))))


def cross(a: Float[Array, "3 *b"], b: Float[Array, "3 *b"]) -> Float[Array, "3 *b"]:
    """The cross product along the first axis."""
    return jnp.stack([a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)])


def column(values: Float[Array, "n"], like: Float[Array, "n *b"]) -> Float[Array, "n *ones"]:
    """One value for each row of an array, the same for all worlds."""
    return jnp.reshape(jnp.asarray(values, like.dtype), (-1, *[1] * (like.ndim - 1)))


def largest(
    value: Float[Array, "n b"], fields: Float[Array, "f n b"], count: int
) -> Float[Array, "{count} f b"]:
    """The fields that go with the largest positive values, the largest first; zeros where there are no more.

    Values are compared up to some parts in 100,000; the first of equals comes first. A scan, since all that
    enters one is computed once, where XLA would compute it anew in each of the places that use it.
    """
    places = len(value) - 1
    room = (1 << places.bit_length()) - 1
    # The bits of positive numbers are in the order of the numbers: the last of them can say which one it is.
    bits = jax.lax.bitcast_convert_type(value, jnp.int32) & ~room
    rank = jnp.arange(room, room - len(value), -1, dtype=jnp.int32)
    keys = jnp.where(value > 0, bits | rank[:, None], 0)

    def next_largest(before, _):
        best = reduce(jnp.maximum, (jnp.where(key < before, key, 0) for key in keys))
        place = jnp.where(best > 0, room - (best & room), -1)
        found = reduce(jnp.add, (jnp.where(place == i, fields[:, i], 0.0) for i in range(len(value))))
        return best, found

    beyond = jnp.full(value.shape[1:], jnp.iinfo(jnp.int32).max)
    return jax.lax.scan(next_largest, beyond, length=count)[1]


def worlds_last(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of pytrees of arrays (..., worlds) as one of arrays (...) that vmap runs in that layout."""

    def of_worlds(*args):
        last = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), args)
        return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), function(*last))

    @jax.custom_batching.custom_vmap
    def of_one(*args):
        return jax.tree.map(lambda x: x[0], of_worlds(*jax.tree.map(lambda x: x[None], args)))

    @of_one.def_vmap
    def _(size, batched, *args):
        def spread(x, has_worlds):
            return x if has_worlds else jnp.broadcast_to(x, (size, *x.shape))

        result = of_worlds(*jax.tree.map(spread, args, tuple(batched)))
        return result, jax.tree.map(lambda _: True, result)

    return of_one


class CholeskyFactor(NamedTuple):
    """A Cholesky factor A = L Lᵀ.

    Attributes:
        lower: ``lower[i][j]`` for j < i: the entries of L below its diagonal.
        inverse_diagonal: 1 / L_ii.
    """

    lower: list[list[Float[Array, "*b"]]]
    inverse_diagonal: list[Float[Array, "*b"]]


def cholesky_factor(matrix: Float[Array, "n n *b"], damping: float = 0.0) -> CholeskyFactor:
    """The Cholesky factor of a matrix, of which only the lower triangle is read.

    A matrix that is not positive definite gives NaN, in its own world alone.

    Args:
        matrix: A.
        damping: Is added to the diagonal.
    """
    lower, inverse_diagonal = [], []
    for i in range(len(matrix)):
        row = []
        for j in range(i):
            rest = matrix[i, j] - sum(row[k] * lower[j][k] for k in range(j))
            row.append(rest * inverse_diagonal[j])
        inverse_diagonal.append(lax.rsqrt(matrix[i, i] + damping - sum(x * x for x in row)))
        lower.append(row)
    return CholeskyFactor(lower, inverse_diagonal)


def solve_lower(a: CholeskyFactor, b: Float[Array, "n *b"]) -> Float[Array, "n *b"]:
    """X with L x = b."""
    x = []
    for i, scale in enumerate(a.inverse_diagonal):
        x.append((b[i] - sum(a.lower[i][k] * x[k] for k in range(i))) * scale)
    return jnp.stack(x)


def cholesky_solve(a: CholeskyFactor, b: Float[Array, "n *b"]) -> Float[Array, "n *b"]:
    """X with A x = b."""
    y = solve_lower(a, b)
    n = len(a.inverse_diagonal)
    x = [jnp.zeros(())] * n
    for i in reversed(range(n)):
        x[i] = (y[i] - sum(a.lower[k][i] * x[k] for k in range(i + 1, n))) * a.inverse_diagonal[i]
    return jnp.stack(x)
