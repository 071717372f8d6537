"""Solves with small symmetric positive definite matrices, written out entry by entry.

A library's batched Cholesky is one call for each matrix on a CPU and a kernel launch of its own on a GPU.
Entry by entry it is plain arithmetic, which a compiler fuses with what surrounds it.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from mjx_fit.types import Array


class Factor(NamedTuple):
    """A Cholesky factor A = L Lᵀ.

    Attributes:
        lower: ``lower[i][j]`` for j < i: the entries of L below its diagonal.
        inverse_diagonal: 1 / L_ii.
    """

    lower: list[list[Float[Array, "*b"]]]
    inverse_diagonal: list[Float[Array, "*b"]]


def factor(matrix: Float[Array, "n n *b"], damping: float = 0.0) -> Factor:
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
    return Factor(lower, inverse_diagonal)


def solve_lower(a: Factor, b: Float[Array, "n *b"]) -> Float[Array, "n *b"]:
    """X with L x = b."""
    x = []
    for i, scale in enumerate(a.inverse_diagonal):
        x.append((b[i] - sum(a.lower[i][k] * x[k] for k in range(i))) * scale)
    return jnp.stack(x)


def solve(a: Factor, b: Float[Array, "n *b"]) -> Float[Array, "n *b"]:
    """X with A x = b."""
    y = solve_lower(a, b)
    n = len(a.inverse_diagonal)
    x = [jnp.zeros(())] * n
    for i in reversed(range(n)):
        x[i] = (y[i] - sum(a.lower[k][i] * x[k] for k in range(i + 1, n))) * a.inverse_diagonal[i]
    return jnp.stack(x)
