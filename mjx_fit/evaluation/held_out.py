"""Trained sensors on held-out attempts: one update from the stored prior."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.data.episode import Episode, happened
from mjx_fit.evaluation.place_scores import place_columns, score_places
from mjx_fit.evaluation.result_file import rounded
from mjx_fit.filters import chart
from mjx_fit.filters.frame import observation_in_world
from mjx_fit.filters.outcome_model import success_probability
from mjx_fit.filters.updates import NONE, update_position, update_type
from mjx_fit.scene.placement import place_for_tool
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.task.estimator import readings
from mjx_fit.training.loss import place_terms
from mjx_fit.types import Array, Belief, Observation, Rollout
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.randomness import root_key

BATCH = 256


@dataclass(frozen=True)
class Posterior:
    """Posterior after the update, one row per attempt, NumPy arrays.

    Attributes:
        belief: Belief after the update.
        match_probability: Probability of a match by h_match, before H is applied.
    """

    belief: Belief
    match_probability: Array


def failed_attempts(data: Episode, actions: int) -> Int[np.ndarray, "n"]:
    """Return the indices of the failed attempts that ran for so many actions at least.

    Raises:
        RequestError: The data set contains no such attempt.
    """
    rollout = data.rollout
    whole = np.asarray(rollout.felt.length) >= actions
    ids = np.flatnonzero(np.asarray(happened(data)) & ~np.asarray(rollout.truth.inserted) & whole)
    if not len(ids):
        raise RequestError(f"--data: no failed attempt of {actions} actions found: at least one is required")
    return ids


def observe(
    sensor: ContactSensor, data: Episode, ids: Int[np.ndarray, "n"], actions: int, config: Config, seed: int
) -> Observation:
    """Run the sensor on the first actions of some episodes, with noise drawn by episode id.

    Args:
        sensor: Trained sensor.
        data: Stacked episodes.
        ids: Indices of the episodes used.
        actions: Number of their actions used.
        config: Configuration of the F/T sensor's noise and the scene.
        seed: Root seed of the noise.
    """
    root = root_key(seed, "held out")
    graph, state = nnx.split(sensor)
    parts = []
    for start in range(0, len(ids), BATCH):
        own = ids[start : start + BATCH]
        padded = np.resize(own, BATCH)  # one shape, compiled once
        rows = jax.tree.map(lambda leaf, rows=padded: np.asarray(leaf)[rows], data)
        parts.append(jax.tree.map(np.asarray, _observed(graph, state, rows, root, actions, config)))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(ids)], *parts)


@partial(jax.jit, static_argnames=("graph", "config"))
def _observed(
    graph: nnx.GraphDef,
    state: nnx.State,
    episodes: Episode,
    root: Key[Array, ""],
    actions: Int[Array, ""],
    config: Config,
) -> Observation:
    """Run a sensor on the first actions of a batch."""
    keys = jax.vmap(jax.random.fold_in, (None, 0))(root, episodes.episode)
    return nnx.merge(graph, state)(readings(episodes.rollout.felt, keys, config, actions))


def posterior(
    observation: Observation, data: Episode, ids: Int[np.ndarray, "n"], config: Config, *, with_prior: bool
) -> Posterior:
    """Compute the posterior after a failed attempt.

    The position is updated once, from the estimate and covariance stored with the attempt. The type starts
    from a uniform prior and is updated by this attempt and the earlier ones of its sequence: the filter's
    updates are products, so that their order does not matter.

    Args:
        observation: Result of ``observe``.
        data: Stacked episodes.
        ids: Indices of the observed episodes.
        config: Configuration; ``task`` determines α and whether match decisions are hard.
        with_prior: True to filter; False (frame by frame) takes the measured position as the mean and R as
            its covariance.
    """
    rollout = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[ids]), data.rollout)
    estimate, cov = rollout.felt.estimate_world, jnp.asarray(np.asarray(data.estimate_cov)[ids])
    n_types, names = config.scene.n_types, config.filter.coordinates
    observation = observation_in_world(jax.tree.map(jnp.asarray, observation), estimate, names)
    types = jnp.full((len(ids), n_types), -jnp.log(n_types))
    prior = Belief(estimate, cov, types)
    if with_prior:
        belief = update_position(prior, observation, replace(NONE, coordinates=names))
        alpha = success_probability(config, prior.pos_cov)
        belief = update_type(belief, observation, rollout.felt.peg_type, alpha, hard=config.task.hard_match)
        belief = replace(belief, type_logp=_over_sequences(belief.type_logp, data, ids))
    else:
        mean = chart.moved(estimate, observation.innovation, names)
        belief = Belief(mean, jnp.asarray(observation.pos_noise_cov), types)
    probability = jax.nn.softmax(observation.match_logits, axis=-1)[..., 1]
    return Posterior(jax.tree.map(np.asarray, belief), np.asarray(probability))


def _over_sequences(
    type_logp: Float[Array, "n C"], data: Episode, ids: Int[np.ndarray, "n"]
) -> Float[Array, "n C"]:
    """Multiply the type likelihoods of single attempts over each sequence so far."""
    sequence, number = np.asarray(data.sequence)[ids], np.asarray(data.number)[ids]
    order = np.lexsort((number, sequence))
    summed = np.cumsum(np.asarray(type_logp, float)[order], axis=0)
    _, first, of = np.unique(sequence[order], return_index=True, return_inverse=True)
    before = np.where(first[:, None] > 0, summed[first - 1], 0)[of]
    together = np.empty_like(summed)
    together[order] = summed - before
    return jax.nn.log_softmax(jnp.asarray(together, type_logp.dtype), axis=-1)


def rows(
    method: str,
    actions: int,
    after: Posterior,
    data: Episode,
    ids: Int[np.ndarray, "n"],
    config: Config,
) -> list[dict[str, Any]]:
    """Return one row for each attempt, ready for a result file."""
    rollout: Rollout = jax.tree.map(lambda leaf: np.asarray(leaf)[ids], data.rollout)
    belief, names = after.belief, config.scene.names
    place = np.asarray(place_for_tool(rollout.truth.hole_pos_world, rollout.truth.physics, config))
    means = np.stack([rollout.felt.estimate_world, np.asarray(belief.mean_world)], 1)
    covs = np.stack([np.asarray(data.estimate_cov)[ids], np.asarray(belief.cov)], 1)
    scores = score_places(means, covs, place[:, None], np.asarray(rollout.truth.hole_type), config)
    nll = rounded(np.asarray(sum(place_terms(belief, jnp.asarray(place), config.filter.coordinates))))
    match = rounded(np.asarray(after.match_probability))
    types = np.exp(np.asarray(belief.type_logp, float))
    peg, hole = rollout.felt.peg_type, rollout.truth.hole_type
    return [
        {
            "trial": int(data.sequence[i]),
            "method": method,
            "attempt": int(data.number[i]) + 1,
            "actions": actions,
            "pair": [names[peg[k]], names[hole[k]]],
            **_before_and_after(place_columns(scores, k)),
            "nll": nll[k],
            "match_probability": match[k],
            "type_probability": rounded(types[k]),
        }
        for k, i in enumerate(ids)
    ]


def _before_and_after(columns: dict[str, Any]) -> dict[str, Any]:
    """Turn the columns of a trial with two beliefs into those of one update."""
    after = {name: value[1] if isinstance(value, list) else value for name, value in columns.items()}
    before = {
        f"prior_{name}": columns[name][0] for name in ("error_cm", "turn_deg", "yaw_deg") if name in columns
    }
    return before | after
