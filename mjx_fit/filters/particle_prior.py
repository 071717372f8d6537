"""What particles are drawn from: the belief before an attempt, which may be wrong.

A belief that earlier contact misled is narrow and far off, and no later contact could correct it. So the
place is distributed as

    (1 - ε) N(m, Σ) + ε N(m₀, Σ₀),

with ε the chance that the belief is wrong and N(m₀, Σ₀) the belief before any contact, from a detection.
Where nobody knows it, m₀ is m: then a belief may wander, from one attempt to the next.

A particle is a vector of numbers in units of the prior: one for each believed coordinate, six for the grasp
where it varies, and the errors of measurements: that of heights, the logarithm of the noise, and the error of
heights in each attempt that is remembered.
"""

import math

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.filters.kalman import scale_tril
from mjx_fit.filters.updates import prior_stds
from mjx_fit.types import Array, Belief, pytree

_SLIDES = (0.3, 1.0, 2.0)
"""Sizes of steps to another place of the hole, in standard deviations of detections."""
ERRORS = 2
"""Errors of an attempt's measurements; those of earlier attempts come after them."""


def dimensions(config: Config) -> int:
    """Return the length of a particle's vector."""
    return errors_from(config) + ERRORS + config.particles.remember


def errors_from(config: Config) -> int:
    """Return the index of the first error of measurements."""
    return len(config.filter.coordinates) + 6 * grasp_varies(config)


def grasp_varies(config: Config) -> bool:
    """Return whether the peg is held differently from attempt to attempt."""
    return config.particles.grasp_std_m > 0 or config.particles.grasp_std_rad > 0


@pytree
class Prior:
    """Belief before an attempt, in the frame of its estimate.

    Attributes:
        mean: Mean step from the estimate, m and rad.
        scale: Cholesky factor L of its covariance Σ.
        wide: That of Σ₀ in units of L: L⁻¹ L₀.
        apart: How far the detection is from the mean in these units: L⁻¹ (m₀ - m).
        type_logp: Log probability of each type.
        peg_type: Type of the peg in hand.
    """

    mean: Float[Array, "D"]
    scale: Float[Array, "D D"]
    wide: Float[Array, "D D"]
    apart: Float[Array, "D"]
    type_logp: Float[Array, "C"]
    peg_type: Int[Array, ""]


def prior_of(belief: Belief, first: Belief | None, peg_type: Int[Array, ""], config: Config) -> Prior:
    """Return the prior of a belief.

    Args:
        belief: Belief relative to an estimate (``mjx_fit.filters.frame``).
        first: Belief before any contact, likewise; None: a detection at the mean of the belief.
        peg_type: Type of the peg.
        config: Defines the errors of detections.
    """
    scale, stds = scale_tril(belief.cov), jnp.asarray(prior_stds(config), belief.cov.dtype)
    wide, apart = jnp.diag(stds), jnp.zeros_like(belief.mean_world)
    if first is not None:
        wide, apart = scale_tril(first.cov), first.mean_world - belief.mean_world
    wide, apart = (solve_triangular(scale, one, lower=True) for one in (wide, apart))
    return Prior(belief.mean_world, scale, wide, apart, belief.type_logp, peg_type)


def drawn_values(
    prior: Prior, count: int, d: int, key: Key[Array, ""], config: Config
) -> Float[Array, "N d"]:
    """Draw values: coordinates in units of the prior's scale, then standard normals of what else varies."""
    of_values, of_misled = jax.random.split(key)
    values, size = jax.random.normal(of_values, (count, d)), len(prior.mean)
    misled = jax.random.bernoulli(of_misled, config.particles.misled_chance, (count, 1))
    places = values[:, :size]
    places = jnp.where(misled, prior.apart + places @ prior.wide.T, places)
    return jnp.concatenate([places, values[:, size:]], 1)


def values_logp(values: Float[Array, "N d"], prior: Prior, config: Config) -> Float[Array, "N"]:
    """Return the log density of values, up to a constant."""
    size, chance = len(prior.mean), config.particles.misled_chance
    places, rest = values[:, :size], values[:, size:]
    logp = -0.5 * (places * places).sum(-1)
    if chance > 0:
        far = solve_triangular(prior.wide, (places - prior.apart).T, lower=True)
        wide = -0.5 * (far * far).sum(0) - jnp.log(jnp.diagonal(prior.wide)).sum()
        logp = jnp.logaddexp(math.log1p(-chance) + logp, math.log(chance) + wide)
    return logp - 0.5 * (rest * rest).sum(-1)


def slid(
    values: Float[Array, "N d"], prior: Prior, key: Key[Array, ""], config: Config
) -> Float[Array, "N d"]:
    """Propose holes elsewhere in the same plate, about as far as detections err.

    What was felt of the plate stays as probable as it was, so this passes between places that a hole may be
    at. The step of x and y is random and symmetric, and the height follows the slope of the plate to first
    order, which depends on rotations alone: Metropolis' rule needs no correction.
    """
    names, d, (of_size, of_step) = config.filter.coordinates, len(prior.mean), jax.random.split(key)
    size = jnp.asarray(_SLIDES)[jax.random.randint(of_size, (len(values), 1), 0, len(_SLIDES))]
    step = size * jnp.asarray(prior_stds(config)[:2]) * jax.random.normal(of_step, (len(values), 2))
    moved = jnp.zeros((len(values), d)).at[:, :2].set(step)
    if "z" in names:
        roll, pitch = _slope(values, prior, config)
        moved = moved.at[:, names.index("z")].set(roll * step[:, 1] - pitch * step[:, 0])
    return jnp.asarray(values).at[:, :d].add(solve_triangular(prior.scale, moved.T, lower=True).T)


def _slope(
    values: Float[Array, "N d"], prior: Prior, config: Config
) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """Return the plate's roll and pitch to first order: those of the place and of the grasp, rad."""
    names, d = config.filter.coordinates, len(prior.mean)
    place = prior.mean + values[:, :d] @ prior.scale.T
    found = []
    for axis, name in enumerate(("roll", "pitch")):
        turn = place[:, names.index(name)] if name in names else jnp.zeros(len(values))
        if grasp_varies(config):
            turn = turn + config.particles.grasp_std_rad * values[:, d + 3 + axis]
        found.append(turn)
    return found[0], found[1]
