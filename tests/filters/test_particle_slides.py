"""Moves of particles along the plate: what was felt of it stays, and places that are far apart are found."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.filters import particles
from mjx_fit.filters.contact_model import peg_pose
from mjx_fit.filters.gaps import bearing_of
from mjx_fit.filters.particle_prior import dimensions, drawn_values, prior_of, slid
from mjx_fit.filters.updates import detected_belief
from mjx_fit.scene.surfaces import surfaces_of
from mjx_fit.types import Rows

N = 64


@pytest.fixture(scope="module")
def config():
    whole = read_config(world_file("bench"))
    return replace(whole, particles=replace(whole.particles, count=256))


@pytest.fixture(scope="module")
def prior(config):
    return jax.tree.map(
        jnp.asarray, prior_of(detected_belief(jnp.zeros(2), config), None, jnp.int32(1), config)
    )


def of_part(config, i):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf[i]), surfaces_of(config.scene))


def test_a_slide_leaves_the_plate_where_it_is(config, prior):
    """Gaps of a peg on the plate, far from the hole before and after, by the exact model of contact."""
    values = drawn_values(prior, N, dimensions(config), jax.random.key(0), config)
    after = slid(values, prior, jax.random.key(1), config)
    steps = (np.asarray(after) - np.asarray(values))[:, :6] @ np.asarray(prior.scale).T
    assert np.hypot(*steps[:, :2].T).max() > 0.02
    np.testing.assert_array_equal(after[:, 3:], values[:, 3:])  # what is turned stays, and the errors
    part = of_part(config, 1)

    @jax.jit
    @jax.vmap
    def gap(value):
        level = jnp.eye(3)
        row = Rows(jnp.array([0.2, 0.15, 0.01]), level, jnp.array(5.0), *[jnp.zeros(())] * 4)
        return bearing_of(peg_pose(particles._pose(value, prior, config), row), part, part).gap

    old, new = (np.asarray(gap(one)) for one in (values, after))
    level = values.at[:, 2].add(0)  # without following the slope the height would be that of before
    flat = jnp.asarray(after).at[:, 2].set(level[:, 2])
    assert np.std(old) > 0.005
    assert np.abs(new - old).max() < 0.0006
    assert np.abs(np.asarray(gap(flat)) - old).max() > 0.003


def test_slides_are_symmetric(config, prior):
    """A step and its opposite are as probable, and the second one takes the first one back."""
    values = jnp.tile(drawn_values(prior, 1, dimensions(config), jax.random.key(0), config), (4000, 1))
    steps = np.asarray(slid(values, prior, jax.random.key(2), config) - values)[:, :3]
    spread = np.abs(steps).mean(0)
    assert (np.abs(np.median(steps, 0)) < 0.05 * spread).all()
    slope = np.linalg.lstsq(steps[:, :2], steps[:, 2], rcond=None)
    assert slope[1].item() < 1e-6  # a plane: heights are odd in the step


@pytest.mark.slow
def test_a_hole_far_across_the_plate_is_found(config, prior):
    """A peg that goes to and fro on a plate and dips into the hole at one end of its way."""
    true, part = np.array([0.012, 0.016, 0.001, 0.0, 0.03, -0.02]), of_part(config, 1)
    value = np.zeros(dimensions(config), np.float32)
    value[:6] = np.linalg.solve(np.asarray(prior.scale), true)
    rows = []
    for k in range(60):
        share, turn = k / 59, Rotation.from_rotvec(0.1 * np.array([np.cos(k), np.sin(k), 0])).as_matrix()
        xy = (1 - share) * np.array([-0.02, -0.015]) + share * np.array([0.013, 0.014])
        at = Rows(jnp.append(xy, 0.0), jnp.asarray(turn), jnp.array(5.0), *[jnp.zeros(())] * 4)
        found = bearing_of(peg_pose(particles._pose(jnp.asarray(value), prior, config), at), part, part)
        pressure = jnp.stack([found.u, found.v]) / found.total
        tip = jnp.append(xy, -found.gap)
        rows.append(Rows(tip, at.turn, at.press, pressure, jnp.array(0.45), jnp.zeros(()), jnp.array(0)))
    rows = jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows)

    @jax.jit
    def learn(key):
        drawn = particles.drawn(prior, key, config)
        found = particles.conditioned(drawn, prior, rows, 0, key, config)
        return particles.steps_of(found, prior).mean(0)

    errors = [np.linalg.norm(np.asarray(learn(jax.random.key(seed)))[:2] - true[:2]) for seed in range(4)]
    assert max(errors) < 0.006
