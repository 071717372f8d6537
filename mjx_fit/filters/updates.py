"""Belief updates after a failed attempt: lines 10 and 11 of Algorithm 1.

Method ``Full`` applies ``update_position`` and ``update_type``, both with the observation. ``Failure +
Position`` applies ``update_position`` with it and ``update_type`` without. ``Failure only`` applies
``update_type`` without the observation.
"""

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from mjx_fit.config.sections.filter import FilterConfig
from mjx_fit.filters import histogram, kalman
from mjx_fit.types import Array, Belief, Observation

NONE = FilterConfig(gate=0, correlation=0, match_temperature=1)
"""No safeguards, as in the paper."""


def initial_belief(estimate: Float[Array, "*batch 2"], prior_std_m: float, n_types: int) -> Belief:
    """Create the prior given the detector's estimate: N(estimate, σ² I) and ξ_c = 1/C.

    Args:
        estimate: Estimate of the detector, m.
        prior_std_m: Standard deviation σ per axis, m.
        n_types: Number of types C.
    """
    batch, dtype = estimate.shape[:-1], estimate.dtype
    return Belief(
        mean_world=estimate,
        cov=jnp.broadcast_to(prior_std_m**2 * jnp.eye(2, dtype=dtype), (*batch, 2, 2)),
        type_logp=jnp.full((*batch, n_types), -jnp.log(n_types), dtype),
    )


def update_position(
    belief: Belief,
    observation: Observation,
    safeguards: FilterConfig = NONE,
    prior_std_m: float = 0.01,
) -> Belief:
    """Update the position belief, Algorithm 2; the attempt must have started from ``belief.pos_mean_world``.

    The innovation is relative to the start of the attempt; a policy that starts elsewhere (a sampled
    estimate) has to add start - mean to it first.

    Args:
        belief: Prior belief.
        observation: Output of the virtual sensors.
        safeguards: Correlation of readings and the gate; by default, neither.
        prior_std_m: Standard deviation of the belief before any reading, per axis, m; for the correlation.
    """
    innovation, prior_cov, noise_cov = observation.innovation, belief.cov, observation.pos_noise_cov
    if safeguards.correlation:
        noise_cov = kalman.correlated(prior_cov, noise_cov, prior_std_m, safeguards.correlation)
    if safeguards.gate:
        prior_cov, noise_cov = kalman.gated(prior_cov, innovation, noise_cov, safeguards.gate)
    mean, cov = kalman.update(belief.mean_world, prior_cov, innovation, noise_cov)
    return replace(belief, mean_world=mean, cov=cov)


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
