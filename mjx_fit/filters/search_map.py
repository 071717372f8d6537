"""Where a hole may be after searches in vain: log probabilities on a grid about the detection.

A Gaussian cannot say that a hole is somewhere around the place that was searched, but not there. The map
starts with the Gaussian of the detection, and a failed visit along a path multiplies it by

    p(missed | h, match) = 1 - a exp(-d(h)² / 2 w²)
    p(felt | h) ∝ ε + (1 - ε) l(h) / Σ p l,   l(h) = N(h; μ, Σ) / N(h; μ₀, Σ₀)

with d(h) the distance of a hole at h from the path of the peg in contact, a = ``filter.capture_chance`` and
w = ``filter.capture_m``; and with the beliefs before the visit (μ₀, Σ₀) and at its end (μ, Σ): of visits in
vain, a share ε = ``filter.misled_chance`` was misled, and tells nothing. All of it is given that the hole
matches the peg: where to search matters only then.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.config.sections.filter import FilterConfig
from mjx_fit.types import Array, Belief
from mjx_fit.utils.pytrees import pytree

CELLS, REACH_STD = 61, 3.0
"""Cells along each side of a map, and its half width in standard deviations of the detection."""
BETWEEN = (0.0, 1 / 3, 2 / 3, 1.0)
"""Points of the path between the ends of two actions."""
_OFFSETS = np.linspace(-1, 1, CELLS, dtype=np.float32)


@pytree
class SearchMap:
    """Map of one hole.

    Attributes:
        centre_world: Detected position, m.
        half_m: Half the width of the grid, m.
        logp: Log probability of each cell; rows along x, columns along y.
    """

    centre_world: Float[Array, "2"]
    half_m: Float[Array, ""]
    logp: Float[Array, "61 61"]

    @property
    def cells_world(self) -> Float[Array, "61 61 2"]:
        """Centres of the cells, m."""
        x, y = jnp.meshgrid(_OFFSETS, _OFFSETS, indexing="ij")
        return self.centre_world + self.half_m * jnp.stack([x, y], -1)


def begun(pos_mean_world: Float[Array, "2"], pos_cov: Float[Array, "2 2"]) -> SearchMap:
    """Return the map before any visit: the detection's Gaussian.

    Args:
        pos_mean_world: Detected position, m.
        pos_cov: Its covariance, m².
    """
    half = REACH_STD * jnp.sqrt(jnp.trace(pos_cov) / 2)
    empty = SearchMap(jnp.asarray(pos_mean_world), half, jnp.zeros((CELLS, CELLS)))
    exponent = _exponent(empty.cells_world, pos_mean_world, pos_cov)
    return SearchMap(empty.centre_world, half, jax.nn.log_softmax(exponent, (0, 1)))


def _exponent(
    at_world: Float[Array, "61 61 2"], mean_world: Float[Array, "2"], cov: Float[Array, "2 2"]
) -> Float[Array, "61 61"]:
    """Return the exponent of a Gaussian at these places."""
    off = at_world - mean_world
    xx, yy, xy = cov[0, 0], cov[1, 1], cov[0, 1]
    squared = yy * off[..., 0] ** 2 - 2 * xy * off[..., 0] * off[..., 1] + xx * off[..., 1] ** 2
    return -squared / (2 * (xx * yy - xy**2))


def missed(
    searched: SearchMap,
    path_world: Float[Array, "J 2"],
    contact: Bool[Array, "J"],
    config: FilterConfig,
) -> SearchMap:
    """Return the map after a visit without an insertion.

    Args:
        searched: Map before the visit.
        path_world: Positions of the TCP at the ends of the actions, m.
        contact: Whether the peg touched; padding does not.
        config: Defines the capture.
    """
    start, step = path_world[:-1, None], jnp.diff(path_world, axis=0)[:, None]
    points = start + step * jnp.asarray(BETWEEN)[:, None]
    both = jnp.repeat((contact[:-1] & contact[1:])[:, None], len(BETWEEN), 1)
    away = searched.cells_world[:, :, None] - points.reshape(-1, 2)
    squared = jnp.where(both.reshape(-1), (away**2).sum(-1), jnp.inf).min(-1)
    width = jnp.maximum(config.capture_m, searched.half_m / CELLS)
    hit = config.capture_chance * jnp.exp(-squared / (2 * width**2))
    logp = searched.logp + jnp.log1p(-hit)
    return replace(searched, logp=jax.nn.log_softmax(logp, (0, 1)))


def felt(searched: SearchMap, prior: Belief, posterior: Belief, config: FilterConfig) -> SearchMap:
    """Return the map after what a visit without an insertion felt.

    Args:
        searched: Map before.
        prior: Belief before the visit.
        posterior: Belief at its end.
        config: Defines how many of these visits are misled.
    """
    cells = searched.cells_world
    told = _exponent(cells, posterior.pos_mean_world, posterior.pos_cov) - _exponent(
        cells, prior.pos_mean_world, prior.pos_cov
    )
    after = jax.nn.log_softmax(searched.logp + told, (0, 1))
    return replace(
        searched,
        logp=jnp.logaddexp(
            searched.logp + jnp.log(config.misled_chance), after + jnp.log1p(-config.misled_chance)
        ),
    )


def best_place(searched: SearchMap, reach_m: float) -> Float[Array, "2"]:
    """Return the position (m) about which a search that covers this radius finds the hole most probably."""
    x, y = jnp.meshgrid(_OFFSETS, _OFFSETS, indexing="ij")
    disc = ((x**2 + y**2) * searched.half_m**2 <= reach_m**2).astype(jnp.float32)
    found = jax.scipy.signal.fftconvolve(jnp.exp(searched.logp), disc, mode="same")
    return searched.cells_world.reshape(-1, 2)[found.argmax()]
