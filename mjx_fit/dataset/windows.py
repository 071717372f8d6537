"""Training examples: random windows of stored interactions, with fresh sensor noise and a fresh prior.

Section "Differentiable Filter Training" of the paper. Sampling is pure and jitted; the draws of an episode
depend on the key and the episode's index alone, never on the batch that it is in.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key

from mjx_fit.config import Config
from mjx_fit.errors import RequestError
from mjx_fit.filters.belief import initial_belief
from mjx_fit.shapes import SHAPES, plate_top_m
from mjx_fit.types import Array, Belief, Interaction, Reading, pytree
from mjx_fit.wrist import read

MIN_ACTIONS = 5
"""Half a second: a shorter interaction is dropped, it ended before anything could be felt."""


@pytree
class Sample:
    """One training example.

    Attributes:
        reading: What the sensors are shown.
        prior: The belief before the attempt: μ0, Σ0, ξ0.
        hole_type: True type of the hole.
        hole_pos_world: True position of the hole, m.
        failed: False where the window contains the moment of insertion: such a window says nothing about
            P(o_match | type, peg, the attempt failed), and the histogram filter already counts the outcome.
    """

    reading: Reading
    prior: Belief
    hole_type: Int[Array, "*batch"]
    hole_pos_world: Float[Array, "*batch 2"]
    failed: Bool[Array, "*batch"]


def usable(data: Interaction) -> Bool[np.ndarray, "episodes"]:
    """Which interactions can be trained on: simulated without fault, and at least ``MIN_ACTIONS`` long."""
    return np.asarray(data.valid) & (np.asarray(data.length) >= MIN_ACTIONS)


def split(
    n_episodes: int, fraction: float, seed: int
) -> tuple[Int[np.ndarray, "training"], Int[np.ndarray, "validation"]]:
    """Indices of the training and of the validation episodes, at random, at least one of each.

    Raises:
        RequestError: There are fewer than two episodes.
    """
    if n_episodes < 2:
        raise RequestError(f"--data: {n_episodes} interactions are not allowed: training needs at least 2")
    order = np.random.default_rng(seed).permutation(n_episodes)
    n_validation = min(max(1, round(fraction * n_episodes)), n_episodes - 1)
    return np.sort(order[n_validation:]), np.sort(order[:n_validation])


@partial(jax.jit, static_argnames="config")
def sample_windows(
    data: Interaction, episodes: Int[Array, "batch"], key: Key[Array, ""], config: Config
) -> Sample:
    """Draw one window from each of the chosen episodes.

    Its length is uniform in [``train.min_window``, ``train.max_window``], cut to what the episode has, its
    start uniform over what is left; it is padded to ``max_window``.

    Args:
        data: Interactions, stacked along one leading axis.
        episodes: Indices into it.
        key: Source of windows, noise and type priors.
        config: Static; ``train``, ``wrist``, ``detector`` and ``scene`` are used.
    """

    def sample(episode: Int[Array, ""]) -> Sample:
        interaction = jax.tree.map(lambda leaf: leaf[episode], data)
        return _sample_one(interaction, jax.random.fold_in(key, episode), config)

    return jax.vmap(sample)(episodes)


def _sample_one(interaction: Interaction, key: Key[Array, ""], config: Config) -> Sample:
    count_key, start_key, noise_key, prior_key = jax.random.split(key, 4)
    train = config.train
    drawn = jax.random.randint(count_key, (), train.min_window, train.max_window + 1)
    count = jnp.minimum(drawn, interaction.length)
    start = jax.random.randint(start_key, (), 0, interaction.length - count + 1)
    return Sample(
        reading=read(
            interaction,
            noise_key,
            config.wrist,
            plate_top_m(config.scene),
            rows=train.max_window,
            start=start,
            count=count,
        ),
        prior=_prior(interaction.estimate_world, prior_key, config.detector.prior_std_m),
        hole_type=interaction.hole_type,
        hole_pos_world=interaction.hole_pos_world,
        failed=~(interaction.inserted & (start + count == interaction.length)),
    )


def _prior(estimate: Float[Array, "2"], key: Key[Array, ""], prior_std_m: float) -> Belief:
    """μ0 is where the interaction started, Σ0 = σ² I, ξ0 three draws from U(0, 1) divided by their sum.

    Drawing μ0 afresh would show the sensor two detector readings where a real attempt has one.
    """
    belief = initial_belief(estimate, prior_std_m, len(SHAPES))
    # uniform() may return 0 but never 1: a type of probability 0 would make the loss infinite.
    draws = 1 - jax.random.uniform(key, (len(SHAPES),), estimate.dtype)
    return Belief(belief.pos_mean_world, belief.pos_cov, jnp.log(draws / draws.sum()))
