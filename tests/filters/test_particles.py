"""Particles against enumeration: the posterior of a place and of a type on a grid."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mjx_fit as mf
from mjx_fit.filters import particles, tempering
from mjx_fit.filters.contact_model import Pose, peg_pose, row_logp
from mjx_fit.filters.gaps import bearing_of
from mjx_fit.filters.particle_prior import Prior, prior_of
from mjx_fit.scene.surfaces import surfaces_of
from mjx_fit.types import Belief, Rows

STD, WIDER, MISLED = np.array([0.004, 0.003]), np.array([1.6, 2.0]), 0.3
APART = np.array([0.8, -0.5])
"""Mean of the detection, in units of ``STD`` from that of the belief."""
TRUE, TRUE_TYPE, PEG = np.array([0.004, -0.003]), 1, 2
N_ROWS = 20
THIS = np.array(0.0), np.array(0)  # the believed noise, and the attempt: this one


def of_part(config, i):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf[i]), surfaces_of(config.scene))


@pytest.fixture(scope="module")
def config():
    base = mf.Config()
    few = replace(base.particles, count=2048, moves=4, gap_std_m=0.0005, gap_spread=0.0, misled_chance=MISLED)
    return replace(base, particles=few, pose=base.pose.without_errors())


@pytest.fixture(scope="module")
def rows(config):
    """A tool that rocks and goes around, and touches wherever the geometry lets it."""
    rng, touched = np.random.default_rng(0), []
    for k in range(N_ROWS):
        angle = 2 * np.pi * k / 8
        turn = Rotation.from_rotvec([0.1 * np.cos(angle), 0.1 * np.sin(angle), 0]).as_matrix()
        xy = 0.006 * np.array([np.cos(k), np.sin(k)])
        row = Rows(
            np.append(xy, 0.0), turn, np.array(5.0), np.zeros(2), np.array(0.5), np.array(0.0), np.array(0)
        )
        pose = peg_pose(pose_at(TRUE), row)
        found = bearing_of(pose, of_part(config, PEG), of_part(config, TRUE_TYPE))
        height = -float(found.gap) + 0.0003 * rng.standard_normal()
        pressure = np.array([found.u, found.v]) / float(found.total) + 0.002 * rng.standard_normal(2)
        touched.append(replace(row, tip=np.append(xy, height), pressure=pressure))
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves), jnp.float32), *touched)


def pose_at(place):
    level = jnp.eye(3)
    return Pose(jnp.append(jnp.asarray(place), 0.0), level, jnp.zeros(3), level, jnp.zeros(1), jnp.ones(()))


@pytest.fixture(scope="module")
def prior():
    return Prior(
        jnp.array([0.001, 0.0]),
        jnp.diag(jnp.asarray(STD)),
        jnp.diag(jnp.asarray(WIDER)),
        jnp.asarray(APART),
        jnp.log(jnp.array([0.5, 0.2, 0.3])),
        jnp.asarray(PEG),
    )


def enumerated(config, prior, rows):
    """Mean, covariance and type probabilities on a grid of ±4 σ of the wider Gaussian."""
    axes = [float(m) + s * np.linspace(-4, 4, 97) for m, s in zip(prior.mean, STD * WIDER, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2).astype(np.float32)
    peg, logp = of_part(config, PEG), []
    for kind in range(config.scene.n_types):
        hole = of_part(config, kind)

        def of_place(place, hole=hole):
            one = partial(row_logp, pose_at(place), peg=peg, hole=hole, config=config.particles)
            return jax.vmap(one)(rows).sum()

        logp.append(np.asarray(jax.jit(lambda g, f=of_place: jax.lax.map(f, g, batch_size=64))(grid), float))
    weighed = np.stack(logp) + np.asarray(prior.type_logp)[:, None]
    far = (grid - np.asarray(prior.mean)) / STD
    wide = MISLED * np.exp(-0.5 * (((far - APART) / WIDER) ** 2).sum(1)) / WIDER.prod()
    weighed = weighed + np.log((1 - MISLED) * np.exp(-0.5 * (far**2).sum(1)) + wide)
    chance = np.exp(weighed - weighed.max())
    chance /= chance.sum()
    place = chance.sum(0)
    mean = place @ grid
    return mean, (place[:, None] * (grid - mean)).T @ (grid - mean), chance.sum(1)


def test_the_posterior_is_that_of_enumeration(config, prior, rows):
    mean, cov, chance = enumerated(config, prior, rows)
    assert np.linalg.norm(mean - TRUE) < np.linalg.norm(np.asarray(prior.mean) - TRUE)

    @jax.jit
    def learn(key):
        drawn = particles.drawn(prior, key, config)
        found = particles.conditioned(drawn, prior, rows, 0, key, config)
        return particles.summarised(found, prior, config)

    runs = [learn(jax.random.key(seed)) for seed in range(4)]
    std = np.sqrt(np.diag(cov))
    for run in runs:
        assert np.abs(np.asarray(run.mean_world) - mean).max() < 0.4 * std.max()
    got = jax.tree.map(lambda *leaves: np.mean(np.stack(leaves), 0), *runs)
    np.testing.assert_allclose(got.mean_world, mean, atol=0.2 * std.max())
    np.testing.assert_allclose(np.sqrt(np.diag(got.cov)), std, rtol=0.2)
    np.testing.assert_allclose(np.exp(got.type_logp), chance, atol=0.08)


def test_settling_spreads_particles_that_are_too_close(config, prior, rows):
    _, cov, _ = enumerated(config, prior, rows)
    settles = replace(config, particles=replace(config.particles, settle=8))

    @jax.jit
    def spread(key):
        found = particles.conditioned(particles.drawn(prior, key, config), prior, rows, 0, key, config)
        middle = found.values.mean(0)
        close = replace(found, values=middle + 0.3 * (found.values - middle))
        after = particles.settled(close, prior, rows, key, settles)
        return [particles.summarised(some, prior, config).cov for some in (close, after)]

    close, after = np.mean([spread(jax.random.key(seed)) for seed in range(4)], 0)
    std = np.sqrt(np.diag(cov))
    assert (np.sqrt(np.diag(close)) < 0.5 * std).all()
    np.testing.assert_allclose(np.sqrt(np.diag(after)), std, rtol=0.25)


def test_rows_in_two_parts_give_what_they_give_at_once(config, prior, rows):
    """Those to come have no weight, those that are known are not counted twice."""

    @jax.jit
    def in_parts(key):
        now = particles.drawn(prior, key, config)
        first = replace(rows, weight=jnp.where(jnp.arange(N_ROWS) < 7, rows.weight, 0))
        now = particles.conditioned(now, prior, first, 0, key, config)
        now = particles.conditioned(now, prior, rows, 7, jax.random.fold_in(key, 1), config)
        return particles.summarised(now, prior, config)

    mean, cov, _ = enumerated(config, prior, rows)
    runs = [in_parts(jax.random.key(seed)) for seed in range(3)]
    got = np.mean([run.mean_world for run in runs], 0)
    np.testing.assert_allclose(got, mean, atol=0.3 * np.sqrt(np.diag(cov)).max())


def test_a_row_that_is_not_a_number_does_not_keep_the_others_from_being_read(config, prior, rows):
    """Such as of a simulation that diverged. Rows of weight 0 may hold anything."""
    broken = replace(rows, tip=rows.tip.at[3:5].set(jnp.nan), weight=rows.weight.at[4].set(0))

    @jax.jit
    def learn(key):
        found = particles.conditioned(particles.drawn(prior, key, config), prior, broken, 0, key, config)
        return particles.summarised(found, prior, config)

    mean, cov, _ = enumerated(config, prior, rows)
    got = np.mean([learn(jax.random.key(seed)).mean_world for seed in range(3)], 0)
    np.testing.assert_allclose(got, mean, atol=np.sqrt(np.diag(cov)).max())


def test_without_rows_the_prior_is_the_posterior(config, prior, rows):
    nothing = replace(rows, weight=jnp.zeros(N_ROWS))
    drawn = particles.drawn(prior, jax.random.key(0), config)
    after = particles.conditioned(drawn, prior, nothing, 0, jax.random.key(1), config)
    for old, new in zip(jax.tree.leaves(drawn), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(old, new)
    told = particles.summarised(after, prior, config)
    np.testing.assert_allclose(np.exp(told.type_logp), np.exp(prior.type_logp), atol=1e-3)
    np.testing.assert_allclose(told.mean_world, prior.mean + MISLED * STD * APART, atol=0.05 * STD.max())
    std = STD * np.sqrt(1 - MISLED + MISLED * WIDER**2 + MISLED * (1 - MISLED) * APART**2)
    np.testing.assert_allclose(np.sqrt(np.diag(told.cov)), std, rtol=0.1)


def test_a_prior_knows_the_detection_behind_a_belief():
    rng, config = np.random.default_rng(4), mf.Config()
    half, other = rng.normal(0, 0.003, (2, 2, 2))
    belief = Belief(jnp.array([0.002, 0.001]), jnp.asarray(half @ half.T), jnp.log(jnp.ones(3) / 3))
    first = replace(belief, mean_world=jnp.array([-0.004, 0.006]), cov=jnp.asarray(other @ other.T))
    prior = prior_of(belief, first, jnp.asarray(PEG), config)
    np.testing.assert_allclose(prior.mean + prior.scale @ prior.apart, first.mean_world, atol=1e-7)
    wide = prior.scale @ prior.wide
    np.testing.assert_allclose(wide @ wide.T, first.cov, rtol=1e-3)
    alone = prior_of(belief, None, jnp.asarray(PEG), config)
    np.testing.assert_array_equal(alone.apart, 0)
    detected = config.detector.prior_std_m * np.eye(2)
    np.testing.assert_allclose(prior.scale @ alone.wide, detected, atol=1e-7)


def test_resampling_keeps_shares_and_steps_keep_the_effective_number():
    logp = jnp.asarray(np.random.default_rng(1).normal(0, 30, 500))
    step = tempering.largest_step(logp, jnp.asarray(1.0), 0.4)
    weight = np.asarray(jax.nn.softmax(step * logp), float)
    assert 1 / (weight**2).sum() / 500 == pytest.approx(0.4, abs=0.01)
    kept = np.bincount(tempering.resampled(jnp.asarray(weight), jax.random.key(2)), minlength=500)
    assert (np.abs(kept - 500 * weight) < 1).all()
    assert float(tempering.largest_step(jnp.zeros(500), jnp.asarray(0.3), 0.4)) == pytest.approx(0.3)


def test_moves_leave_a_distribution_as_it_is():
    """A ridge with two modes, from exact draws: shares and moments stay, whatever the reference is."""
    rng = np.random.default_rng(3)

    def logp(values):
        x, y = values[:, 0], values[:, 1]
        return jnp.logaddexp(-0.5 * (x - 2) ** 2, -0.5 * (x + 2) ** 2 + jnp.log(3.0)) - 2 * (y - x) ** 2

    x = np.where(rng.random(4000) < 0.25, 2.0, -2.0) + rng.standard_normal(4000)
    exact = np.column_stack([x, x + 0.5 * rng.standard_normal(4000)])
    reference = tempering.reference_of(jnp.asarray(exact[:200] + np.array([0.3, 0.0])))

    def move(values, key):
        of_move, of_choice = jax.random.split(key)
        asked, ratio = tempering.proposed(values, reference, of_move)
        gain = logp(asked) - logp(values) + ratio
        taken = jnp.log(jax.random.uniform(of_choice, gain.shape)) < gain
        return jnp.where(taken[:, None], asked, values), taken.mean()

    start = jnp.asarray(exact, jnp.float32)
    after, taken = jax.jit(partial(jax.lax.scan, move))(start, jax.random.split(jax.random.key(0), 60))
    assert float(taken.mean()) > 0.2
    assert float(jnp.abs(after - start).mean()) > 0.5
    assert float((after[:, 0] > 0).mean()) == pytest.approx((x > 0).mean(), abs=0.04)
    np.testing.assert_allclose(np.cov(after.T), np.cov(exact.T), rtol=0.1)


def test_crank_nicolson_takes_its_own_gaussian_with_certainty():
    values = jax.random.normal(jax.random.key(0), (1000, 3)) @ jnp.array([[1, 0, 0], [2, 1, 0], [0, 1, 3.0]])
    reference = tempering.reference_of(values)
    asked, ratio = tempering.proposed(values, reference, jax.random.key(1))
    cov = np.linalg.inv(np.cov(values.T, bias=True) + 1e-5 * np.eye(3))

    def logq(at):
        away = np.asarray(at, float) - np.asarray(values.mean(0))
        return -0.5 * np.einsum("ni,ij,nj->n", away, cov, away)

    by_differences = np.asarray(ratio) == 0
    assert 0.1 < by_differences.mean() < 0.3
    gain = (logq(asked) - logq(values) + np.asarray(ratio))[~by_differences]
    np.testing.assert_allclose(gain, 0, atol=2e-3)
