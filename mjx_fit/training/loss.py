"""Loss of the differentiable filters: equation ``filter_loss`` of the paper."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.filter import PLANAR, Coordinate
from mjx_fit.data.windows import Sample
from mjx_fit.filters import chart
from mjx_fit.filters.frame import observation_in_world
from mjx_fit.filters.kalman import gaussian_nll_terms
from mjx_fit.filters.outcome_model import success_probability
from mjx_fit.filters.updates import NONE, update_position, update_type
from mjx_fit.types import Array, Belief, Observation, pytree


@pytree
class Loss:
    """Loss terms in nats, per window or averaged.

    The type terms are zero for a window that contains an insertion which leaves no doubt about the type.

    Attributes:
        total: Sum of the five terms; the training objective.
        pos_logdet: ½ ln|Σ1|, Σ1 in cm² (rotations in 0.1 rad).
        pos_mahalanobis: ½ (p - μ1)ᵀ Σ1⁻¹ (p - μ1), for D coordinates.
        type_nll: -ln ξ1 of the true type.
        match_nll: -1[c = c_peg] ln p(c = c_peg).
        mismatch_nll: -1[c ≠ c_peg] ln p(c ≠ c_peg).
        nll: Negative log-likelihood of the true state under the posterior: the first three terms.
        prior_nll: Negative log-likelihood under the prior, for comparison.
    """

    total: Float[Array, "*batch"]
    pos_logdet: Float[Array, "*batch"]
    pos_mahalanobis: Float[Array, "*batch"]
    type_nll: Float[Array, "*batch"]
    match_nll: Float[Array, "*batch"]
    mismatch_nll: Float[Array, "*batch"]
    nll: Float[Array, "*batch"]
    prior_nll: Float[Array, "*batch"]


def filter_loss(
    observation: Observation, sample: Sample, coordinates: tuple[Coordinate, ...] = PLANAR
) -> Loss:
    """Compute the loss of each window after one update from its own prior, for any batch axes.

    The type update uses the soft, differentiable form of H and α = 0, that is T = 1: the windows are cut from
    random rollouts, whose success probability is unknown.

    Args:
        observation: Observations, in the frames of the estimates that the attempts started from.
        sample: Windows. Means of priors are these estimates.
        coordinates: What the priors are about.
    """
    never_succeeds = jnp.zeros((sample.prior.type_logp.shape[-1],) * 2)
    observation = observation_in_world(observation, sample.prior.mean_world, coordinates)
    return _after_update(sample.prior, observation, sample, never_succeeds, coordinates)[1]


def every_action_loss(
    observation: Observation, sample: Sample, coordinates: tuple[Coordinate, ...] = PLANAR
) -> Loss:
    """Compute the mean over the actions of each window of the loss after an update from those so far.

    Args:
        observation: Observations after each action, (batch, L).
        sample: Windows, (batch,). An insertion is judged only with the action in which it happens.
        coordinates: What the priors are about.
    """
    mask = sample.reading.mask
    count = mask.sum(-1, keepdims=True)
    last = jnp.arange(mask.shape[-1]) == count - 1
    inserted = sample.inserted[..., None] & last

    def along_rows(leaf: Array) -> Array:
        return jnp.broadcast_to(leaf[:, None], (*mask.shape, *leaf.shape[1:]))

    along = Sample(
        reading=replace(sample.reading, peg_type=along_rows(sample.reading.peg_type)),
        prior=jax.tree.map(along_rows, sample.prior),
        hole_type=along_rows(sample.hole_type),
        place_world=along_rows(sample.place_world),
        inserted=inserted,
        judged=sample.judged[..., None] | ~inserted,
    )
    losses = filter_loss(observation, along, coordinates)
    weight = mask / jnp.maximum(count, 1)
    # Padding rows may be far off: leave them out instead of multiplying by zero.
    return jax.tree.map(lambda term: jnp.where(mask, term * weight, 0).sum(-1), losses)


def sequence_loss(observation: Observation, sample: Sample, config: Config) -> Loss:
    """Compute the loss of each window of a chain, passing the belief from window to window.

    Measurements from attempts at one hole are not independent: they share the peg, the position and the
    systematic errors of the sensor. Only a loss after the second and third update reveals whether R and H
    account for that. The windows are whole attempts, and their failures update the belief as in deployment.

    Args:
        observation: Observations with axes (batch, length).
        sample: Windows with the same axes. The later priors contribute only their means, the start positions
            of the attempts.
        config: Defines α and the coordinates of beliefs.
    """
    coordinates = config.filter.coordinates

    def update(belief: Belief, attempt: tuple[Observation, Sample]) -> tuple[Belief, Loss]:
        seen, sample = attempt
        # h_pos is relative to the start of the attempt, which may differ from the filter's current mean.
        start = sample.prior.mean_world
        offset = chart.step_between(belief.mean_world, start, coordinates)
        seen = observation_in_world(seen, start, coordinates)
        seen = replace(seen, innovation=seen.innovation + offset)
        alpha = success_probability(config, belief.pos_cov)
        return _after_update(belief, seen, sample, alpha, coordinates)

    along = jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), (observation, sample))
    first = jax.tree.map(lambda leaf: leaf[:, 0], sample.prior)
    _, losses = jax.lax.scan(update, first, along)
    return jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), losses)


def frame_by_frame_loss(
    observation: Observation, sample: Sample, coordinates: tuple[Coordinate, ...] = PLANAR
) -> Loss:
    """Compute the loss of the baseline, which has no prior: position terms, μ1 = observation, Σ1 = R."""
    prior = sample.prior
    observation = observation_in_world(observation, prior.mean_world, coordinates)
    seen = replace(
        prior,
        mean_world=chart.moved(prior.mean_world, observation.innovation, coordinates),
        cov=observation.pos_noise_cov,
    )
    zero = jnp.zeros(seen.mean_world.shape[:-1])
    place = [place_terms(belief, sample.place_world, coordinates) for belief in (seen, prior)]
    return _loss(place, [zero] * 2, zero, zero)


def _after_update(
    prior: Belief,
    observation: Observation,
    sample: Sample,
    alpha: Float[Array, "*#batch C C"],
    coordinates: tuple[Coordinate, ...],
) -> tuple[Belief, Loss]:
    """Return the posterior and its loss."""
    peg_type = sample.reading.peg_type
    belief = update_position(prior, observation, replace(NONE, coordinates=coordinates))
    belief = update_type(belief, observation, peg_type, alpha, hard=False, inserted=sample.inserted)
    is_match = sample.hole_type == peg_type
    match_logp = jax.nn.log_softmax(observation.match_logits, axis=-1)
    loss = _loss(
        [place_terms(one, sample.place_world, coordinates) for one in (belief, prior)],
        [_type_nll(one, sample) for one in (belief, prior)],
        jnp.where(sample.judged & is_match, -match_logp[..., 1], 0),
        jnp.where(sample.judged & ~is_match, -match_logp[..., 0], 0),
    )
    return belief, loss


def place_terms(
    belief: Belief, place_world: Float[Array, "*batch D"], coordinates: tuple[Coordinate, ...]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Compute the two terms of the negative log-likelihood of true places, in the tangent spaces of means."""
    error = chart.step_between(belief.mean_world, place_world, coordinates)
    return gaussian_nll_terms(error, jnp.zeros_like(error), belief.cov, units=chart.units(coordinates))


def _loss(place: list[tuple[Array, Array]], type_nlls: list[Array], match_nll, mismatch_nll) -> Loss:
    """Add the terms of the posterior, the first of each list, and of the prior."""
    (pos_logdet, pos_mahalanobis), before = place
    type_nll, prior_type_nll = type_nlls
    nll = pos_logdet + pos_mahalanobis + type_nll
    return Loss(
        total=nll + match_nll + mismatch_nll,
        pos_logdet=pos_logdet,
        pos_mahalanobis=pos_mahalanobis,
        type_nll=type_nll,
        match_nll=match_nll,
        mismatch_nll=mismatch_nll,
        nll=nll,
        prior_nll=sum(before) + prior_type_nll,
    )


def weighted_sum(losses: Loss, weight: Float[Array, "batch *length"]) -> Loss:
    """Compute the weighted sum of each term over the windows of a batch."""
    return jax.tree.map(lambda term: jnp.sum(term * weight), losses)


def _type_nll(belief: Belief, sample: Sample) -> Float[Array, "*batch"]:
    logp = jnp.take_along_axis(belief.type_logp, sample.hole_type[..., None], axis=-1)[..., 0]
    return jnp.where(sample.judged, -logp, 0)
