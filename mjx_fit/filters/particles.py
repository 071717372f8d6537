"""Particle filter for the place and the type of a hole, by the geometry of contact.

Particles are drawn from the belief before an attempt and conditioned on its rows by sequential Monte Carlo
with tempering (Del Moral, Doucet and Jasra, 2006): the likelihood of new rows is raised to exponents that
grow to 1, each as large as the particles' weights allow; after each they are resampled and moved by
differential evolution (ter Braak, 2006), whose steps are differences between particles, so that they follow
ridges and pass between modes.

A particle is a vector of independent standard normals before the attempt: one for each believed coordinate,
six for the grasp where it varies, one for the error of heights and one for the logarithm of the noise.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxlie import SO3
from jaxtyping import Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.particles import ParticlesConfig
from mjx_fit.filters import chart, tempering
from mjx_fit.filters.contact_model import Pose, Rows, row_logp
from mjx_fit.filters.kalman import scale_tril
from mjx_fit.scene.surfaces import surfaces_of
from mjx_fit.types import Array, Belief, pytree

_RETYPED = 0.2
"""Share of moves that draw the type as well."""
_AT_ONCE, _CHUNK = 128, 10
"""Particles and rows whose likelihood is computed at once: as much as fits a processor's cache."""
_Likelihood = Callable[["Particles"], Float[Array, "N 2"]]


@pytree
class Prior:
    """Belief before an attempt, in the frame of its estimate.

    Attributes:
        mean: Mean step from the estimate, m and rad.
        scale: Cholesky factor of its covariance.
        type_logp: Log probability of each type.
        peg_type: Type of the peg in hand.
    """

    mean: Float[Array, "D"]
    scale: Float[Array, "D D"]
    type_logp: Float[Array, "C"]
    peg_type: Int[Array, ""]


@pytree
class Particles:
    """Particles, all of equal weight.

    Attributes:
        values: Standard normals of each particle before the attempt.
        types: Type of the hole.
    """

    values: Float[Array, "N d"]
    types: Int[Array, "N"]


_State = tuple[Particles, Float[Array, "N 2"]]
"""Particles, and the log likelihoods of their known rows and of the new ones."""


def prior_of(belief: Belief, peg_type: Int[Array, ""]) -> Prior:
    """Return the prior of a belief that is relative to an estimate (``mjx_fit.filters.frame``)."""
    return Prior(belief.mean_world, scale_tril(belief.cov), belief.type_logp, peg_type)


def drawn(prior: Prior, key: Key[Array, ""], config: Config) -> Particles:
    """Draw particles from a prior; the shares of types are as exact as their number allows."""
    count, own = config.particles.count, config.particles
    at, of_values = jax.random.split(key)
    d = prior.mean.shape[-1] + 6 * _grasp_varies(own) + 2
    share = (jax.random.uniform(at) + jnp.arange(count)) / count
    below = jnp.cumsum(jax.nn.softmax(prior.type_logp))
    types = jnp.minimum(jnp.searchsorted(below, share), config.scene.n_types - 1)
    return Particles(jax.random.normal(of_values, (count, d)), types)


def conditioned(
    particles: Particles,
    prior: Prior,
    rows: Rows,
    known: Int[Array, ""] | int,
    key: Key[Array, ""],
    config: Config,
) -> Particles:
    """Condition particles on new rows.

    Args:
        particles: Particles after the rows before; from ``drawn`` before any.
        prior: Belief before the attempt.
        rows: All rows so far, old and new; those of weight 0 do not count.
        known: Number of rows that the particles know already.
        key: Random key.
        config: Defines the filter and the parts.
    """
    own, logp = config.particles, _likelihood(prior, rows, known, config)

    def temper(state):
        particles, old_new, beta, key = state
        key, to_resample, to_move = jax.random.split(key, 3)
        step = tempering.largest_step(old_new[:, 1], 1 - beta, own.least_share)
        weight, beta = jax.nn.softmax(step * old_new[:, 1]), jnp.where(step < 1 - beta, beta + step, 1.0)
        kept = tempering.resampled(weight, to_resample)
        state = jax.tree.map(lambda leaf: leaf[kept], (particles, old_new))
        move = partial(_moved, logp=logp, beta=beta, prior=prior)
        state, _ = jax.lax.scan(move, state, jax.random.split(to_move, own.moves))
        return *state, beta, key

    is_new = (jnp.arange(len(rows.weight)) >= known) & (rows.weight > 0)
    begun = jnp.where(is_new.any(), 0.0, 1.0)
    state = particles, logp(particles), begun, key
    return jax.lax.while_loop(lambda state: state[2] < 1, temper, state)[0]


def summarised(particles: Particles, prior: Prior, config: Config) -> Belief:
    """Return mean and covariance of the steps from the estimate, and the probabilities of types.

    No type is ruled out: with N particles, probabilities are those of one particle more, of the prior.
    """
    d, count = prior.mean.shape[-1], len(particles.types)
    steps = prior.mean + particles.values[:, :d] @ prior.scale.T
    mean = steps.mean(0)
    away = steps - mean
    floor = np.square([_least_std(name, config) for name in config.filter.coordinates])
    share = jnp.zeros_like(prior.type_logp).at[particles.types].add(1.0)
    chance = (share + jax.nn.softmax(prior.type_logp)) / (count + 1)
    cov = away.T @ away / count + jnp.diag(jnp.asarray(floor, jnp.float32))
    return Belief(mean, cov, jnp.log(chance))


