"""Training examples: random windows of stored rollouts, with fresh sensor noise and a fresh prior.

Section "Differentiable Filter Training" of the paper. Sampling is pure and jitted; the draws of an episode
depend on the key and the episode's index alone, never on the batch that it is in.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config.schema import Config
from mjx_fit.data.episode import Episode, happened
from mjx_fit.data.mirror import mirror_belief, mirror_place, mirror_reading
from mjx_fit.filters.outcome_model import enters_others
from mjx_fit.scene.placement import place_for_tool
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.types import Array, Belief, Reading, pytree

MIN_ACTIONS = 5
"""Shortest usable episode, half a second: shorter ones end before any informative contact."""


@pytree
class Sample:
    """One training example.

    Attributes:
        reading: Input of the sensors.
        prior: The belief before the attempt: μ0, Σ0, ξ0.
        hole_type: True type of the hole.
        place_world: True place of the hole, in the believed coordinates, m and rad (``place_for_tool``).
        inserted: Whether the window contains the insertion of the peg.
        judged: False where that peg fits its own holes alone. Such a window carries no information about
            P(o_match | type, peg, outcome), and the histogram filter already uses the outcome. A peg that
            enters other holes may be in one of them.
    """

    reading: Reading
    prior: Belief
    hole_type: Int[Array, "*batch"]
    place_world: Float[Array, "*batch D"]
    inserted: Bool[Array, "*batch"]
    judged: Bool[Array, "*batch"]


def usable(data: Episode) -> Bool[np.ndarray, "episodes"]:
    """Mask of the episodes usable for training: valid, and at least ``MIN_ACTIONS`` long."""
    return np.asarray(happened(data)) & (np.asarray(data.rollout.felt.length) >= MIN_ACTIONS)


def chains(data: Episode, episodes: Int[np.ndarray, "n"], length: int) -> Int[np.ndarray, "m length"]:
    """Arrange episodes in runs of consecutive attempts at one hole, along which the belief is passed.

    Args:
        data: Stacked episodes.
        episodes: Indices of the episodes to use.
        length: Attempts in a run. A longer sequence is cut into several runs; each starts from the stored
            belief of its first attempt.

    Returns:
        Indices; -1 after the end of a run. Runs without their first attempt are excluded.
    """
    sequence, number = (np.asarray(leaf)[episodes] for leaf in (data.sequence, data.number))
    runs, run = np.unique(np.stack([sequence, number // length], 1), axis=0, return_inverse=True)
    arranged = np.full((len(runs), length), -1)
    arranged[run, number % length] = episodes
    unbroken = np.logical_and.accumulate(arranged >= 0, axis=1)
    return np.where(unbroken, arranged, -1)[unbroken[:, 0]]


@partial(jax.jit, static_argnames="config")
def sample_windows(
    data: Episode, episodes: Int[Array, "batch *length"], key: Key[Array, ""], config: Config
) -> Sample:
    """Draw one window from each of the chosen episodes.

    The length is uniform in [``train.min_window``, ``train.max_window``], limited by the episode; the start
    is uniform over the remaining positions. Windows are padded to ``max_window``.

    Args:
        data: Episodes, stacked along one leading axis.
        episodes: Indices, or chains of indices; a chain is mirrored as a whole.
        key: Source of windows, noise and type priors.
        config: Static; ``train``, ``wrist`` and ``scene`` are used.
    """
    return windows_of(jax.tree.map(lambda leaf: leaf[episodes], data), episodes, key, config)


@partial(jax.jit, static_argnames="config")
def windows_of(
    rows: Episode, indices: Int[Array, "batch *length"], key: Key[Array, ""], config: Config
) -> Sample:
    """Draw one window from each episode of a batch; see ``sample_windows``.

    Args:
        rows: The episodes, stacked.
        indices: Indices in the data set; the draws depend on them.
        key: Source of windows, noise and type priors.
        config: Static.
    """
    flat = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[indices.ndim :]), rows)
    draw = jax.vmap(lambda episode, index: _sample_one(episode, jax.random.fold_in(key, index), config))
    sample, mirrored = jax.tree.map(
        lambda leaf: leaf.reshape(*indices.shape, *leaf.shape[1:]), draw(flat, indices.reshape(-1))
    )
    if not config.train.mirror:
        return sample
    if indices.ndim > 1:
        mirrored = jnp.broadcast_to(mirrored[:, :1], mirrored.shape)

    def choose(there, here):
        return jnp.where(mirrored.reshape(*mirrored.shape, *[1] * (here.ndim - mirrored.ndim)), there, here)

    return jax.tree.map(choose, _mirror(sample, config.filter.coordinates), sample)


def _sample_one(episode: Episode, key: Key[Array, ""], config: Config) -> tuple[Sample, Bool[Array, ""]]:
    """Draw a window, and whether to mirror it."""
    rollout = episode.rollout
    count_key, start_key, noise_key, prior_key, side_key = jax.random.split(key, 5)
    train = config.train
    drawn = jax.random.randint(count_key, (), train.min_window, train.max_window + 1)
    count = jnp.minimum(drawn, rollout.felt.length)
    start = jax.random.randint(start_key, (), 0, rollout.felt.length - count + 1)
    settled = jnp.asarray(~enters_others(config))[rollout.felt.peg_type]
    inserted = rollout.truth.inserted & (start + count == rollout.felt.length)
    sample = Sample(
        reading=read_window(
            rollout.felt,
            noise_key,
            config,
            Window(train.max_window, start=start, count=count),
        ),
        prior=_prior(episode, prior_key, config.scene.n_types),
        hole_type=rollout.truth.hole_type,
        place_world=place_for_tool(rollout.truth.hole_pos_world, rollout.truth.physics, config),
        inserted=inserted,
        judged=~(inserted & settled),
    )
    return sample, jax.random.bernoulli(side_key)


def _mirror(sample: Sample, coordinates: tuple[str, ...]) -> Sample:
    """Return the sample of the mirrored world."""
    return replace(
        sample,
        reading=mirror_reading(sample.reading),
        prior=mirror_belief(sample.prior, coordinates),
        place_world=mirror_place(sample.place_world, coordinates),
    )


def _prior(episode: Episode, key: Key[Array, ""], n_types: int) -> Belief:
    """Draw the prior: μ0 and Σ0 as stored, ξ0 as uniform draws divided by their sum.

    A new μ0 would give the sensor two detector readings where a real attempt has one.
    """
    estimate = episode.rollout.felt.estimate_world
    # uniform() may return 0 but never 1: a type of probability 0 would make the loss infinite.
    draws = 1 - jax.random.uniform(key, (n_types,), estimate.dtype)
    return Belief(estimate, episode.estimate_cov, jnp.log(draws / draws.sum()))
