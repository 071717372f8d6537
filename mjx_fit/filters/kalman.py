"""Kalman filter for the place of a static hole: Algorithm 2 of the paper, for any number D of coordinates.

All functions are pure and accept any number of leading batch axes. A covariance that is not positive definite
gives NaN for its own batch entry only.
"""

from collections.abc import Sequence
from functools import cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from mjx_fit.types import Array
from mjx_fit.utils.linalg import cholesky_factor, cholesky_solve, solve_lower

CM_PER_M = 100.0
_MOST_SHARE = 0.999
"""Largest share of the information that correlated readings can ever give; more would make R infinite."""


def update(
    mean: Float[Array, "*batch D"],
    cov: Float[Array, "*batch D D"],
    innovation: Float[Array, "*batch D"],
    noise_cov: Float[Array, "*#batch D D"],
) -> tuple[Float[Array, "*batch D"], Float[Array, "*batch D D"]]:
    """Condition N(μ, Σ) on an observation o = x + v, v ~ N(0, R), given as the innovation o - μ.

    K = Σ (Σ + R)⁻¹,  μ' = μ + K (o - μ),  Σ' = (I - K) Σ (I - K)ᵀ + K R Kᵀ

    The covariance update is the Joseph form of Algorithm 2's (I - K) Σ: mathematically equal, but a sum of
    two positive semi-definite matrices, so rounding to float32 cannot make it indefinite.

    Args:
        mean: Prior mean μ, m and rad.
        cov: Prior covariance Σ, positive definite.
        innovation: Innovation o - μ.
        noise_cov: Observation noise covariance R, positive semi-definite and finite.

    Returns:
        Posterior mean μ' and covariance Σ', exactly symmetric.

    Example:
        >>> import jax.numpy as jnp, mjx_fit as mf
        >>> cov = 1e-4 * jnp.eye(2)
        >>> mean, posterior = mf.kalman_update(jnp.zeros(2), cov, jnp.array([0.01, 0.0]), cov)
        >>> [round(float(x), 4) for x in mean]
        [0.005, 0.0]
    """
    cov, noise_cov = jnp.broadcast_arrays(cov, noise_cov)
    root = cholesky_factor(_axes_first(_symmetric(cov + noise_cov)))
    # Both Σ and Σ + R are symmetric, so the solution X of (Σ + R) X = Σ is Kᵀ.
    gain = _transpose(jnp.moveaxis(cholesky_solve(root, _axes_first(cov)), (0, 1), (-2, -1)))
    residual = jnp.eye(mean.shape[-1], dtype=mean.dtype) - gain
    new_mean = mean + (gain * innovation[..., None, :]).sum(-1)
    return new_mean, _symmetric(sandwich(residual, cov) + sandwich(gain, noise_cov))


def gain_of(cov: Float[Array, "*batch D D"], model: Float[Array, "*batch k D"]) -> Float[Array, "*batch D k"]:
    """Return cov(x, H x) cov(H x)⁻¹ = Σ Hᵀ (H Σ Hᵀ)⁻¹: by how much x moves with H x."""
    seen = product(model, cov)
    root = cholesky_factor(_axes_first(_symmetric(product(seen, _transpose(model)))))
    return _transpose(jnp.moveaxis(cholesky_solve(root, _axes_first(seen)), (0, 1), (-2, -1)))


def gated(
    cov: Float[Array, "*batch D D"],
    innovation: Float[Array, "*batch D"],
    noise_cov: Float[Array, "*#batch D D"],
    gate: float,
) -> tuple[Float[Array, "*batch D D"], Float[Array, "*batch D D"]]:
    """Widen Σ and R so that a reading is inside the gate: s Σ and s R, s = max(1, νᵀ (Σ + R)⁻¹ ν / γ).

    An improbable reading says that Σ or R is too small, but not which. Scaling both keeps the gain, so the
    mean moves as before, and the posterior covariance grows by s: the belief becomes less certain. γ is the
    quantile of χ² with D degrees of freedom, the law of the squared distance: -2 ln(1 - gate) for two.

    Args:
        cov: Prior covariance Σ.
        innovation: Innovation ν = o - μ.
        noise_cov: Observation noise covariance R.
        gate: Probability of an acceptable reading, above 0 and below 1.
    """
    cov, noise_cov = jnp.broadcast_arrays(cov, noise_cov)
    root = cholesky_factor(_axes_first(_symmetric(cov + noise_cov)))
    squared = jnp.square(solve_lower(root, jnp.moveaxis(innovation, -1, 0))).sum(0)
    scale = jnp.maximum(1.0, squared / _chi2_quantile(gate, innovation.shape[-1]))[..., None, None]
    return scale * cov, scale * noise_cov


