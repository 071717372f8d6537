"""Small matrices, world by world, against NumPy and LAPACK."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.utils import linalg
from mjx_fit.utils.linalg import cholesky_factor, cholesky_solve, solve_lower


@pytest.mark.parametrize("worlds", [(), (5,)])
def test_sums_and_products_are_numpys(worlds):
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(3, 4, *worlds)), rng.normal(size=(4, *worlds))
    u, v = rng.normal(size=(2, 3, *worlds))
    with jax.enable_x64(True):
        assert np.allclose(linalg.total(jnp.asarray(a)), a.sum(0))
        assert np.allclose(linalg.total(jnp.asarray(a), 1), a.sum(1))
        assert np.allclose(linalg.times(jnp.asarray(a), jnp.asarray(b)), np.einsum("ij...,j...->i...", a, b))
        assert np.allclose(linalg.cross(jnp.asarray(u), jnp.asarray(v)), np.cross(u, v, axis=0))
        assert linalg.column(np.arange(4), b).shape == (4, *[1] * len(worlds))


def test_a_function_of_worlds_works_on_one_world_and_under_vmap():
    seen = []

    def scaled(matrix, vector):
        seen.append(matrix.shape)
        return {"product": linalg.times(matrix, vector)}

    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(5, 3, 4)).astype(np.float32), rng.normal(size=4).astype(np.float32)
    function = linalg.worlds_last(scaled)
    one = function(a[0], b)["product"]
    many = jax.jit(jax.vmap(function, (0, None)))(a, b)["product"]
    assert (seen[0], seen[-1]) == ((3, 4, 1), (3, 4, 5))
    assert np.allclose(one, a[0] @ b, atol=1e-6)
    assert np.allclose(many, a @ b, atol=1e-6)


largest = jax.jit(linalg.largest, static_argnums=2)
VALUES = st.one_of(  # of few lengths: each is compiled
    *(st.lists(st.integers(-1000, 1000), min_size=n, max_size=n, unique=True) for n in (3, 8, 30))
)


@given(VALUES, st.sampled_from([1, 2, 5]))
def test_the_largest_are_found_in_order(values, count):
    value = np.asarray(values, np.float32) / 1000
    # A place of zero means none: shifted by one, which the first may be.
    fields = jnp.stack([jnp.asarray(value), jnp.arange(1, len(value) + 1, dtype=jnp.float32)])
    got = np.asarray(largest(jnp.asarray(value)[:, None], fields[..., None], count))
    positive = sorted((v for v in value.tolist() if v > 0), reverse=True)[:count]
    for (found, place), want in zip(got[:, :, 0], [*positive, *[0.0] * count], strict=False):
        assert found == pytest.approx(want, rel=1e-4)
        assert found == value[int(place) - 1] if want else place == 0


def test_nothing_is_found_where_no_value_is_positive():
    value = jnp.array([[0.0, -1.0, 2.0], [-1.0, 0.0, 0.0]])  # two values in each of three worlds
    got = largest(value, jnp.full((1, 2, 3), 7.0), 2)
    assert got[:, 0].tolist() == [[0, 0, 7], [0, 0, 0]]


def random_spd(seed, n):
    a = np.random.default_rng(seed).normal(0, 1, (n, 2 * n))
    return a @ a.T / n


@given(st.integers(0, 2**31), st.integers(1, 7))
def test_solves_agree_with_lapack(seed, n):
    matrix, b = random_spd(seed, n), np.random.default_rng(seed + 1).normal(0, 1, (n, 3))
    lower = np.linalg.cholesky(matrix)
    with jax.enable_x64(True):
        factor = cholesky_factor(jax.numpy.asarray(matrix))
        half, whole = solve_lower(factor, b), cholesky_solve(factor, b)
        vector = cholesky_solve(factor, b[:, 0])
        damped = cholesky_solve(cholesky_factor(jax.numpy.asarray(matrix), 0.1), b)
    assert np.allclose(half, scipy.linalg.solve_triangular(lower, b, lower=True), atol=1e-9)
    assert np.allclose(whole, np.linalg.solve(matrix, b), atol=1e-8)
    assert np.allclose(vector, np.asarray(whole)[:, 0], atol=1e-9)
    assert np.allclose(damped, np.linalg.solve(matrix + 0.1 * np.eye(n), b), atol=1e-8)


def test_a_bad_matrix_spoils_no_other_world():
    matrices = np.stack([np.eye(3), -np.eye(3), 2 * np.eye(3)]).astype(np.float32)
    solved = jax.vmap(lambda a: cholesky_solve(cholesky_factor(a), np.ones(3, np.float32)))(matrices)
    assert np.isnan(solved[1]).all()
    assert np.array_equal(solved[0], np.ones(3))
    assert np.allclose(solved[2], 0.5)
