"""The written-out solves against LAPACK's."""

import jax
import numpy as np
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit import spd


def random_spd(seed, n):
    a = np.random.default_rng(seed).normal(0, 1, (n, 2 * n))
    return a @ a.T / n


@given(st.integers(0, 2**31), st.integers(1, 7))
def test_solves_agree_with_lapack(seed, n):
    matrix, b = random_spd(seed, n), np.random.default_rng(seed + 1).normal(0, 1, (n, 3))
    lower = np.linalg.cholesky(matrix)
    with jax.enable_x64(True):
        factor = spd.factor(jax.numpy.asarray(matrix))
        half, whole = spd.solve_lower(factor, b), spd.solve(factor, b)
        vector = spd.solve(factor, b[:, 0])
        damped = spd.solve(spd.factor(jax.numpy.asarray(matrix), 0.1), b)
    assert np.allclose(half, scipy.linalg.solve_triangular(lower, b, lower=True), atol=1e-9)
    assert np.allclose(whole, np.linalg.solve(matrix, b), atol=1e-8)
    assert np.allclose(vector, np.asarray(whole)[:, 0], atol=1e-9)
    assert np.allclose(damped, np.linalg.solve(matrix + 0.1 * np.eye(n), b), atol=1e-8)


def test_a_bad_matrix_spoils_no_other_world():
    matrices = np.stack([np.eye(3), -np.eye(3), 2 * np.eye(3)]).astype(np.float32)
    solved = jax.vmap(lambda a: spd.solve(spd.factor(a), np.ones(3, np.float32)))(matrices)
    assert np.isnan(solved[1]).all()
    assert np.array_equal(solved[0], np.ones(3))
    assert np.allclose(solved[2], 0.5)
