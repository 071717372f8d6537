"""Particle filter for the place and the type of a hole, by the geometry of contact.

Particles are drawn from the belief before an attempt and conditioned on its rows by sequential Monte Carlo
with tempering (Del Moral, Doucet and Jasra, 2006): the likelihood of new rows is raised to exponents that
grow to 1, each as large as the particles' weights allow; after each they are resampled and moved, by
proposals that follow the particles' own mean and covariance and differences (``mjx_fit.filters.tempering``).

A particle is a vector of numbers in units of the prior (``mjx_fit.filters.particle_prior``).
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxlie import SO3
from jaxtyping import Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.filters import chart, tempering
from mjx_fit.filters.contact_model import Pose, row_logp
from mjx_fit.filters.particle_prior import (
    Prior,
    dimensions,
    drawn_values,
    errors_from,
    grasp_varies,
    slid,
    values_logp,
)
from mjx_fit.scene.surfaces import surfaces_of
from mjx_fit.types import Array, Belief, Particles, Rows

_SLID = 0.2
"""Share of moves that take the hole elsewhere in the plate."""
_RETYPED = 0.2
"""Share of moves that draw the type as well."""
_IMPOSSIBLE = -1e6
"""Log likelihood in place of NaN, such as of a simulation that diverged: exponents would never reach 1."""
_BLOCK = 256
"""Particles whose likelihood is computed at once: as many as fit a processor's cache with their sockets."""
_ROWS = 5
"""Rows that are read at once: a processor spends less time on loops."""
_Likelihood = Callable[[Particles], Float[Array, "N 2"]]
_State = tuple[Particles, Float[Array, "N 2"]]
"""Particles, and the log likelihoods of their known rows and of the new ones."""


def drawn(prior: Prior, key: Key[Array, ""], config: Config) -> Particles:
    """Draw particles from a prior; the shares of types are as exact as their number allows."""
    count = config.particles.count
    at, of_values = jax.random.split(key)
    share = (jax.random.uniform(at) + jnp.arange(count)) / count
    below = jnp.cumsum(jax.nn.softmax(prior.type_logp))
    types = jnp.minimum(jnp.searchsorted(below, share), config.scene.n_types - 1)
    return Particles(drawn_values(prior, count, dimensions(config), of_values, config), types)


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
    target = _Target(logp, prior, config)

    def temper(state):
        particles, old_new, beta, key = state
        key, to_resample, to_move = jax.random.split(key, 3)
        step = tempering.largest_step(old_new[:, 1], 1 - beta, own.least_share)
        weight, beta = jax.nn.softmax(step * old_new[:, 1]), jnp.where(step < 1 - beta, beta + step, 1.0)
        kept = tempering.resampled(weight, to_resample)
        state = jax.tree.map(lambda leaf: leaf[kept], (particles, old_new))
        return *_round(state, beta, to_move, target), beta, key

    is_new = (jnp.arange(len(rows.weight)) >= known) & (rows.weight > 0)
    begun = jnp.where(is_new.any(), 0.0, 1.0)
    state = particles, logp(particles), begun, key
    return jax.lax.while_loop(lambda state: state[2] < 1, temper, state)[0]


def settled(particles: Particles, prior: Prior, rows: Rows, key: Key[Array, ""], config: Config) -> Particles:
    """Move conditioned particles more: few moves at each temperature leave them too close together."""
    target = _Target(_likelihood(prior, rows, 0, config), prior, config)

    def more(i: Int[Array, ""], state: _State) -> _State:
        return _round(state, jnp.ones(()), jax.random.fold_in(key, i), target)

    begun = particles, target.likelihood(particles)
    return jax.lax.fori_loop(0, config.particles.settle, more, begun)[0]


def steps_of(particles: Particles, prior: Prior) -> Float[Array, "N D"]:
    """Return the steps from the estimate that particles stand for, m and rad."""
    return prior.mean + particles.values[:, : prior.mean.shape[-1]] @ prior.scale.T


