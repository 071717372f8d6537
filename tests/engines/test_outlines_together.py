"""Outlines of several parts in one scene, padded to the same number of sides."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.engines.mjx import outlines
from mjx_fit.engines.mjx.outline_contact import touching_points
from mjx_fit.scene.outline import peg_outline

NIST = read_config(parts_file("nist")).scene


def standing(part, n=8):
    """Contact points of a peg that stands flat on the plate beside the hole, 20 um deep: x, y of each."""
    worlds_last = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, n)), part)
    pos = jnp.broadcast_to(jnp.array([0.05, 0.0, NIST.peg_length_m - 2e-5])[:, None], (3, n))
    frame = jnp.broadcast_to(jnp.diag(jnp.array([1.0, -1.0, -1.0]))[..., None], (3, 3, n))
    found = jax.jit(touching_points, static_argnums=4)(*worlds_last, pos, frame, 24)
    return np.asarray(found.pos_plate)[np.asarray(found.dist)[:, 0] < 0, :2, 0]


@pytest.mark.slow
def test_a_part_stands_on_as_many_points_among_others_as_alone():
    """In a scene of several parts all outlines have the same number of sides, most of them spare ones."""
    together = outlines.outlines_of(NIST)
    for i, shape in enumerate(NIST.shapes):
        alone = outlines.outlines_of(replace(NIST, shapes=(shape,)))
        one, among = (
            standing(jax.tree.map(lambda x, at=at: x[at], tree))
            for tree, at in ((alone, 0), (together, i * (NIST.n_types + 1)))
        )
        reach = peg_outline(shape, NIST).bounds[2]
        for points in (one, among):
            sides = np.sign(points - [0.05, 0])
            assert {tuple(side) for side in sides[np.abs(points - [0.05, 0]).min(1) > 0.05 * reach]} == {
                (1, 1),
                (1, -1),
                (-1, 1),
                (-1, -1),
            }, shape.name
        if len(one) <= 4:
            np.testing.assert_allclose(np.sort(among, 0), np.sort(one, 0), atol=1e-7)
        else:
            assert 12 <= len(among) <= 24