def _least_std(name: str, config: Config) -> float:
    """Return the error of measured poses that is constant in an attempt, which no row can tell."""
    if name in chart.AXIS:
        return config.pose.rotation_offset_rad + 1e-4
    return config.pose.position_offset_m + 1e-5 if name in ("x", "y") else 1e-5


def _likelihood(prior: Prior, rows: Rows, known: Int[Array, ""] | int, config: Config) -> _Likelihood:
    """Return the function from particles to the log likelihoods of the known rows and of the others.

    Rows that are still to come take no time: those that count are read in chunks.
    """
    surfaces = jax.tree.map(jnp.asarray, surfaces_of(config.scene))
    peg = jax.tree.map(lambda leaf: leaf[prior.peg_type], surfaces)
    rows = jax.tree.map(lambda leaf: _padded(leaf, _CHUNK), rows)
    read = jnp.where(rows.weight > 0, jnp.arange(len(rows.weight)) + 1, 0).max()
    chunks = (read + _CHUNK - 1) // _CHUNK

    def one(value: Float[Array, "d"], kind: Int[Array, ""]) -> Float[Array, "2"]:
        hole, pose = jax.tree.map(lambda leaf: leaf[kind], surfaces), _pose(value, prior, config)

        def chunk(i: Int[Array, ""], found: Float[Array, "2"]) -> Float[Array, "2"]:
            at = i * _CHUNK
            part = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, at, _CHUNK), rows)
            logp = jax.vmap(lambda row: row_logp(pose, row, peg, hole, config.particles))(part)
            old = at + jnp.arange(_CHUNK) < known
            return found + jnp.stack([jnp.where(old, logp, 0).sum(), jnp.where(old, 0, logp).sum()])

        return jax.lax.fori_loop(0, chunks, chunk, jnp.zeros(2))

    def logp(particles: Particles) -> Float[Array, "N 2"]:
        values = particles.values, particles.types
        return jax.lax.map(lambda one_of: one(*one_of), values, batch_size=_AT_ONCE)

    return logp


def _padded(leaf: Float[Array, "L *n"], chunk: int) -> Float[Array, "M *n"]:
    """Return the rows of a leaf, and zeros up to a multiple of a chunk."""
    return jnp.pad(leaf, [(0, -len(leaf) % chunk)] + [(0, 0)] * (leaf.ndim - 1))


def _pose(value: Float[Array, "d"], prior: Prior, config: Config) -> Pose:
    d, own, names = prior.mean.shape[-1], config.particles, config.filter.coordinates
    step = prior.mean + prior.scale @ value[:d]
    place, turn = jnp.zeros(3), jnp.zeros(3)
    for i, name in enumerate(names):
        if name in chart.AXIS:
            turn = turn.at[chart.AXIS[name]].set(step[i])
        else:
            place = place.at["xyz".index(name)].set(step[i])
    grasp = value[d : d + 6] if _grasp_varies(own) else jnp.zeros(6)
    return Pose(
        place,
        SO3.exp(turn).as_matrix(),
        own.grasp_std_m * grasp[:3],
        SO3.exp(own.grasp_std_rad * grasp[3:]).as_matrix(),
        config.pose.height_offset_m * value[-2],
        jnp.exp(own.gap_spread * value[-1]),
    )


def _grasp_varies(own: ParticlesConfig) -> bool:
    return own.grasp_std_m > 0 or own.grasp_std_rad > 0


def _moved(
    state: _State, key: Key[Array, ""], *, logp: _Likelihood, beta: Float[Array, ""], prior: Prior
) -> tuple[_State, None]:
    """Propose a move of every particle, and take it by the rule of Metropolis."""
    particles, known_new = state
    of_move, of_type, of_choice = jax.random.split(key, 3)
    values = particles.values + tempering.differences(particles.values, of_move)
    asked = Particles(values, _some_drawn(particles.types, len(prior.type_logp), of_type))
    proposed = logp(asked)

    def before(of: Particles) -> Float[Array, "N"]:
        return prior.type_logp[of.types] - 0.5 * (of.values * of.values).sum(-1)

    gain = (proposed - known_new) @ jnp.stack([jnp.ones(()), beta]) + before(asked) - before(particles)
    taken = jnp.log(jax.random.uniform(of_choice, gain.shape)) < gain

    def pick(new: Array, old: Array) -> Array:
        return jnp.where(taken.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    return jax.tree.map(pick, (asked, proposed), state), None


def _some_drawn(types: Int[Array, "N"], n_types: int, key: Key[Array, ""]) -> Int[Array, "N"]:
    """Draw a share of the types uniformly."""
    of_share, of_type = jax.random.split(key)
    drawn = jax.random.randint(of_type, types.shape, 0, n_types)
    return jnp.where(jax.random.bernoulli(of_share, _RETYPED, types.shape), drawn, types)
