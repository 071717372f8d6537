"""Check beliefs on the host."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from mjx_fit.types import Belief
from mjx_fit.utils.errors import RequestError

_SUM_TOLERANCE = 1e-3


def require_beliefs(
    beliefs: Belief, n: int, n_types: int, active: Bool[np.ndarray, "n"] | None = None, d: int = 2
) -> None:
    """Check that n beliefs over n_types shapes are valid.

    Means must be finite, covariances positive definite, and the exponentials of type_logp must sum to 1.

    Args:
        beliefs: The beliefs, (n,).
        n: Number of beliefs.
        n_types: Number of shapes.
        active: Rows to check; None: all.
        d: Number of believed coordinates.

    Raises:
        RequestError: A belief is invalid; the message names the field and the row.
    """
    for name, shape in (("mean_world", (d,)), ("cov", (d, d)), ("type_logp", (n_types,))):
        leaf = getattr(beliefs, name)
        if np.shape(leaf) != (n, *shape) or not jnp.issubdtype(leaf.dtype, jnp.floating):
            found = f"{leaf.dtype} {np.shape(leaf)}"
            raise RequestError(f"belief: {name}: {found} is invalid: expected floats {(n, *shape)}")
    mean, cov, logp = (
        np.asarray(leaf, np.float64) for leaf in (beliefs.mean_world, beliefs.cov, beliefs.type_logp)
    )
    with np.errstate(all="ignore"):
        spread = np.sqrt(np.einsum("nii->ni", cov))
        correlation = cov / (spread[:, :, None] * spread[:, None, :])
        symmetric = (abs(correlation - np.swapaxes(correlation, 1, 2)) <= 1e-3).all((1, 2))
        known = np.where(np.isfinite(correlation).all((1, 2), keepdims=True), correlation, -np.eye(d))
        is_covariance = symmetric & (np.linalg.eigvalsh(known).min(1) > 0)
        adds_up = abs(np.exp(logp).sum(1) - 1) <= _SUM_TOLERANCE
    for name, leaf, good, allowed in (
        ("mean_world", mean, np.isfinite(mean).all(1), "expected finite"),
        ("cov", cov, is_covariance, "expected finite, symmetric and positive definite"),
        ("type_logp", logp, adds_up, "expected exponentials that sum to 1"),
    ):
        wrong = ~good if active is None else ~good & active
        if wrong.any():
            row = int(wrong.argmax())
            shown = [float(f"{number:.4g}") for number in leaf[row].ravel()]
            raise RequestError(f"belief: {name} of row {row}: {shown} is invalid: {allowed}")
