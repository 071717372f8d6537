"""What an update of beliefs can be given: checked on the host, once for each batch."""

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
    """Makes sure that n beliefs can be updated by what was felt in n attempts, with n keys of noise.

    Args:
        beliefs: (n,).
        felt: (n,).
        keys: (n,).
        n_types: Number of shapes: of the scene, and of the sensor.

    Raises:
        RequestError: A field has another shape, or a value that is invalid; the message names it.
    """
    require_readable(felt, n_types)
    n = len(felt.length)
    require_beliefs(beliefs, n, n_types)
    if not jnp.issubdtype(keys.dtype, jax.dtypes.prng_key) or keys.shape != (n,):
        _refuse("keys", f"{keys.dtype} {keys.shape}", f"they must be ({n},), as jax.random.key makes them")


def require_beliefs(beliefs: Belief, n: int, n_types: int) -> None:
    """Makes sure that n beliefs about n_types shapes are such.

    Means must be finite, covariances positive definite, and type_logp must hold probabilities.

    Raises:
        RequestError: One is not; the message names the field and the row.
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
        ("type_logp", logp, adds_up, "the exponentials must add up to 1"),
    ):
        if not good.all():
            row = int(good.argmin())
            shown = [float(f"{number:.4g}") for number in leaf[row].ravel()]
            _refuse(f"belief: {name} of row {row}", str(shown), allowed)


def require_places(detections: Any, reach: tuple[float, float]) -> Float[np.ndarray, "n 2"]:
    """Detections (n, 2) as an array, m, if all are within reach of the robot's base.

    Raises:
        RequestError: One is not, or there is none; the message names it.
    """
    places = np.asarray(detections, np.float32)
    if places.ndim != 2 or places.shape[1] != 2 or not len(places):
        raise RequestError(f"detections: shape {places.shape} is invalid: expected (n, 2), n of 1 or more")
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
