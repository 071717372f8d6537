"""Virtual sensors h_pos and h_match, and their noise models R and H."""

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float, Int

MIN_STD_CM = 0.01
"""Lower bound of R's standard deviations, in units of their coordinates: a tenth of the clearance, or 1 mrad.

Without it, a sensor that fits its training set exactly would drive the likelihood to infinity."""

H_INIT_LOGIT = 1.0

# The usual standard deviation divided by ten: an untrained sensor outputs a zero innovation and even match
# odds, so that training starts near the likelihood of the prior.
_SMALL = nnx.initializers.variance_scaling(0.01, "fan_in", "truncated_normal")


class SkipMLP(nnx.Module):
    """Three fully connected layers with a skip connection over each of the first two."""

    def __init__(self, width: int, out_features: int, rngs: nnx.Rngs):
        """Build the layers; ``width`` is the size of the input and of both hidden layers."""
        self.first = nnx.Linear(width, width, rngs=rngs)
        self.second = nnx.Linear(width, width, rngs=rngs)
        self.last = nnx.Linear(width, out_features, kernel_init=_SMALL, rngs=rngs)

    def __call__(self, x: Float[Array, "*batch width"]) -> Float[Array, "*batch out"]:
        """Apply the layers."""
        x = x + nnx.leaky_relu(self.first(x))
        x = x + nnx.leaky_relu(self.second(x))
        return self.last(x)


class PositionNoise(nnx.Module):
    """Covariance R = L Lᵀ of D coordinates, L lower triangular with positive diagonal, by the peg's type.

    This is the paper's model. With ``of_trace``, a head adds a term that depends on the trace: some traces
    are more informative than others, and R should reflect this.
    """

    def __init__(self, n_types: int, code_width: int, of_trace: bool, rngs: nnx.Rngs, d: int = 2):
        """Start with a standard deviation of 0.69 units (softplus of 0), cm or 0.1 rad, per coordinate."""
        self.d, n = d, d * (d + 1) // 2
        self.raw = nnx.Embed(n_types, n, embedding_init=nnx.initializers.zeros_init(), rngs=rngs)
        self.head = SkipMLP(code_width, n, rngs) if of_trace else None

    def __call__(
        self, peg_type: Int[Array, "*batch"], code: Float[Array, "*batch width"]
    ) -> Float[Array, "*batch D D"]:
        """Compute R for each peg and trace, in squared units."""
        raw = self.raw(peg_type) + (0 if self.head is None else self.head(code))
        diagonal = jax.nn.softplus(raw[..., : self.d]) + MIN_STD_CM
        zero, below = jnp.zeros_like(raw[..., 0]), iter(range(self.d, raw.shape[-1]))
        rows = [
            [*(raw[..., next(below)] for _ in range(i)), diagonal[..., i], *[zero] * (self.d - 1 - i)]
            for i in range(self.d)
        ]
        scale_tril = jnp.stack([jnp.stack(row, -1) for row in rows], axis=-2)
        return jnp.einsum("...ij,...kj->...ik", scale_tril, scale_tril, precision=jax.lax.Precision.HIGHEST)


class MatchModel(nnx.Module):
    """Model H(o_match | c, c_peg): an embedding of the peg type to (C, 2) logits, softmax over o_match."""

    def __init__(self, n_types: int, rngs: nnx.Rngs):
        """Initialise H to 73 % accuracy: a uniform H would give h_match no gradient."""
        self.n_types = n_types
        self.logits = nnx.Embed(n_types, n_types * 2, embedding_init=self._init, rngs=rngs)

    def __call__(self, peg_type: Int[Array, "*batch"]) -> Float[Array, "*batch C 2"]:
        """Compute log H for the peg in hand; rows: hole types, columns: (mismatch, match)."""
        logits = self.logits(peg_type)
        return jax.nn.log_softmax(logits.reshape(*logits.shape[:-1], self.n_types, 2), axis=-1)

    def _init(self, key, shape, dtype, out_sharding=None) -> Float[Array, "C features"]:
        match = jnp.eye(self.n_types, dtype=dtype)
        return H_INIT_LOGIT * jnp.stack([1 - match, match], axis=-1).reshape(shape)
