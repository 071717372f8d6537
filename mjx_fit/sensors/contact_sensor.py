"""Learned contact sensor, which maps the reading of an attempt to an observation for the filters."""

import math
from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.filter import PLANAR
from mjx_fit.config.sections.learning import SensorConfig
from mjx_fit.filters import chart
from mjx_fit.sensors.encoder import WRENCH_AXES, Past, TraceEncoder
from mjx_fit.sensors.features import (
    CONTACT_FEATURES,
    MEASURABLE,
    ROW_FEATURES,
    contact_features,
    contact_position,
    row_features,
)
from mjx_fit.sensors.heads import MatchModel, PositionNoise, SkipMLP
from mjx_fit.sensors.traces import require_reading
from mjx_fit.types import Array, Observation, Reading
from mjx_fit.utils.errors import RequestError

METRES_PER_CM = 0.01
MIN_INPUT_STD = 1e-4
"""Smallest input standard deviation, SI units: inputs with less variation are not scaled up further."""


class InputScale(nnx.Variable):
    """Mean and standard deviation of inputs over the training set: stored with the model, not trained."""


class ContactSensor(nnx.Module):
    """Encoders e1 and e2, virtual sensors h_pos and h_match, noise models R and H (figure 3 of the paper).

    Readings and observations are in SI units. Internally, inputs are standardised, lengths are in cm and
    angles in 0.1 rad.

    The setting ``reference: final`` gives the paper's frame-by-frame baseline: its input positions and its
    position estimate are relative to the final TCP position instead of the hole estimate. The returned
    innovation is still relative to the estimate, and R is the covariance of the hole's position itself.
    """

    def __init__(
        self,
        config: SensorConfig,
        rngs: nnx.Rngs,
        n_types: int = 3,
        coordinates: Sequence[str] = PLANAR,
    ):
        """Build the network; call ``fit_input_scale`` with training readings before training.

        Args:
            config: Sizes of the network.
            rngs: Random keys of the weights.
            n_types: Number of shapes.
            coordinates: What the innovation is about (``filter.coordinates``).

        Raises:
            RequestError: The width is not divisible by the number of heads.
        """
        self.from_final_position = config.reference == "final"
        self.wrench_scale = InputScale(jnp.stack([jnp.zeros(WRENCH_AXES), jnp.ones(WRENCH_AXES)]))
        self.tells_contact, self.from_start = config.contact_features, config.pose == "start"
        n_rows = ROW_FEATURES - self.from_start + CONTACT_FEATURES * self.tells_contact
        self.row_scale = InputScale(jnp.stack([jnp.zeros(n_rows), jnp.ones(n_rows)]))
        self.trace_encoder = TraceEncoder(config, n_rows, rngs)
        code_width = self.trace_encoder.out_features + config.width
        self.peg_encoder = nnx.Embed(n_types, config.width, rngs=rngs)
        d, self.units = len(coordinates), chart.units(coordinates)
        self.position = SkipMLP(code_width, d, rngs)
        self.match = SkipMLP(code_width, 2, rngs)
        self.position_noise = PositionNoise(n_types, code_width, config.noise == "trace", rngs, d)
        self.match_model = MatchModel(n_types, rngs)

    @staticmethod
    def of(config: Config, rngs: nnx.Rngs) -> "ContactSensor":
        """Build the network for a scene and the coordinates of its beliefs."""
        return ContactSensor(config.sensor, rngs, config.scene.n_types, config.filter.coordinates)

    def __call__(
        self, reading: Reading, rngs: nnx.Rngs | None = None, *, every_row: bool = False
    ) -> Observation:
        """Compute the observation of a reading.

        Args:
            reading: Reading with any batch axes; the content of padding rows is ignored.
            rngs: Random keys of dropout in training; None at test time.
            every_row: Compute the observation after each row, with the time as the last batch axis.

        Raises:
            RequestError: A field of the reading has the wrong shape or is not finite (``sensors.traces``), or
                the sensor cannot read a trace that grows and ``every_row`` is set.
        """
        if every_row:
            self._require_growing()
        require_reading(reading, self.match_model.n_types)
        batch = reading.mask.shape[:-1]
        flat = jax.tree.map(lambda x: x.reshape(math.prod(batch), *x.shape[len(batch) :]), reading)
        origin = jnp.zeros((len(flat.peg_type), 2))
        if self.from_final_position:
            origin = final_position(flat)
            flat = seen_from(flat, origin)
        # Zero the padding before any computation, so that not even a NaN in it can spread.
        wrench, rows, places = self._inputs(flat)
        wrench = jnp.where(flat.mask[..., None, None], wrench, 0)
        rows, places = (jnp.where(flat.mask[..., None], x, 0) for x in (rows, places))
        trace_code = self.trace_encoder(wrench, rows, places, flat.mask, rngs, every_row=every_row)
        peg_type = jnp.asarray(flat.peg_type)
        if every_row:
            peg_type = jnp.broadcast_to(peg_type[:, None], flat.mask.shape)
        observation = self._observation(trace_code, peg_type, origin)
        return jax.tree.map(lambda x: x.reshape(*batch, *x.shape[1:]), observation)

    def begin(self, rows: int) -> Past:
        """Return the past of an attempt without actions yet, for ``add``.

        Args:
            rows: Most actions of the attempt.

        Raises:
            RequestError: The sensor cannot read a trace that grows.
        """
        self._require_growing()
        return self.trace_encoder.begin(1, rows)

    def add(self, past: Past, reading: Reading, step: Int[Array, ""]) -> tuple[Past, Observation]:
        """Compute the observation of one attempt after one more action, from that action alone.

        Args:
            past: What earlier actions left.
            reading: Reading of the new action, one row.
            step: Index of the action.

        Returns:
            The past with this action, and the observation.
        """
        measured = self._inputs(reading)
        past, code = self.trace_encoder.add(past, measured, step)
        observation = self._observation(code, jnp.asarray(reading.peg_type)[None], jnp.zeros((1, 2)))
        return past, jax.tree.map(lambda x: x[0], observation)

    def _require_growing(self) -> None:
        if not self.trace_encoder.blocks[0].causal or self.from_final_position:
            raise RequestError(
                "sensor: it cannot read an attempt in progress: train one with sensor.causal true and "
                "sensor.reference estimate"
            )

    def _inputs(self, reading: Reading) -> tuple[Array, Array, Array]:
        """Return standardised wrenches and other inputs, and the places in cm."""
        at = jnp.concatenate([reading.tip_pos_estimate[..., :2], contact_position(reading)], axis=-1)
        wrench = _standard(reading.wrench_sensor, self.wrench_scale[...])
        return wrench, _standard(self._rows(reading), self.row_scale[...]), at / METRES_PER_CM

    def _observation(
        self,
        trace_code: Float[jax.Array, "n *L f"],
        peg_type: Int[jax.Array, "n *L"],
        origin: Float[Array, "n 2"],
    ) -> Observation:
        code = jnp.concatenate([trace_code, self.peg_encoder(peg_type)], axis=-1)
        if code.ndim > origin.ndim:
            origin = origin[:, None]
        units, squared = (np.asarray(x, np.float32) for x in (self.units, np.outer(self.units, self.units)))
        offset = jnp.pad(origin, [(0, 0)] * (origin.ndim - 1) + [(0, len(units) - 2)])
        return Observation(
            innovation=offset + self.position(code) * units,
            pos_noise_cov=self.position_noise(peg_type, code) * squared,
            match_logits=self.match(code),
            match_model_logp=self.match_model(peg_type),
        )

    def fit_input_scale(self, reading: Reading) -> None:
        """Fit the input standardisation to the real rows of readings (n, L, ...)."""
        if self.from_final_position:
            reading = seen_from(reading, final_position(reading))
        self.wrench_scale[...] = _moments(reading.wrench_sensor, reading.mask[..., None])
        scale = _moments(self._rows(reading), reading.mask)
        if self.from_start:
            scale = jnp.stack([scale[0], jnp.maximum(scale[1], MEASURABLE[: scale.shape[1]])])
        self.row_scale[...] = scale

    def _rows(self, reading: Reading) -> Float[Array, "*batch L features"]:
        rows = row_features(reading, as_vector=self.from_start)
        return jnp.concatenate([rows, contact_features(reading)], axis=-1) if self.tells_contact else rows


