"""Validate the inputs of a belief update on the host, once per batch."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.filters.belief_check import require_beliefs
from mjx_fit.filters.contact_memory import require_memory
from mjx_fit.sensors.traces import require_readable
from mjx_fit.sensors.trained_sensor import TrainedSensor
from mjx_fit.types import Belief, Felt
from mjx_fit.utils.errors import RequestError


def require_update(beliefs: Belief, felt: Felt, keys: Any, config: Config) -> None:
    """Check that n beliefs, the measurements of n attempts and n noise keys are valid for an update.

    Args:
        beliefs: Prior of each hole, (n,).
        felt: Measurements of each attempt, (n,).
        keys: Seeds of the noise, (n,).
        config: Defines the shapes and the coordinates of beliefs.

    Raises:
        RequestError: A field has an invalid shape or value; the message names it.
    """
    n_types, d = config.scene.n_types, len(config.filter.coordinates)
    require_readable(felt, n_types, d=d)
    n = len(felt.length)
    require_beliefs(beliefs, n, n_types, d=d)
    require_memory(beliefs, config)
    if not jnp.issubdtype(keys.dtype, jax.dtypes.prng_key) or keys.shape != (n,):
        raise RequestError(
            f"keys: {keys.dtype} {keys.shape} is invalid: expected ({n},) keys from jax.random.key"
        )


def require_places(detections: Any, reach: tuple[float, float], config: Config) -> Float[np.ndarray, "n d"]:
    """Return detections as an array (n, 2) or (n, D), after a check that all are within the robot's reach.

    Raises:
        RequestError: A detection is out of reach, or the array is empty; the message names the cause.
    """
    places, d = np.asarray(detections, np.float32), len(config.filter.coordinates)
    if places.ndim != 2 or places.shape[1] not in (2, d) or not len(places):
        expected = "(n, 2)" if d == 2 else f"(n, 2) or (n, {d})"
        raise RequestError(f"detections: shape {places.shape} is invalid: expected {expected} with n >= 1")
    for row, place in enumerate(places[:, 2:]):
        if not np.isfinite(place).all():
            raise RequestError(
                f"detections: {place.tolist()} of hole {row} is invalid: expected finite numbers"
            )
    distance = np.linalg.norm(places[:, :2], axis=1)
    wrong = ~((distance >= reach[0]) & (distance <= reach[1]))
    if wrong.any():
        row = int(wrong.argmax())
        x, y = places[row, :2].tolist()
        raise RequestError(
            f"detections: ({x:.6g}, {y:.6g}) of hole {row} is invalid: expected {reach[0]} to "
            f"{reach[1]} m from the robot's base"
        )
    return places


def settings_of(sensor: TrainedSensor | None, config: Config | None) -> Config:
    """Return the settings of a tracker: a sensor's, or those of a filter that needs none.

    Raises:
        RequestError: The settings are not those of the sensor, or there is none and they ask for one.
    """
    if sensor is not None:
        return sensor.adapt(config or sensor.config)
    if config is None or config.filter.reads != "geometry":
        raise RequestError(
            "sensor: None cannot be used: expected a trained sensor, or a config with filter.reads=geometry"
        )
    return config


def require_no_sensor(sensor: object | None) -> None:
    """Refuse a sensor beside the geometry of the parts, which would silently read in its place."""
    if sensor is not None:
        raise RequestError(
            "config: filter.reads: geometry cannot be combined with a trained sensor: set "
            "filter.reads=sensor, or leave the sensor out"
        )