def correlated(
    cov: Float[Array, "*batch D D"],
    noise_cov: Float[Array, "*#batch D D"],
    prior_std: float | Sequence[float],
    correlation: float,
) -> Float[Array, "*batch D D"]:
    """Widen R of a reading whose error is correlated with those of earlier readings at the same hole.

    k readings with covariance R and correlation ρ have the information of k / (1 + (k - 1) ρ) independent
    ones. With g of them already in the belief, g = ½ tr(R (Σ⁻¹ - Σ₀⁻¹)), the next adds

        (1 - g ρ)² / (1 - g ρ²),

    and R is divided by this number. It is 1 for the first reading and tends to 0 as g tends to 1 / ρ.

    Args:
        cov: Prior covariance Σ.
        noise_cov: Observation noise covariance R.
        prior_std: Standard deviation of Σ₀, the belief before any reading; one, or one for each coordinate.
        correlation: Correlation ρ of the errors, from 0 to below 1.
    """
    cov, noise_cov = jnp.broadcast_arrays(cov, noise_cov)
    precision = cholesky_solve(cholesky_factor(_axes_first(cov)), _axes_first(noise_cov))
    stds = prior_std if isinstance(prior_std, Sequence) else [prior_std] * cov.shape[-1]
    along = [precision[i, i] - noise_cov[..., i, i] / std**2 for i, std in enumerate(stds)]
    count = jnp.clip(sum(along) / len(along), 0, _MOST_SHARE / correlation)
    adds = (1 - count * correlation) ** 2 / (1 - count * correlation**2)
    return noise_cov / adds[..., None, None]


def gaussian_nll_terms(
    target: Float[Array, "*batch D"],
    mean: Float[Array, "*batch D"],
    cov: Float[Array, "*batch D D"],
    *,
    units: Sequence[float] | float = 1 / CM_PER_M,
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Compute ½ ln|Σ| and ½ (p - μ)ᵀ Σ⁻¹ (p - μ), the first two terms of the paper's loss.

    Arguments are in m, rad and their squares. The density is per unit, 1 cm by default, for readability: Σ =
    (1 cm)² I gives a determinant term of 0 (in m it would be -9.21). The constant ln 2π is omitted, as in the
    paper.
    """
    scale = 1 / np.broadcast_to(np.asarray(units, np.float64), mean.shape[-1:])
    squared = (scale[:, None] * scale).astype(np.float32)
    root = cholesky_factor(_axes_first(_symmetric(cov) * squared))
    whitened = solve_lower(root, jnp.moveaxis((target - mean) * scale.astype(np.float32), -1, 0))
    half_logdet = -jnp.log(jnp.stack(root.inverse_diagonal)).sum(0)
    return half_logdet, 0.5 * jnp.square(whitened).sum(0)


def gaussian_nll(
    target: Float[Array, "*batch D"],
    mean: Float[Array, "*batch D"],
    cov: Float[Array, "*batch D D"],
    *,
    units: Sequence[float] | float = 1 / CM_PER_M,
) -> Float[Array, "*batch"]:
    """Compute the negative log-likelihood in nats, per unit, without ln 2π: sum of ``gaussian_nll_terms``."""
    half_logdet, half_mahalanobis = gaussian_nll_terms(target, mean, cov, units=units)
    return half_logdet + half_mahalanobis


def scale_tril(cov: Float[Array, "*batch D D"]) -> Float[Array, "*batch D D"]:
    """Compute the lower triangular L with L Lᵀ = Σ; it maps standard normal samples to N(0, Σ)."""
    root = cholesky_factor(_axes_first(cov))
    zero = jnp.zeros_like(cov[..., 0, 0])
    rows = []
    for i, (below, inverse) in enumerate(zip(root.lower, root.inverse_diagonal, strict=True)):
        row = [*below, 1 / inverse, *[zero] * (cov.shape[-1] - 1 - i)]
        rows.append(jnp.stack(row, -1))
    return jnp.stack(rows, axis=-2)


@cache
def _chi2_quantile(probability: float, degrees: int) -> float:
    return float(chdtri(degrees, 1 - probability))


def _transpose(matrix: Float[Array, "*batch n k"]) -> Float[Array, "*batch k n"]:
    return jnp.swapaxes(matrix, -1, -2)


def _symmetric(matrix: Float[Array, "*batch n n"]) -> Float[Array, "*batch n n"]:
    return (matrix + _transpose(matrix)) / 2


def _axes_first(matrix: Float[Array, "*batch n n"]) -> Float[Array, "n n *batch"]:
    """Move the matrix axes to the front, the layout of ``mjx_fit.utils.linalg``."""
    return jnp.moveaxis(matrix, (-2, -1), (0, 1))


def product(a: Float[Array, "*batch n k"], b: Float[Array, "*batch k m"]) -> Float[Array, "*batch n m"]:
    """Compute A B as explicit sums: TF32 matrix products (ten bits) are too coarse for the Joseph form."""
    return (a[..., :, :, None] * b[..., None, :, :]).sum(-2)


def sandwich(
    left: Float[Array, "*batch n k"], middle: Float[Array, "*batch k k"]
) -> Float[Array, "*batch n n"]:
    """Compute A B Aᵀ."""
    return product(product(left, middle), _transpose(left))
