"""The loss of the differentiable filters: the paper's equation ``filter_loss``."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.data.windows import Sample
from mjx_fit.filters.kalman import gaussian_nll, gaussian_nll_terms
from mjx_fit.filters.outcome_model import success_probability
from mjx_fit.filters.updates import update_position, update_type
from mjx_fit.types import Array, Belief, Observation, pytree


@pytree
class Loss:
    """The terms of the loss in nats, for each window, or averaged.

    Terms that concern the type are zero for a window that contains the insertion.

    Attributes:
        total: Sum of the five terms; what is minimised.
        pos_logdet: ½ ln|Σ1|, Σ1 in cm².
        pos_mahalanobis: ½ (p - μ1)ᵀ Σ1⁻¹ (p - μ1).
        type_nll: -ln ξ1 of the true type.
        match_nll: -1[c = c_peg] ln p(c = c_peg).
        mismatch_nll: -1[c ≠ c_peg] ln p(c ≠ c_peg).
        nll: Of the true state under the updated belief: the first three terms.
        prior_nll: The same under the belief before the update, for comparison.
    """

    total: Float[Array, "*batch"]
    pos_logdet: Float[Array, "*batch"]
    pos_mahalanobis: Float[Array, "*batch"]
    type_nll: Float[Array, "*batch"]
    match_nll: Float[Array, "*batch"]
    mismatch_nll: Float[Array, "*batch"]
    nll: Float[Array, "*batch"]
    prior_nll: Float[Array, "*batch"]


def filter_loss(observation: Observation, sample: Sample) -> Loss:
    """The loss of each window after one update from its own prior, any batch axes.

    The type is updated with H taken softly, which can be differentiated, and with α = 0, that is T = 1: a
    window is cut from a random rollout, and how often such a cut would succeed is not known.
    """
    never_succeeds = jnp.zeros((sample.prior.type_logp.shape[-1],) * 2)
    return _after_update(sample.prior, observation, sample, never_succeeds)[1]


def sequence_loss(observation: Observation, sample: Sample, config: Config) -> Loss:
    """The loss of each window of a chain, with the belief handed on from window to window.

    What is felt in the attempts at one hole is not independent: all share the peg, the place and what the
    sensor gets wrong about them. Only a loss after the second and third update sees whether R and H allow
    for that. The windows are whole attempts, whose failure counts as it does in use.

    Args:
        observation: Axes (batch, length).
        sample: The same axes; of the later priors only the mean is used: from there the attempt started.
        config: Gives α.
    """

    def update(belief: Belief, attempt: tuple[Observation, Sample]) -> tuple[Belief, Loss]:
        seen, sample = attempt
        # h_pos measures from where the attempt started; this filter may have come to stand elsewhere.
        offset = sample.prior.pos_mean_world - belief.pos_mean_world
        seen = replace(seen, innovation=seen.innovation + offset)
        return _after_update(belief, seen, sample, success_probability(config, belief.pos_cov))

    along = jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), (observation, sample))
    first = jax.tree.map(lambda leaf: leaf[:, 0], sample.prior)
    _, losses = jax.lax.scan(update, first, along)
    return jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), losses)


def frame_by_frame_loss(observation: Observation, sample: Sample) -> Loss:
    """The loss of the baseline, which knows no prior: the position terms, μ1 the observation and Σ1 = R."""
    prior = sample.prior
    seen = replace(
        prior,
        pos_mean_world=prior.pos_mean_world + observation.innovation,
        pos_cov=observation.pos_noise_cov,
    )
    zero = jnp.zeros(seen.pos_mean_world.shape[:-1])
    return _loss(seen, prior, sample.hole_pos_world, [zero] * 2, zero, zero)


def _after_update(
    prior: Belief, observation: Observation, sample: Sample, alpha: Float[Array, "*#batch C C"]
) -> tuple[Belief, Loss]:
    """The updated belief, and its loss."""
    peg_type = sample.reading.peg_type
    belief = update_position(prior, observation)
    belief = update_type(belief, observation, peg_type, alpha, hard=False)
    is_match = sample.hole_type == peg_type
    match_logp = jax.nn.log_softmax(observation.match_logits, axis=-1)
    loss = _loss(
        belief,
        prior,
        sample.hole_pos_world,
        [_type_nll(one, sample) for one in (belief, prior)],
        jnp.where(sample.failed & is_match, -match_logp[..., 1], 0),
        jnp.where(sample.failed & ~is_match, -match_logp[..., 0], 0),
    )
    return belief, loss


def _loss(belief: Belief, prior: Belief, hole_pos_world, type_nlls, match_nll, mismatch_nll) -> Loss:
    type_nll, prior_type_nll = type_nlls
    pos_logdet, pos_mahalanobis = gaussian_nll_terms(hole_pos_world, belief.pos_mean_world, belief.pos_cov)
    nll = pos_logdet + pos_mahalanobis + type_nll
    return Loss(
        total=nll + match_nll + mismatch_nll,
        pos_logdet=pos_logdet,
        pos_mahalanobis=pos_mahalanobis,
        type_nll=type_nll,
        match_nll=match_nll,
        mismatch_nll=mismatch_nll,
        nll=nll,
        prior_nll=gaussian_nll(hole_pos_world, prior.pos_mean_world, prior.pos_cov) + prior_type_nll,
    )


def weighted_sum(losses: Loss, weight: Float[Array, "batch *length"]) -> Loss:
    """Each term, summed over the windows of a batch with these weights."""
    return jax.tree.map(lambda term: jnp.sum(term * weight), losses)


def _type_nll(belief: Belief, sample: Sample) -> Float[Array, "*batch"]:
    logp = jnp.take_along_axis(belief.type_logp, sample.hole_type[..., None], axis=-1)[..., 0]
    return jnp.where(sample.failed, -logp, 0)
