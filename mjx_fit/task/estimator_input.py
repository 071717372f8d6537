"""Validate the inputs of a belief update on the host, once per batch."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.sensors.traces import require_readable
from mjx_fit.types import Belief, Felt
from mjx_fit.utils.errors import RequestError

_SUM_TOLERANCE = 1e-3


def require_update(beliefs: Belief, felt: Felt, keys: Any, n_types: int) -> None:
    """Check that n beliefs, the measurements of n attempts and n noise keys are valid for an update.

    Args:
        beliefs: Prior of each hole, (n,).
        felt: Measurements of each attempt, (n,).
        keys: Seeds of the noise, (n,).
        n_types: Number of shapes in the scene and in the sensor.

    Raises:
        RequestError: A field has an invalid shape or value; the message names it.
    """
    require_readable(felt, n_types)
    n = len(felt.length)
    require_beliefs(beliefs, n, n_types)
    if not jnp.issubdtype(keys.dtype, jax.dtypes.prng_key) or keys.shape != (n,):
        _refuse("keys", f"{keys.dtype} {keys.shape}", f"expected ({n},) keys from jax.random.key")


def require_beliefs(beliefs: Belief, n: int, n_types: int) -> None:
    """Check that n beliefs over n_types shapes are valid.

    Means must be finite, covariances positive definite, and the exponentials of type_logp must sum to 1.

    Raises:
        RequestError: A belief is invalid; the message names the field and the row.
    """
    for name, shape in (("pos_mean_world", (2,)), ("pos_cov", (2, 2)), ("type_logp", (n_types,))):
        given = np.shape(getattr(beliefs, name))
        if given != (n, *shape):
            _refuse(f"belief: {name}", f"shape {given}", f"expected {(n, *shape)}")
    mean, cov, logp = (np.asarray(leaf, np.float64) for leaf in jax.tree.leaves(beliefs))
    with np.errstate(all="ignore"):
        a, b, c, d = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 0], cov[:, 1, 1]
        symmetric = abs(b - c) <= 1e-3 * np.sqrt(a * d)
        is_covariance = np.isfinite(cov).all((1, 2)) & (a > 0) & (d > 0) & (a * d - b * c > 0) & symmetric
        adds_up = abs(np.exp(logp).sum(1) - 1) <= _SUM_TOLERANCE
    for name, leaf, good, allowed in (
        ("pos_mean_world", mean, np.isfinite(mean).all(1), "expected finite"),
        ("pos_cov", cov, is_covariance, "expected finite, symmetric and positive definite"),
        ("type_logp", logp, adds_up, "expected exponentials that sum to 1"),
    ):
        if not good.all():
            row = int(good.argmin())
            shown = [float(f"{number:.4g}") for number in leaf[row].ravel()]
            _refuse(f"belief: {name} of row {row}", str(shown), allowed)


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


def _refuse(name: str, value: str, allowed: str) -> None:
    raise RequestError(f"{name}: {value} is invalid: {allowed}")
