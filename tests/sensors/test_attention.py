"""Attention against JAX's own, values and gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjx_fit.sensors.attention import attend


def inputs(seed, batch=3, heads=2, length=7, size=4):
    rng = np.random.default_rng(seed)
    qkv = jnp.asarray(rng.normal(0, 2, (3, batch, heads, length, size)), jnp.float32)
    count = rng.integers(1, length + 1, batch)
    weight = jnp.asarray(rng.normal(size=(batch, heads, length, size)), jnp.float32)
    return qkv, jnp.asarray(np.arange(length) < count[:, None]), weight


def jaxs(qkv, mask, causal):
    query, key, value = qkv.swapaxes(2, 3)
    result = jax.nn.dot_product_attention(query, key, value, mask=mask[:, None, None, :], is_causal=causal)
    return result.swapaxes(1, 2)


@settings(max_examples=20)
@given(seed=st.integers(0, 999), causal=st.booleans())
def test_values_and_gradients_are_jaxs(seed, causal):
    qkv, mask, weight = inputs(seed)
    real = mask[:, None, :, None]  # what padding rows attend to is nobody's business

    def ours(qkv):
        return jnp.where(real, attend(qkv[0], qkv[1], qkv[2], mask, causal=causal) * weight, 0).sum()

    def theirs(qkv):
        return jnp.where(real, jaxs(qkv, mask, causal) * weight, 0).sum()

    value, grad = jax.value_and_grad(ours)(qkv)
    expected, expected_grad = jax.value_and_grad(theirs)(qkv)
    assert value == pytest.approx(float(expected), rel=1e-4, abs=1e-4)
    assert np.asarray(grad) == pytest.approx(np.asarray(expected_grad), abs=2e-4)


def test_what_padding_holds_makes_no_difference():
    qkv, mask, _ = inputs(0)
    other = jnp.where(mask[None, :, None, :, None], qkv, 1e3)
    real = np.asarray(jnp.broadcast_to(mask[:, None, :, None], qkv.shape[1:]))
    assert np.array_equal(
        np.asarray(attend(qkv[0], qkv[1], qkv[2], mask))[real],
        np.asarray(attend(other[0], other[1], other[2], mask))[real],
    )


def test_an_empty_trace_stays_finite():
    qkv, mask, weight = inputs(1)
    nothing = jnp.zeros_like(mask)
    value, grad = jax.value_and_grad(lambda x: (attend(x[0], x[1], x[2], nothing) * weight).sum())(qkv)
    assert np.isfinite(value)
    assert np.isfinite(np.asarray(grad)).all()
