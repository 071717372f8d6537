"""Where to search next when the hole may be at several places: the least expected time to an insertion.

A search about c that ends once it has swept a disc of radius r, with π r² as much as ``seek.feel_s`` sweeps,
takes the time t and succeeds with the probability p, that the hole is within r. If each of the tries that
follow is as good, the insertion takes

    T = (t₀ + |x - c| / w + π E[min(|h - c|², r²)] / (v d)) / P(|h - c| < r).

For a search that has swept the disc of radius ρ, without t₀ and the way, the squared distances are those
beyond ρ², and holes inside have been missed: they cost r² and do not succeed. Where the belief is narrower
than r, c is its mean, and both are the times of ``mjx_fit.control.search``.
"""

import math

import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.config.sections.seek import SeekConfig
from mjx_fit.control.search import Search, time_s
from mjx_fit.types import Array

CANDIDATES = 64
"""Places that a search is begun about, beside the mean."""


def remaining_s(search: Search, holes_world: Float[Array, "k 2"], config: SeekConfig) -> Float[Array, ""]:
    """Compute the expected time to an insertion with a search that goes on, s.

    Args:
        search: The search.
        holes_world: Points of equal weight that stand for the belief about the hole, m.
        config: Pitch, speeds and ``feel_s``.
    """
    left = jnp.square(holes_world - search.centre_world).sum(-1) - search.radius_m(config) ** 2
    most = _reach_m2(config)
    cost = jnp.where(left < 0, most, jnp.minimum(left, most))
    return time_s(cost.mean(), config) / _chance((left >= 0) & (left < most))


def best_new(
    here_world: Float[Array, "2"], holes_world: Float[Array, "k 2"], config: SeekConfig
) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Return the best centre of a new search, and the expected time to an insertion with it, s.

    Args:
        here_world: Position of the TCP, m.
        holes_world: Points of equal weight that stand for the belief about the hole, m; some are candidates.
        config: Pitch, speeds and ``feel_s``.
    """
    some = holes_world[:: max(1, len(holes_world) // CANDIDATES)]
    centres = jnp.concatenate([holes_world.mean(0, keepdims=True), some])
    squared = jnp.square(holes_world - centres[:, None]).sum(-1)
    most = _reach_m2(config)
    way = jnp.linalg.norm(centres - here_world, axis=-1)
    one_try = config.change_s + way / config.slide_mps + time_s(jnp.minimum(squared, most).mean(-1), config)
    took = one_try / _chance(squared < most)
    best = jnp.argmin(took)
    return centres[best], took[best]


def _reach_m2(config: SeekConfig) -> float:
    return config.feel_s * config.speed_mps * config.pitch_m / math.pi


def _chance(is_hit: Array) -> Array:
    """Return the share of points that are hit; not zero, since points are few."""
    return jnp.maximum(is_hit.mean(-1), 0.5 / is_hit.shape[-1])