def summarised(particles: Particles, prior: Prior, config: Config) -> Belief:
    """Return mean and covariance of the steps from the estimate, and the probabilities of types.

    No type is ruled out: with N particles, probabilities are those of one particle more, of the prior.
    """
    count, steps = len(particles.types), steps_of(particles, prior)
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

    Rows that do not count take no time.
    """
    surfaces = jax.tree.map(jnp.asarray, surfaces_of(config.scene))
    peg = jax.tree.map(lambda leaf: leaf[prior.peg_type], surfaces)
    rows = jax.tree.map(lambda leaf: _in_blocks(leaf, _ROWS), rows)

    def of_block(values: Float[Array, "n d"], types: Int[Array, "n"]) -> Float[Array, "n 2"]:
        hole = jax.tree.map(lambda leaf: jnp.moveaxis(leaf[types], 0, -1)[..., None, :], surfaces)
        poses = jax.vmap(lambda value: _pose(value, prior, config), out_axes=-1)(values)
        poses = jax.tree.map(lambda leaf: leaf[..., None, :], poses)

        def add(found: Float[Array, "2 n"], i: Int[Array, ""]) -> Float[Array, "2 n"]:
            some = jax.tree.map(lambda leaf: jnp.moveaxis(leaf[i], 0, -1)[..., None], rows)
            logp = row_logp(poses, some, peg, hole, config.particles)
            logp = jnp.where(some.weight > 0, jnp.where(jnp.isnan(logp), _IMPOSSIBLE, logp), 0.0)
            is_new = i * _ROWS + jnp.arange(_ROWS) >= known
            return found + jnp.stack([~is_new, is_new]).astype(logp.dtype) @ logp

        def add_if_any(i: Int[Array, ""], found: Float[Array, "2 n"]) -> Float[Array, "2 n"]:
            return jax.lax.cond((rows.weight[i] > 0).any(), add, lambda found, i: found, found, i)

        return jax.lax.fori_loop(0, len(rows.weight), add_if_any, jnp.zeros((2, len(types)))).T

    def logp(particles: Particles) -> Float[Array, "N 2"]:
        count = len(particles.types)
        blocks = jax.tree.map(lambda leaf: _in_blocks(leaf, min(count, _BLOCK)), particles)
        return jax.lax.map(lambda one: of_block(one.values, one.types), blocks).reshape(-1, 2)[:count]

    return logp


def _in_blocks(leaf: Array, size: int) -> Array:
    """Return particles or rows in blocks of a size, the last one filled up with zeros."""
    padded = jnp.pad(leaf, [(0, -len(leaf) % size)] + [(0, 0)] * (leaf.ndim - 1))
    return padded.reshape(-1, size, *leaf.shape[1:])


def _pose(value: Float[Array, "d"], prior: Prior, config: Config) -> Pose:
    d, own, names = prior.mean.shape[-1], config.particles, config.filter.coordinates
    step = prior.mean + prior.scale @ value[:d]
    place, turn = jnp.zeros(3), jnp.zeros(3)
    for i, name in enumerate(names):
        if name in chart.AXIS:
            turn = turn.at[chart.AXIS[name]].set(step[i])
        else:
            place = place.at["xyz".index(name)].set(step[i])
    errors = value[errors_from(config) :]
    grasp = value[d : d + 6] if grasp_varies(config) else jnp.zeros(6)
    return Pose(
        place,
        SO3.exp(turn).as_matrix(),
        own.grasp_std_m * grasp[:3],
        SO3.exp(own.grasp_std_rad * grasp[3:]).as_matrix(),
        config.pose.height_offset_m * jnp.append(errors[:1], errors[2:]),
        jnp.exp(own.gap_spread * errors[1]),
    )


class _Target(NamedTuple):
    """What moves leave as it is, but for the exponent of the new rows."""

    likelihood: _Likelihood
    prior: Prior
    config: Config

    def before(self, of: Particles) -> Float[Array, "N"]:
        """Return the log density of particles before any row."""
        return self.prior.type_logp[of.types] + values_logp(of.values, self.prior, self.config)


def _round(state: _State, beta: Float[Array, ""], key: Key[Array, ""], target: _Target) -> _State:
    """Move all particles ``particles.moves`` times, by proposals that are like them."""
    reference = tempering.reference_of(state[0].values)
    move = partial(_moved, target=target, beta=beta, reference=reference)
    return jax.lax.scan(move, state, jax.random.split(key, target.config.particles.moves))[0]


def _moved(
    state: _State,
    key: Key[Array, ""],
    *,
    target: _Target,
    beta: Float[Array, ""],
    reference: tempering.Reference,
) -> tuple[_State, None]:
    """Propose a move of every particle, and take it by the rule of Metropolis."""
    particles, known_new = state
    of_move, of_type, of_choice, of_slide, of_place = jax.random.split(key, 5)
    values, ratio = tempering.proposed(particles.values, reference, of_move)
    slides = jax.random.bernoulli(of_slide, _SLID, ratio.shape)
    elsewhere = slid(particles.values, target.prior, of_place, target.config)
    values, ratio = jnp.where(slides[:, None], elsewhere, values), jnp.where(slides, 0.0, ratio)
    asked = Particles(values, _some_drawn(particles.types, len(target.prior.type_logp), of_type))
    proposed = target.likelihood(asked)
    gain = ratio + (proposed - known_new) @ jnp.stack([jnp.ones(()), beta])
    gain = gain + target.before(asked) - target.before(particles)
    taken = jnp.log(jax.random.uniform(of_choice, gain.shape)) < gain

    def pick(new: Array, old: Array) -> Array:
        return jnp.where(taken.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    return jax.tree.map(pick, (asked, proposed), state), None


def _some_drawn(types: Int[Array, "N"], n_types: int, key: Key[Array, ""]) -> Int[Array, "N"]:
    """Draw a share of the types uniformly."""
    of_share, of_type = jax.random.split(key)
    drawn = jax.random.randint(of_type, types.shape, 0, n_types)
    return jnp.where(jax.random.bernoulli(of_share, _RETYPED, types.shape), drawn, types)
