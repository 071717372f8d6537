"""Linear algebra of small matrices and vectors with worlds as the last axis, written out entry by entry.

Every matrix entry is a contiguous row of worlds, and a sum written term by term is plain arithmetic on such
rows, which a compiler vectorises and fuses with surrounding operations. XLA's own reductions and batched
products of small matrices process one number at a time on a CPU, many times slower; a library's batched
Cholesky is one call per matrix on a CPU and a separate kernel launch on a GPU.

Most functions accept any number of world axes, including none; ``largest`` requires one.
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
    """Sum along an axis."""
    index = (slice(None),) * axis
    return reduce(add, (x[(*index, i)] for i in range(x.shape[axis])))


def times(matrix: Float[Array, "n m *b"], vector: Float[Array, "m *b"]) -> Float[Array, "n *b"]:
    """Multiply a matrix by a vector."""
    return reduce(add, (matrix[:, i] * vector[i] for i in range(len(vector))))


def product(a: Float[Array, "n m *b"], b: Float[Array, "m k *b"]) -> Float[Array, "n k *b"]:
    """Multiply two matrices."""
    return jnp.stack([times(a, b[:, i]) for i in range(b.shape[1])], 1)


def cross(a: Float[Array, "3 *b"], b: Float[Array, "3 *b"]) -> Float[Array, "3 *b"]:
    """Compute the cross product along the first axis."""
    return jnp.stack([a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)])


def column(values: Float[Array, "n"], like: Float[Array, "n *b"]) -> Float[Array, "n *ones"]:
    """Reshape one value per row to broadcast over the worlds of an array."""
    return jnp.reshape(jnp.asarray(values, like.dtype), (-1, *[1] * (like.ndim - 1)))


def largest(
    value: Float[Array, "n b"], fields: Float[Array, "f n b"], count: int
) -> Float[Array, "{count} f b"]:
    """Select the fields of the largest positive values, in descending order, padded with zeros.

    Values are compared to within a few parts in 100,000; ties keep their order. A scan is used because its
    inputs are computed once, whereas XLA would recompute them in each place that uses them.
    """
    places = len(value) - 1
    room = (1 << places.bit_length()) - 1
    # Bits of positive floats sort like the floats, so the lowest bits can store the index.
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
    """Wrap a function of arrays (..., worlds) as one of arrays (...) that vmap runs with worlds last."""

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
    """Cholesky factor of A = L Lᵀ.

    Attributes:
        lower: Entries of L below its diagonal, ``lower[i][j]`` for j < i.
        inverse_diagonal: Reciprocals 1 / L_ii of the diagonal.
    """

    lower: list[list[Float[Array, "*b"]]]
    inverse_diagonal: list[Float[Array, "*b"]]


def cholesky_factor(matrix: Float[Array, "n n *b"], damping: float = 0.0) -> CholeskyFactor:
    """Compute the Cholesky factor of a matrix, reading only its lower triangle.

    A matrix that is not positive definite gives NaN in its own world only.

    Args:
        matrix: Symmetric matrix A.
        damping: Value added to the diagonal.
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
    """Solve L x = b."""
    x = []
    for i, scale in enumerate(a.inverse_diagonal):
        x.append((b[i] - sum(a.lower[i][k] * x[k] for k in range(i))) * scale)
    return jnp.stack(x)


def cholesky_solve(a: CholeskyFactor, b: Float[Array, "n *b"]) -> Float[Array, "n *b"]:
    """Solve A x = b."""
    y = solve_lower(a, b)
    n = len(a.inverse_diagonal)
    x = [jnp.zeros(())] * n
    for i in reversed(range(n)):
        x[i] = (y[i] - sum(a.lower[k][i] * x[k] for k in range(i + 1, n))) * a.inverse_diagonal[i]
    return jnp.stack(x)
