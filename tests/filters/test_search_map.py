"""Maps of what was searched in vain, against enumeration, and the starts of later visits that follow."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mjx_fit.config.sections.filter import FilterConfig
from mjx_fit.filters import search_map
from mjx_fit.types import Belief

CONFIG = FilterConfig(capture_m=0.0009, capture_chance=0.7)
CENTRE, COV = np.array([0.5, 0.1]), np.array([[9e-6, 2e-6], [2e-6, 6e-6]])


@pytest.fixture(scope="module")
def begun():
    return jax.jit(search_map.begun)(jnp.asarray(CENTRE), jnp.asarray(COV))


@pytest.fixture(scope="module")
def path():
    """A walk over the map, partly in the air."""
    rng = np.random.default_rng(0)
    walk = CENTRE + np.cumsum(rng.normal(0, 0.0008, (40, 2)), 0)
    return walk, np.arange(40) % 11 < 8


def missed(before, path):
    walk, contact = path
    step = jax.jit(search_map.missed, static_argnums=3)
    return step(before, jnp.asarray(walk), jnp.asarray(contact), CONFIG)


def test_a_map_begins_with_the_detection(begun):
    cells = np.asarray(begun.cells_world, float).reshape(-1, 2)
    density = multivariate_normal(CENTRE, cov=COV.tolist()).pdf(cells)
    np.testing.assert_allclose(np.exp(begun.logp).ravel(), density / density.sum(), rtol=2e-3, atol=1e-9)


def test_a_visit_in_vain_multiplies_by_what_it_would_have_missed(begun, path):
    """Against a loop over cells and finely drawn segments: only those with both ends in contact count."""
    walk, contact = path
    after = np.exp(np.asarray(missed(begun, path).logp, float)).ravel()
    cells, width = np.asarray(begun.cells_world, float).reshape(-1, 2), CONFIG.capture_m
    share = np.linspace(0, 1, 4)[:, None]
    points = np.concatenate(
        [walk[k] + share * (walk[k + 1] - walk[k]) for k in range(39) if contact[k] and contact[k + 1]]
    )
    want = np.exp(np.asarray(begun.logp, float)).ravel()
    for i, cell in enumerate(cells):
        away = np.min(np.sum((points - cell) ** 2, 1))
        want[i] *= 1 - CONFIG.capture_chance * np.exp(-away / (2 * width**2))
    np.testing.assert_allclose(after, want / want.sum(), rtol=5e-3, atol=1e-9)


@pytest.mark.parametrize("misled", [0.01, 0.5])
def test_what_was_felt_counts_by_the_chance_that_it_misled(begun, misled):
    """Against the densities: a mixture of the map and of the map times the ratio of the beliefs."""
    config = FilterConfig(misled_chance=misled)
    prior, posterior = (
        Belief(jnp.asarray(mean), jnp.asarray(cov), jnp.zeros(3))
        for mean, cov in ((CENTRE, COV), (CENTRE + np.array([0.002, -0.003]), COV / 3))
    )
    after = jax.jit(search_map.felt, static_argnums=3)(begun, prior, posterior, config)
    cells, p = np.asarray(begun.cells_world, float), np.exp(np.asarray(begun.logp, float))
    of_prior, of_posterior = (
        multivariate_normal(one.pos_mean_world, cov=np.asarray(one.pos_cov).tolist()).pdf(cells)
        for one in (prior, posterior)
    )
    ratio = of_posterior / of_prior
    want = misled * p + (1 - misled) * p * ratio / (p * ratio).sum()
    np.testing.assert_allclose(np.exp(after.logp), want, rtol=5e-3, atol=1e-9)


def test_a_belief_that_did_not_change_tells_nothing(begun):
    same = Belief(jnp.asarray(CENTRE), jnp.asarray(COV), jnp.zeros(3))
    after = search_map.felt(begun, same, same, CONFIG)
    np.testing.assert_allclose(after.logp, begun.logp, atol=1e-5)


def test_a_peg_that_never_touched_has_searched_nothing(begun, path):
    after = missed(begun, (path[0], np.zeros(40, bool)))
    np.testing.assert_allclose(after.logp, begun.logp, atol=1e-5)


def test_the_best_place_is_the_disc_with_most_probability(begun, path):
    rough = missed(missed(begun, path), path)
    reach, cells = 0.0015, np.asarray(rough.cells_world, float).reshape(-1, 2)
    p = np.exp(np.asarray(rough.logp, float)).ravel()
    mass = np.array([p[np.sum((cells - cell) ** 2, 1) <= reach**2].sum() for cell in cells])
    best = np.asarray(jax.jit(search_map.best_place)(rough, reach), float)
    found = mass[np.sum((cells - best) ** 2, 1).argmin()]
    assert found == pytest.approx(mass.max(), rel=1e-3)
    assert np.linalg.norm(best - CENTRE) > 0.0005


def test_before_any_visit_the_best_place_is_the_detection(begun):
    round_one = search_map.begun(jnp.asarray(CENTRE), 4e-6 * jnp.eye(2))
    np.testing.assert_allclose(search_map.best_place(round_one, 0.002), CENTRE, atol=1e-6)
