"""Arithmetic over worlds against NumPy's, world by world."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit import lanes


@pytest.mark.parametrize("worlds", [(), (5,)])
def test_sums_and_products_are_numpys(worlds):
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(3, 4, *worlds)), rng.normal(size=(4, *worlds))
    u, v = rng.normal(size=(2, 3, *worlds))
    with jax.enable_x64(True):
        assert np.allclose(lanes.total(jnp.asarray(a)), a.sum(0))
        assert np.allclose(lanes.total(jnp.asarray(a), 1), a.sum(1))
        assert np.allclose(lanes.times(jnp.asarray(a), jnp.asarray(b)), np.einsum("ij...,j...->i...", a, b))
        assert np.allclose(lanes.cross(jnp.asarray(u), jnp.asarray(v)), np.cross(u, v, axis=0))
        assert lanes.column(np.arange(4), b).shape == (4, *[1] * len(worlds))


def test_a_function_of_worlds_works_on_one_world_and_under_vmap():
    seen = []

    def scaled(matrix, vector):
        seen.append(matrix.shape)
        return {"product": lanes.times(matrix, vector)}

    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(5, 3, 4)).astype(np.float32), rng.normal(size=4).astype(np.float32)
    function = lanes.worlds_last(scaled)
    one = function(a[0], b)["product"]
    many = jax.jit(jax.vmap(function, (0, None)))(a, b)["product"]
    assert (seen[0], seen[-1]) == ((3, 4, 1), (3, 4, 5))
    assert np.allclose(one, a[0] @ b, atol=1e-6)
    assert np.allclose(many, a @ b, atol=1e-6)


largest = jax.jit(lanes.largest, static_argnums=2)
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
