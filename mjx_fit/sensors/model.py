"""The learned contact sensor: a reading of an attempt becomes an observation that the filters understand."""

import math

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Float

from mjx_fit.config import SensorConfig
from mjx_fit.sensors.encoder import WRENCH_AXES, TraceEncoder
from mjx_fit.sensors.heads import MatchModel, PositionNoise, SkipMLP
from mjx_fit.types import Array, Observation, Reading

METRES_PER_CM = 0.01
ROW_FEATURES = 3 + 4 + 3 + 3 + 1 + 3
MIN_INPUT_STD = 1e-4
"""In SI units; an input that varies less over the training set is taken for constant and not blown up."""


class InputScale(nnx.Variable):
    """Mean and standard deviation of inputs over the training set: kept with the model, not trained."""


class ContactSensor(nnx.Module):
    """Encoders e1 and e2, virtual sensors h_pos and h_match, noise models R and H (figure 3 of the paper).

    Readings and observations are in SI units. Inside, inputs are standardised and lengths are in cm.
    """

    def __init__(self, config: SensorConfig, rngs: nnx.Rngs, n_types: int = 3):
        """Build the network; call ``fit_input_scale`` with training readings before it is trained.

        Raises:
            RequestError: The heads do not divide the width.
        """
        self.wrench_scale = InputScale(jnp.stack([jnp.zeros(WRENCH_AXES), jnp.ones(WRENCH_AXES)]))
        self.row_scale = InputScale(jnp.stack([jnp.zeros(ROW_FEATURES), jnp.ones(ROW_FEATURES)]))
        self.trace_encoder = TraceEncoder(config, ROW_FEATURES, rngs)
        self.peg_encoder = nnx.Embed(n_types, config.width, rngs=rngs)
        self.position = SkipMLP(2 * config.width, 2, rngs)
        self.match = SkipMLP(2 * config.width, 2, rngs)
        self.position_noise = PositionNoise(n_types, rngs)
        self.match_model = MatchModel(n_types, rngs)

    def __call__(self, reading: Reading, rngs: nnx.Rngs | None = None) -> Observation:
        """Observe.

        Args:
            reading: Any batch axes. What padding rows hold makes no difference.
            rngs: Source of dropout while training; None at test.
        """
        batch = reading.mask.shape[:-1]
        flat = jax.tree.map(lambda x: x.reshape(math.prod(batch), *x.shape[len(batch) :]), reading)
        # Zeroed before anything is computed, so that not even a NaN in the padding can spread.
        wrench = jnp.where(
            flat.mask[..., None, None], _standard(flat.wrench_sensor, self.wrench_scale[...]), 0
        )
        rows = jnp.where(flat.mask[..., None], _standard(row_features(flat), self.row_scale[...]), 0)
        trace_code = self.trace_encoder(wrench, rows, flat.mask, rngs)
        code = jnp.concatenate([trace_code, self.peg_encoder(flat.peg_type)], axis=-1)
        observation = Observation(
            innovation=self.position(code) * METRES_PER_CM,
            pos_noise_cov=self.position_noise(flat.peg_type) * METRES_PER_CM**2,
            match_logits=self.match(code),
            match_model_logp=self.match_model(flat.peg_type),
        )
        return jax.tree.map(lambda x: x.reshape(*batch, *x.shape[1:]), observation)

    def fit_input_scale(self, reading: Reading) -> None:
        """Standardise inputs as the real rows of these readings are distributed."""
        self.wrench_scale[...] = _moments(reading.wrench_sensor, reading.mask[..., None])
        self.row_scale[...] = _moments(row_features(reading), reading.mask)


def row_features(reading: Reading) -> Float[Array, "*batch L features"]:
    """All that a token is told beside its wrench window, in SI units."""
    return jnp.concatenate(
        [
            reading.action_world,
            reading.tip_pos_estimate,
            reading.tip_quat_world,
            reading.tip_linvel_world,
            reading.tip_angvel_world,
            reading.contact[..., None],
        ],
        axis=-1,
    )


def _standard(x: Float[Array, "*batch n"], scale: Float[Array, "2 n"]) -> Float[Array, "*batch n"]:
    return (x - scale[0]) / scale[1]


def _moments(x: Float[Array, "*batch n"], mask) -> Float[Array, "2 n"]:
    """Mean and standard deviation over all axes but the last, of the entries that the mask keeps."""
    axes, where = tuple(range(x.ndim - 1)), mask[..., None]
    std = jnp.std(x, axes, where=where)
    return jnp.stack([jnp.mean(x, axes, where=where), jnp.maximum(std, MIN_INPUT_STD)])
