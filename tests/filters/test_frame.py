"""Frames of estimates against SciPy's rotations, and beliefs seen in them against samples."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mjx_fit.config.sections.filter import COORDINATES
from mjx_fit.filters import chart, frame
from mjx_fit.types import Belief, Observation

TURNS = [COORDINATES.index(name) for name in ("roll", "pitch", "yaw")]
TOP_M = 0.04
SUBSETS = [("x", "y"), ("x", "y", "z"), ("x", "y", "yaw"), COORDINATES]
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(autouse=True)
def in_double():
    with jax.enable_x64(True):
        yield


def belief_of(rng: np.random.Generator, d: int) -> Belief:
    root = 0.02 * rng.normal(size=(d, d))
    return Belief(rng.uniform(-0.3, 0.3, d), root @ root.T + 1e-5 * np.eye(d), np.log([0.5, 0.5]))


@given(seeds)
def test_points_are_seen_as_if_the_socket_were_upright_at_nominal_height(seed):
    rng = np.random.default_rng(seed)
    place, point = rng.uniform(-0.5, 0.5, 6), rng.uniform(-0.5, 0.5, 3)
    here = frame.frame_of(jnp.asarray(place), COORDINATES)
    turn = Rotation.from_rotvec(place[TURNS])
    want = turn.inv().apply(point - np.array([*place[:2], TOP_M + place[2]])) + np.array([*place[:2], TOP_M])
    np.testing.assert_allclose(here.seen(jnp.asarray(point), TOP_M), want, atol=1e-12)
    np.testing.assert_allclose(here.world(here.seen(jnp.asarray(point), TOP_M), TOP_M), point, atol=1e-12)


@pytest.mark.parametrize("coordinates", SUBSETS)
@given(seed=seeds)
def test_a_belief_comes_back_from_any_frame(coordinates, seed):
    rng = np.random.default_rng(seed)
    before, estimate = belief_of(rng, len(coordinates)), rng.uniform(-0.3, 0.3, len(coordinates))
    seen = frame.belief_in_frame(before, jnp.asarray(estimate), coordinates)
    after = frame.belief_in_world(seen, jnp.asarray(estimate), coordinates)
    np.testing.assert_allclose(after.mean_world, before.mean_world, atol=1e-9)
    np.testing.assert_allclose(after.cov, before.cov, atol=1e-12)


def test_the_estimate_itself_is_upright_in_its_frame():
    place = jnp.array([0.4, 0.1, 0.003, 0.2, -0.1, 0.05])
    belief = Belief(place, 1e-4 * jnp.eye(6), jnp.log(jnp.ones(3) / 3))
    seen = frame.belief_in_frame(belief, place, COORDINATES)
    np.testing.assert_allclose(seen.mean_world, [0.4, 0.1, 0, 0, 0, 0], atol=1e-12)


def test_a_belief_in_a_frame_has_the_spread_of_samples_seen_there():
    rng = np.random.default_rng(0)
    belief, estimate = belief_of(rng, 6), rng.uniform(-0.3, 0.3, 6)
    belief = replace(belief, cov=belief.cov * 1e-3)
    steps = jnp.asarray(rng.multivariate_normal(np.zeros(6), belief.cov, 20_000))
    places = chart.moved(jnp.asarray(belief.mean_world), steps, COORDINATES)
    turn = Rotation.from_rotvec(estimate[TURNS]).inv()
    offset = turn.apply(np.asarray(places)[:, :3] - estimate[:3])
    rotations = turn * Rotation.from_rotvec(np.asarray(places)[:, TURNS])
    seen = frame.belief_in_frame(belief, jnp.asarray(estimate), COORDINATES)
    mean = Rotation.from_rotvec(np.asarray(seen.mean_world)[TURNS])
    spread = np.concatenate([offset, (rotations * mean.inv()).as_rotvec()[:, [2, 0, 1]]], 1)
    scale = np.sqrt(np.diag(seen.cov))
    np.testing.assert_allclose(
        np.cov(spread.T) / scale / scale[:, None], seen.cov / scale / scale[:, None], atol=0.03
    )
    np.testing.assert_allclose(
        offset.mean(0) + np.array([*estimate[:2], 0]), np.asarray(seen.mean_world)[:3], atol=1e-4
    )


def test_an_observation_turns_with_the_socket():
    """Felt 1 mm along the x axis of a socket turned by 90°: the step in the world is along y, and R turns."""
    estimate = jnp.array([0.4, 0.0, np.pi / 2])
    told = Observation(
        jnp.array([0.001, 0, 0.1]), jnp.diag(jnp.array([4.0, 1, 9])), jnp.zeros(2), jnp.zeros((3, 2))
    )
    found = frame.observation_in_world(told, estimate, ("x", "y", "yaw"))
    np.testing.assert_allclose(found.innovation, [0, 0.001, 0.1], atol=1e-12)
    np.testing.assert_allclose(found.pos_noise_cov, np.diag([1, 4, 9]), atol=1e-12)
    assert frame.observation_in_world(told, estimate[:2], ("x", "y")) is told
