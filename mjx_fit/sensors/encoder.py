"""Encoder e1, which maps a trace of any length to one vector.

It follows section "Model Architecture and Learning" of the paper: a five-layer convolutional network encodes
the wrench window of each action; together with the other measurements of that action it forms one token; a
transformer processes all tokens, followed by a maximum over time.
"""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Bool, Float, Int

from mjx_fit.config.sections.learning import SensorConfig
from mjx_fit.sensors.attention import attend
from mjx_fit.sensors.pooling import Pooled, after_each_row, code_of, join, of_rows
from mjx_fit.types import Array
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.pytrees import pytree
from mjx_fit.utils.rates import SUBSTEPS

WRENCH_AXES = 6
PLACE_AXES = 4
_Keys = tuple[Float[Array, "batch heads rows d"], Float[Array, "batch heads rows d"]]


class WrenchEncoder(nnx.Module):
    """Five convolutions over time, kernel 2 and stride 2: 50 -> 25 -> 13 -> 7 -> 4 -> 2 steps.

    A convolution whose stride equals its kernel size is a reshape and a matrix product, and is implemented as
    such: XLA's convolutions are many times slower on a CPU. Odd lengths are zero-padded in front.
    """

    def __init__(self, channels: tuple[int, ...], rngs: nnx.Rngs):
        """Build one layer per entry of ``channels``."""
        sizes = (WRENCH_AXES, *channels)
        self.layers = nnx.List(
            [nnx.Linear(2 * before, after, rngs=rngs) for before, after in pairwise(sizes)]
        )
        steps = SUBSTEPS
        for _ in channels:
            steps = (steps + 1) // 2
        self.out_features = steps * channels[-1]

    def __call__(self, wrench: Float[Array, "*batch 50 6"]) -> Float[Array, "*batch features"]:
        """Encode standardised wrench windows."""
        x = wrench
        for layer in self.layers:
            *batch, steps, channels = x.shape
            if steps % 2:
                x = jnp.pad(x, [(0, 0)] * len(batch) + [(1, 0), (0, 0)])
            # Flatten to one table of rows: with more axes XLA's gradient takes twice as long on a CPU.
            rows = nnx.leaky_relu(layer(x.reshape(-1, 2 * channels)))
            x = rows.reshape(*batch, (steps + 1) // 2, -1)
        return x.reshape(*x.shape[:-2], -1)


class DecoderBlock(nnx.Module):
    """Self-attention and feed-forward layers, each with pre-norm and a skip connection.

    The paper's "transformer decoder" has no second sequence to attend to, so this is a decoder-only block.
    Pre-norm trains without learning-rate warm-up.
    """

    def __init__(self, config: SensorConfig, rngs: nnx.Rngs):
        """Build the layers."""
        width = config.width
        self.heads, self.causal = config.heads, config.causal
        self.attention_norm = nnx.LayerNorm(width, rngs=rngs)
        # No bias: a bias on the keys cancels in the softmax, and one on the values adds to the output's.
        self.query_key_value = nnx.Linear(width, 3 * width, use_bias=False, rngs=rngs)
        self.attention_out = nnx.Linear(width, width, rngs=rngs)
        self.feedforward_norm = nnx.LayerNorm(width, rngs=rngs)
        self.up = nnx.Linear(width, config.feedforward, rngs=rngs)
        self.down = nnx.Linear(config.feedforward, width, rngs=rngs)
        self.dropout = nnx.Dropout(config.dropout)

    def __call__(
        self, x: Float[Array, "rows width"], mask: Bool[Array, "batch L"], rngs: nnx.Rngs | None
    ) -> Float[Array, "rows width"]:
        """Attend to the real rows only; ``rngs`` enables dropout. Rows are batch times L."""
        qkv = self.query_key_value(self.attention_norm(x))
        # (3, batch, heads, L, d)
        query, key, value = qkv.reshape(*mask.shape, 3, self.heads, -1).transpose(2, 0, 3, 1, 4)
        attended = attend(query, key, value, mask, causal=self.causal).swapaxes(1, 2)
        x = x + self._drop(self.attention_out(attended.reshape(x.shape)), rngs)
        hidden = nnx.relu(self.up(self.feedforward_norm(x)))
        return x + self._drop(self.down(hidden), rngs)

    def add(
        self, x: Float[Array, "batch width"], past: "_Keys", step: Int[Array, ""]
    ) -> tuple[Float[Array, "batch width"], "_Keys"]:
        """Process the row ``step`` given the keys and values of the rows before it."""
        qkv = self.query_key_value(self.attention_norm(x))
        # (3, batch, heads, 1, d)
        query, key, value = qkv.reshape(len(x), 3, self.heads, 1, -1).swapaxes(0, 1)
        keys, values = (
            jax.lax.dynamic_update_slice_in_dim(old, new, step, axis=2)
            for old, new in zip(past, (key, value), strict=True)
        )
        seen = jnp.broadcast_to(jnp.arange(keys.shape[2]) <= step, (len(x), keys.shape[2]))
        attended = attend(query, keys, values, seen).reshape(x.shape)
        x = x + self.attention_out(attended)
        return x + self.down(nnx.relu(self.up(self.feedforward_norm(x)))), (keys, values)

    def _drop(self, x: Float[Array, "*batch width"], rngs: nnx.Rngs | None) -> Float[Array, "*batch width"]:
        return self.dropout(x, deterministic=rngs is None, rngs=rngs)


@pytree
class Past:
    """What an encoder keeps of a trace that grows.

    Attributes:
        keys: Keys and values of the attention, for each block.
        pooled: The rows so far, pooled.
    """

    keys: tuple[_Keys, ...]
    pooled: Pooled


class TraceEncoder(nnx.Module):
    """e1: wrench encoder, token, transformer, maximum over time."""

    def __init__(self, config: SensorConfig, row_features: int, rngs: nnx.Rngs):
        """Build the layers.

        Args:
            config: Sizes of the layers.
            row_features: Number of inputs per action other than its wrench window.
            rngs: Random keys of the initial weights.
        """
        if config.width % config.heads:
            raise RequestError(
                f"config: sensor.heads: {config.heads} is invalid: "
                f"expected a divisor of sensor.width ({config.width})"
            )
        self.positional = config.positional
        self.wrench_encoder = WrenchEncoder(config.conv_channels, rngs)
        self.token = nnx.Linear(self.wrench_encoder.out_features + row_features, config.width, rngs=rngs)
        self.blocks = nnx.List([DecoderBlock(config, rngs) for _ in range(config.layers)])
        self.norm = nnx.LayerNorm(config.width, rngs=rngs)
        self.place_scores = nnx.Linear(config.width, config.places, rngs=rngs) if config.places else None
        self.width, self.n_places = config.width, config.places
        self.out_features = config.width + config.places * PLACE_AXES

    def __call__(
        self,
        wrench: Float[Array, "batch L 50 6"],
        rows: Float[Array, "batch L features"],
        places: Float[Array, "batch L 4"],
        mask: Bool[Array, "batch L"],
        rngs: nnx.Rngs | None,
        *,
        every_row: bool = False,
    ) -> Float[jax.Array, "batch *L features"]:
        """Encode traces; traces without real rows are encoded as zeros.

        Args:
            wrench: Standardised wrench windows.
            rows: Standardised inputs other than the wrench windows.
            places: TCP positions and centres of pressure; their weighted means are appended to the code, so
                that positions reach the heads without being encoded by the network.
            mask: True for real rows.
            rngs: Random keys of dropout; None disables it.
            every_row: Encode the trace up to each row instead of the whole; for causal encoders.
        """
        measured = jnp.concatenate([self.wrench_encoder(wrench), rows], axis=-1)
        x = self.token(measured.reshape(mask.size, -1))
        if self.positional:
            place = _sinusoids(mask.shape[1], x.shape[1]).astype(x.dtype)
            x = (x.reshape(*mask.shape, -1) + place).reshape(x.shape)
        for block in self.blocks:
            x = block(x, mask, rngs)
        codes = self.norm(x).reshape(*mask.shape, -1)
        if every_row:
            return code_of(after_each_row(of_rows(*self._pooled_inputs(codes), places, mask)))
        code = jnp.where(mask[..., None], codes, -jnp.inf).max(axis=1)
        if self.place_scores is not None:
            scores = jnp.where(mask[..., None], self.place_scores(codes), -jnp.inf)
            means = jnp.einsum("blk,bld->bkd", jax.nn.softmax(scores, axis=1), places)
            code = jnp.concatenate([code, means.reshape(len(means), -1)], axis=-1)
        return jnp.where(jnp.any(mask, axis=1)[:, None], code, 0)

    def begin(self, batch: int, rows: int) -> Past:
        """Return the past of traces without rows yet.

        Args:
            batch: Number of traces.
            rows: Most rows that a trace will have.
        """
        heads = self.blocks[0].heads
        empty = jnp.zeros((batch, heads, rows, self.width // heads))
        nothing = jnp.zeros((batch, self.width)), jnp.zeros((batch, self.n_places))
        pooled = of_rows(*nothing, jnp.zeros((batch, PLACE_AXES)), jnp.zeros(batch, bool))
        return Past(tuple((empty, empty) for _ in self.blocks), pooled)

    def add(
        self, past: Past, measured: tuple[Array, Array, Array], step: Int[Array, ""]
    ) -> tuple[Past, Float[jax.Array, "batch features"]]:
        """Encode traces with one more row, without computing the earlier rows again.

        Args:
            past: The rows before.
            measured: Wrench windows (batch, 50, 6), other inputs (batch, features) and places (batch, 4) of
                the new row, as in a call.
            step: Index of the row.

        Returns:
            The past with this row, and the code of the trace up to it.
        """
        wrench, rows, places = measured
        x = self.token(jnp.concatenate([self.wrench_encoder(wrench), rows], axis=-1))
        if self.positional:
            x = x + jnp.asarray(_sinusoids(past.keys[0][0].shape[2], self.width), x.dtype)[step]
        keys = []
        for block, before in zip(self.blocks, past.keys, strict=True):
            x, after = block.add(x, before, step)
            keys.append(after)
        now = of_rows(*self._pooled_inputs(self.norm(x)), places, jnp.ones(len(x), bool))
        pooled = join(past.pooled, now)
        return Past(tuple(keys), pooled), code_of(pooled)

    def _pooled_inputs(self, codes: Float[jax.Array, "*batch width"]) -> tuple[jax.Array, jax.Array]:
        """Return the codes of rows, and their scores for the mean places."""
        none = jnp.zeros((*codes.shape[:-1], 0))
        return codes, none if self.place_scores is None else self.place_scores(codes)


def _sinusoids(length: int, width: int) -> Float[np.ndarray, "L width"]:
    """Compute the positional encoding of Vaswani et al. (2017): sin and cos of t / 10000^(2 i / width)."""
    angle = np.arange(length)[:, None] / 10000 ** (2 * np.arange(width // 2) / width)
    return np.concatenate([np.sin(angle), np.cos(angle)], axis=-1)
