"""Coordinates of places against SciPy's rotations, and Gaussians in tangent spaces against samples."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mjx_fit.config.sections.filter import COORDINATES
from mjx_fit.filters import chart

ALL = COORDINATES
TURNS = [ALL.index(name) for name in ("roll", "pitch", "yaw")]
subsets = st.sets(st.sampled_from(ALL[2:])).map(lambda more: (*ALL[:2], *(n for n in ALL[2:] if n in more)))
seeds = st.integers(0, 2**32 - 1)


def places(seed: int, coordinates: tuple[str, ...], *batch: int, size: float = 0.5) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-size, size, (*batch, len(coordinates)))


@pytest.fixture(autouse=True)
def in_double():
    with jax.enable_x64(True):
        yield


@given(seeds)
def test_six_coordinates_are_positions_and_rotations_of_scipy(seed):
    place, step = places(seed, ALL, 2)
    found = np.asarray(chart.moved(jnp.asarray(place), jnp.asarray(step), ALL))
    want = Rotation.from_rotvec(step[TURNS]) * Rotation.from_rotvec(place[TURNS])
    np.testing.assert_allclose(found[TURNS], want.as_rotvec(), atol=1e-9)
    np.testing.assert_allclose(found[:3], place[:3] + step[:3], atol=1e-12)


@given(subsets, seeds)
def test_a_step_leads_from_one_place_to_the_other(coordinates, seed):
    """With two rotations the third axis is dropped, an error of second order."""
    one, other = places(seed, coordinates, 2, 4, size=0.1)
    step = chart.step_between(jnp.asarray(one), jnp.asarray(other), coordinates)
    turns = len({"yaw", "roll", "pitch"} & set(coordinates))
    back = chart.moved(jnp.asarray(one), step, coordinates)
    np.testing.assert_allclose(back, other, atol=1e-9 if turns != 2 else 2e-3)


@given(seeds)
def test_x_and_y_are_plain_numbers(seed):
    one, other = map(jnp.asarray, places(seed, ALL[:2], 2))
    np.testing.assert_array_equal(chart.moved(one, other, ALL[:2]), one + other)
    np.testing.assert_array_equal(chart.step_between(one, other, ALL[:2]), other - one)
    np.testing.assert_array_equal(chart.turned_basis(one, ALL[:2]), np.eye(2))


def test_a_carried_covariance_is_that_of_samples():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(6, 6))
    cov = 1e-4 * (a @ a.T + np.eye(6))
    step = places(1, ALL, size=0.8)
    errors = rng.multivariate_normal(np.zeros(6), cov, 200_000)
    start = jnp.asarray(places(2, ALL))
    end = chart.moved(start, jnp.asarray(step), ALL)
    reached = chart.moved(start, jnp.asarray(step + errors), ALL)
    off = np.asarray(chart.step_between(end, reached, ALL))
    basis = np.asarray(chart.turned_basis(jnp.asarray(step), ALL))
    carried = basis @ cov @ basis.T
    unit = np.sqrt(np.outer(np.diag(carried), np.diag(carried)))
    np.testing.assert_allclose(np.cov(off.T) / unit, carried / unit, atol=0.02)
    assert np.abs(carried - cov).max() > 0.1 * cov.max()


def test_a_batch_is_its_members():
    coordinates = ("x", "y", "yaw", "roll", "pitch")
    step = jnp.asarray(places(3, coordinates, 4))
    together = chart.turned_basis(step, coordinates)
    for row in range(4):
        np.testing.assert_allclose(together[row], chart.turned_basis(step[row], coordinates), atol=1e-12)
