"""Belief updates after a failed attempt: lines 10 and 11 of Algorithm 1.

Method ``Full`` applies ``update_position`` and ``update_type``, both with the observation. ``Failure +
Position`` applies ``update_position`` with it and ``update_type`` without. ``Failure only`` applies
``update_type`` without the observation.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.filter import FilterConfig
from mjx_fit.filters import chart, histogram, kalman
from mjx_fit.types import Array, Belief, Observation

NONE = FilterConfig(gate=0, correlation=0, match_temperature=1)
"""No safeguards, as in the paper."""


def detected_belief(estimate: Float[Array, "*batch 2"], config: Config) -> Belief:
    """Create the prior given the detector's estimate of a position: upright, at the nominal height.

    Args:
        estimate: Estimate of the detector, m.
        config: Defines the coordinates that are believed, and their standard deviations.
    """
    stds = prior_stds(config)
    rest = jnp.zeros((*estimate.shape[:-1], len(stds) - estimate.shape[-1]), estimate.dtype)
    place = jnp.concatenate([estimate, rest], -1) if rest.size else estimate
    return initial_belief(place, stds, config.scene.n_types)


def prior_stds(config: Config) -> tuple[float, ...]:
    """Return the standard deviation of each believed coordinate before any attempt, m and rad."""
    return tuple(map(config.detector.prior_std, config.filter.coordinates))


def initial_belief(
    estimate: Float[Array, "*batch D"], prior_std: float | Sequence[float], n_types: int
) -> Belief:
    """Create the prior about an estimate: N(estimate, diag σ²) and ξ_c = 1/C.

    Args:
        estimate: Estimate of the believed coordinates, m and rad.
        prior_std: Standard deviation σ; one, or one for each coordinate.
        n_types: Number of types C.
    """
    batch, d, dtype = estimate.shape[:-1], estimate.shape[-1], estimate.dtype
    stds = prior_std if isinstance(prior_std, Sequence) else [prior_std] * d
    return Belief(
        mean_world=estimate,
        cov=jnp.broadcast_to(jnp.asarray(np.square(stds), dtype) * jnp.eye(d, dtype=dtype), (*batch, d, d)),
        type_logp=jnp.full((*batch, n_types), -jnp.log(n_types), dtype),
    )


def update_position(
    belief: Belief,
    observation: Observation,
    safeguards: FilterConfig = NONE,
    prior_std: float | Sequence[float] = 0.01,
) -> Belief:
    """Update the belief about the place, Algorithm 2; the attempt must have started from its mean.

    The innovation is relative to the start of the attempt; a policy that starts elsewhere (a sampled
    estimate) has to add start - mean to it first. Rotations are updated in the tangent space of the mean.

    Args:
        belief: Prior belief.
        observation: Output of the virtual sensors.
        safeguards: Coordinates of the belief, correlation of readings and the gate; by default, x and y, and
            no safeguards.
        prior_std: Standard deviation of the belief before any reading, m and rad; one, or one for each
            coordinate; for the correlation.
    """
    innovation, prior_cov, noise_cov = observation.innovation, belief.cov, observation.pos_noise_cov
    if safeguards.correlation:
        noise_cov = kalman.correlated(prior_cov, noise_cov, prior_std, safeguards.correlation)
    if safeguards.gate:
        prior_cov, noise_cov = kalman.gated(prior_cov, innovation, noise_cov, safeguards.gate)
    here = jnp.zeros_like(belief.mean_world)
    step, cov = kalman.update(here, prior_cov, innovation, noise_cov)
    mean = chart.moved(belief.mean_world, step, safeguards.coordinates)
    return replace(belief, mean_world=mean, cov=chart.carried(cov, step, safeguards.coordinates))


def update_type(
    belief: Belief,
    observation: Observation | None,
    peg_type: Int[Array, "*batch"],
    success_probability: Float[Array, "*#batch C C"],
    *,
    hard: bool,
    inserted: Bool[Array, "*#batch"] | bool = False,
) -> Belief:
    """Update the type belief after a failed attempt, Algorithm 3, or after an insertion.

    Args:
        belief: Prior belief.
        observation: Output of the virtual sensors, or None to learn from the failure alone.
        peg_type: Type of the peg in hand.
        success_probability: Success probability α[c_peg, c] of the outcome model; zeros to learn from the
            observation alone.
        hard: Use the arg max of h_match instead of averaging over its probabilities.
        inserted: True: the peg went in, as deep as an insertion.
    """
    likelihood_logp = jnp.where(
        jnp.asarray(inserted)[..., None],
        histogram.insertion_logp(peg_type, success_probability),
        histogram.failure_logp(peg_type, success_probability),
    )
    if observation is not None:
        likelihood_logp += histogram.match_logp(
            observation.match_logits, observation.match_model_logp, hard=hard
        )
    return replace(belief, type_logp=histogram.update(belief.type_logp, likelihood_logp))
