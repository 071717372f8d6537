"""Validate the inputs of a belief update on the host, once per batch."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.filters.belief_check import require_beliefs
from mjx_fit.sensors.traces import require_readable
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
    if not jnp.issubdtype(keys.dtype, jax.dtypes.prng_key) or keys.shape != (n,):
        raise RequestError(
            f"keys: {keys.dtype} {keys.shape} is invalid: expected ({n},) keys from jax.random.key"
        )


def require_places(detections: Any, reach: tuple[float, float]) -> Float[np.ndarray, "n 2"]:
    """Return detections as an array (n, 2), m, after a check that all are within the robot's reach.

    Raises:
        RequestError: A detection is out of reach, or the array is empty; the message names the cause.
    """
    places = np.asarray(detections, np.float32)
    if places.ndim != 2 or places.shape[1] != 2 or not len(places):
        raise RequestError(f"detections: shape {places.shape} is invalid: expected (n, 2) with n >= 1")
    distance = np.linalg.norm(places, axis=1)
    wrong = ~((distance >= reach[0]) & (distance <= reach[1]))
    if wrong.any():
        row = int(wrong.argmax())
        x, y = places[row].tolist()
        raise RequestError(
            f"detections: ({x:.6g}, {y:.6g}) of hole {row} is invalid: expected {reach[0]} to "
            f"{reach[1]} m from the robot's base"
        )
    return places


def require_no_sensor(sensor: object | None) -> None:
    """Refuse a sensor beside the geometry of the parts, which would silently read in its place."""
    if sensor is not None:
        raise RequestError(
            "config: filter.reads: geometry cannot be combined with a trained sensor: set "
            "filter.reads=sensor, or leave the sensor out"
        )