def final_position(reading: Reading) -> Float[Array, "n 2"]:
    """Return the TCP position in the last real row, relative to the estimate, m."""
    last = jnp.maximum(reading.mask.sum(-1) - 1, 0)
    return jnp.take_along_axis(reading.tip_pos_estimate, last[:, None, None], axis=1)[:, 0, :2]


def seen_from(reading: Reading, origin: Float[Array, "n 2"]) -> Reading:
    """Shift the horizontal positions of a reading to an origin, given relative to the estimate, m."""
    offset = jnp.pad(origin, ((0, 0), (0, 1)))[:, None]
    return replace(reading, tip_pos_estimate=reading.tip_pos_estimate - offset)


def _standard(x: Float[Array, "*batch n"], scale: Float[Array, "2 n"]) -> Float[Array, "*batch n"]:
    return (x - scale[0]) / scale[1]


def _moments(x: Float[Array, "*batch n"], mask) -> Float[Array, "2 n"]:
    """Compute mean and standard deviation of the unmasked entries over all axes but the last."""
    axes, where = tuple(range(x.ndim - 1)), mask[..., None]
    std = jnp.std(x, axes, where=where)
    return jnp.stack([jnp.mean(x, axes, where=where), jnp.maximum(std, MIN_INPUT_STD)])
