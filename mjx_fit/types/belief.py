"""Belief about a hole, and what a filter remembers of the attempts behind it."""

import jax.numpy as jnp
from jaxtyping import Float, Int

from mjx_fit.types.contact import Particles, Rows
from mjx_fit.utils.arrays import Array
from mjx_fit.utils.pytrees import pytree


@pytree
class Belief:
    """Belief about the place and the type of one hole: a Gaussian over D coordinates, x and y first.

    Example:
        >>> import numpy as np, mjx_fit as mf
        >>> belief = mf.Belief(np.zeros(2), 1e-4 * np.eye(2), np.log([0.5, 0.25, 0.25]))
        >>> belief.type_probability.tolist()
        [0.5, 0.25, 0.25]

    Attributes:
        mean_world: Mean μ of the coordinates, m and rad.
        cov: Covariance Σ of the coordinates, m² and rad².
        type_logp: Log probability ln ξ of each shape; its exponentials sum to one.
        memory: What a filter remembers of the attempts behind the belief; None: it is the Gaussian alone.
    """

    mean_world: Float[Array, "*batch D"]
    cov: Float[Array, "*batch D D"]
    type_logp: Float[Array, "*batch C"]
    memory: "Memory | None" = None

    @property
    def pos_mean_world(self) -> Float[Array, "*batch 2"]:
        """Mean position x and y of the hole, m."""
        return self.mean_world[..., :2]

    @property
    def pos_cov(self) -> Float[Array, "*batch 2 2"]:
        """Covariance of the position x and y, m²."""
        return self.cov[..., :2, :2]

    @property
    def type_probability(self) -> Float[Array, "*batch C"]:
        """Probability ξ of each shape."""
        return jnp.exp(self.type_logp)


@pytree
class Memory:
    """What a belief came from: contact of earlier attempts at a hole with one peg, where it is read again.

    Attributes:
        before: Belief before the first of them.
        rows: Rows of contact in the frame of ``before``; the latest are the last ones.
        particles: Particles after the last attempt, in units of ``before``.
        count: Number of attempts.
    """

    before: Belief
    rows: Rows
    particles: Particles
    count: Int[Array, "*batch"]
