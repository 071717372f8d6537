"""The joint filter of grasp and holes against the dense Gaussian, conditioned on all readings at once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjx_fit.config.sections.filter import COORDINATES
from mjx_fit.filters import chart, joint, kalman

N, D = 3, 3
PLANE = ("x", "y", "z")
"""Coordinates without rotations: there the model is linear, and the oracle exact."""


@pytest.fixture(autouse=True)
def in_double():
    with jax.enable_x64(True):
        yield


def spd(rng: np.random.Generator, *batch: int) -> np.ndarray:
    a = rng.normal(size=(*batch, D, D))
    return a @ np.swapaxes(a, -1, -2) + 0.1 * np.eye(D)


def prior(rng: np.random.Generator) -> tuple[joint.Joint, np.ndarray, np.ndarray]:
    mean, covs, grasp = rng.normal(size=(N, D)), spd(rng, N), spd(rng)
    dense = np.zeros(((N + 1) * D, (N + 1) * D))
    for i, block in enumerate([grasp, *covs]):
        dense[i * D : (i + 1) * D, i * D : (i + 1) * D] = block
    made = joint.independent(jnp.asarray(mean), jnp.asarray(covs), jnp.asarray(grasp))
    return made, np.concatenate([np.zeros(D), mean.ravel()]), dense


def observe(made: joint.Joint, hole, innovation, noise_cov, coordinates) -> joint.Joint:
    """Update the belief at a hole with a reading, and carry it to all parts."""
    mean, cov = joint.relative_to_peg(made, hole, coordinates)
    step, after = kalman.update(jnp.zeros_like(mean), cov, innovation, noise_cov)
    return joint.learnt_at(made, hole, chart.moved(mean, step, coordinates), after, coordinates)


def expected(made: joint.Joint, hole: int) -> np.ndarray:
    return np.asarray(made.mean_world[hole + 1] - made.mean_world[0])


@given(st.lists(st.integers(0, N - 1), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_readings_one_by_one_are_the_dense_gaussian_conditioned_on_all(holes, seed):
    rng = np.random.default_rng(seed)
    made, mean, cov = prior(rng)
    readings, noises = rng.normal(size=(len(holes), D)), spd(rng, len(holes))
    for hole, reading, noise in zip(holes, readings, noises, strict=True):
        innovation = jnp.asarray(reading - expected(made, hole))
        made = observe(made, jnp.asarray(hole), innovation, jnp.asarray(noise), PLANE)
    model = np.zeros((len(holes) * D, len(mean)))
    noise = np.zeros((len(holes) * D,) * 2)
    for k, hole in enumerate(holes):
        rows = slice(k * D, (k + 1) * D)
        model[rows, :D], model[rows, (hole + 1) * D : (hole + 2) * D] = -np.eye(D), np.eye(D)
        noise[rows, rows] = noises[k]
    gain = cov @ model.T @ np.linalg.inv(model @ cov @ model.T + noise)
    want = mean + gain @ (readings.ravel() - model @ mean)
    np.testing.assert_allclose(made.mean_world.ravel(), want, rtol=1e-7, atol=1e-7)
    size = len(mean)
    np.testing.assert_allclose(made.cov.reshape(size, size), cov - gain @ model @ cov, rtol=1e-6, atol=1e-7)


@given(st.integers(0, N - 1), st.integers(0, 2**32 - 1))
def test_what_was_learnt_at_a_hole_is_what_is_believed_there(hole, seed):
    rng = np.random.default_rng(seed)
    made = prior(rng)[0]
    # Readings before make the blocks dependent.
    for other in range(N):
        earlier, rough = jnp.asarray(rng.normal(size=D)), jnp.asarray(0.3 * spd(rng))
        made = observe(made, jnp.asarray(other), earlier, rough, PLANE)
    reading, noise = jnp.asarray(rng.normal(size=D)), jnp.asarray(spd(rng))
    mean, cov = joint.relative_to_peg(made, jnp.asarray(hole), PLANE)
    alone = kalman.update(mean, cov, reading, noise)
    found = joint.learnt_at(made, jnp.asarray(hole), alone[0], alone[1], PLANE)
    again = joint.relative_to_peg(found, jnp.asarray(hole), PLANE)
    np.testing.assert_allclose(again[0], alone[0], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(again[1], alone[1], rtol=1e-6, atol=1e-8)


def test_a_belief_that_widens_at_a_hole_widens_the_grasp():
    """The gate may make a belief less certain: the others then are, too, and stay positive definite."""
    made = prior(np.random.default_rng(0))[0]
    mean, cov = joint.relative_to_peg(made, jnp.asarray(0), PLANE)
    wider = joint.learnt_at(made, jnp.asarray(0), mean, 4 * cov, PLANE)
    np.testing.assert_allclose(wider.mean_world, made.mean_world, atol=1e-12)
    assert np.trace(wider.cov[0, :, 0]) > np.trace(made.cov[0, :, 0])
    np.testing.assert_allclose(wider.cov[2, :, 2], made.cov[2, :, 2], atol=1e-12)
    size = (N + 1) * D
    assert np.linalg.eigvalsh(wider.cov.reshape(size, size)).min() > 0


@given(st.integers(0, 2**32 - 1))
def test_without_a_grasp_each_hole_is_filtered_alone(seed):
    rng = np.random.default_rng(seed)
    mean, covs, noise = rng.normal(size=(N, D)), spd(rng, N), spd(rng)
    made = joint.independent(jnp.asarray(mean), jnp.asarray(covs), jnp.zeros((D, D)))
    innovation = rng.normal(size=D)
    after = observe(made, jnp.asarray(1), jnp.asarray(innovation), jnp.asarray(noise), PLANE)
    own = kalman.update(*map(jnp.asarray, (mean[1], covs[1], innovation, noise)))
    np.testing.assert_allclose(after.mean_world[2], own[0], rtol=1e-9)
    np.testing.assert_allclose(after.cov[2, :, 2], own[1], rtol=1e-9)
    np.testing.assert_array_equal(
        after.mean_world[jnp.array([0, 1, 3])], made.mean_world[jnp.array([0, 1, 3])]
    )


def test_what_is_felt_at_one_hole_corrects_the_next_until_the_peg_changes():
    sure, unsure = 1e-6 * np.eye(D), np.eye(D)
    made = joint.independent(jnp.zeros((N, D)), jnp.asarray(np.stack([sure] * N)), jnp.asarray(unsure))
    displaced = jnp.array([0.4, -0.3, 0.1])  # of the peg in the hand: holes seem to be the other way
    after = observe(made, jnp.asarray(0), -displaced, jnp.asarray(1e-6 * np.eye(D)), PLANE)
    mean, cov = joint.relative_to_peg(after, jnp.asarray(2), PLANE)
    np.testing.assert_allclose(mean, -displaced, atol=1e-5)
    assert np.diag(cov).max() < 1e-5
    renewed = joint.with_new_peg(after, jnp.asarray(unsure))
    mean, cov = joint.relative_to_peg(renewed, jnp.asarray(2), PLANE)
    np.testing.assert_allclose(mean, 0, atol=1e-5)
    np.testing.assert_allclose(cov, unsure, atol=1e-5)


@pytest.mark.slow
def test_a_batch_with_rotations_is_its_members():
    rng, d = np.random.default_rng(0), len(COORDINATES)
    covs = 0.01 * np.tile(np.eye(d), (4, N, 1, 1))
    made = joint.independent(jnp.asarray(rng.normal(0, 0.1, (4, N, d))), jnp.asarray(covs), 0.01 * jnp.eye(d))
    holes, innovations = jnp.array([0, 1, 2, 0]), jnp.asarray(rng.normal(0, 0.1, (4, d)))
    noise = 0.001 * jnp.eye(d)
    together = observe(made, holes, innovations, noise, COORDINATES)
    for row in range(4):
        one = jax.tree.map(lambda leaf, row=row: leaf[row], made)
        alone = observe(one, holes[row], innovations[row], noise, COORDINATES)
        np.testing.assert_allclose(together.mean_world[row], alone.mean_world, atol=1e-12)
        np.testing.assert_allclose(together.cov[row], alone.cov, atol=1e-12)
