"""Cost of contacts with friction cones, in coordinates that make the cones circular.

The residual J a - a_ref of a contact, normal first, is scaled to u = S (J a - a_ref) with S = diag(μ, f, f),
f the coefficient of friction and μ = f / √impratio. With N = u₀ and T = |u₁₂|, the cost is ½ w, w = D / μ²,
times

    0                            if N ≥ μ T: open
    (N - μ T)² / (1 + μ²)        otherwise: sliding
    N² + T²                      if μ N + T ≤ 0: sticking

This is MuJoCo's elliptic cone (documentation, chapter Computation, "Constraint model") for a single
coefficient of friction.

The contacts are the first axis and the worlds the last axis of all arrays: see ``mjx_fit.utils.linalg``.
"""

from functools import reduce
from operator import add
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from mjx_fit.types import Array
from mjx_fit.utils.linalg import total

_SMALL = 1e-12


class Cones(NamedTuple):
    """Contacts of each world.

    Attributes:
        mu: Cone coefficient μ.
        weight: Weight w.
        scale: Diagonal of the scaling S.
        jac: Scaled Jacobian S J.
        reference: Scaled reference acceleration S a_ref.
    """

    mu: Float[Array, "b"]
    weight: Float[Array, "c b"]
    scale: Float[Array, "3 b"]
    jac: Float[Array, "c 3 joints b"]
    reference: Float[Array, "c 3 b"]


class ConeHessian(NamedTuple):
    """Second derivatives of the cost in u, with t the direction of the tangential part.

    The matrix is [[normal, -mixed tᵀ], [-mixed t, along t tᵀ + across (1 - t tᵀ)]].
    """

    direction: Float[Array, "c 2 b"]
    normal: Float[Array, "c b"]
    mixed: Float[Array, "c b"]
    along: Float[Array, "c b"]
    across: Float[Array, "c b"]


def from_rows(
    jac: Float[Array, "c 3 joints b"],
    reference_acc: Float[Array, "c 3 b"],
    weight: Float[Array, "c b"],
    friction: Float[Array, "b"],
    impratio: Float[Array, "b"],
) -> Cones:
    """Make contacts in the coordinates u from MuJoCo's rows, a_ref, D of the normals, f > 0 and impratio."""
    mu = friction / jnp.sqrt(impratio)
    scale = jnp.stack([mu, friction, friction])
    return Cones(mu, weight / mu**2, scale, jac * scale[:, None], reference_acc * scale)


def residual(cones: Cones, acc: Float[Array, "joints b"]) -> Float[Array, "c 3 b"]:
    """Compute u of the contacts under joint accelerations (rad/s²)."""
    return total(cones.jac * acc, 2) - cones.reference


def cost(cones: Cones, u: Float[Array, "c 3 b"]) -> Float[Array, "b"]:
    """Compute the total cost of a world's contacts."""
    normal, size, slides, sticks = _zones(cones, u)
    on_cone = (normal - cones.mu * size) ** 2 / (1 + cones.mu**2)
    square = jnp.where(sticks, normal**2 + size**2, jnp.where(slides, on_cone, 0.0))
    return 0.5 * total(cones.weight * square)


def derivatives(cones: Cones, u: Float[Array, "c 3 b"]) -> tuple[Float[Array, "c 3 b"], ConeHessian]:
    """Compute the gradient and the second derivatives of the cost in u."""
    normal, size, slides, sticks = _zones(cones, u)
    sliding = jnp.where(slides, cones.weight / (1 + cones.mu**2), 0.0)
    sticking = jnp.where(sticks, cones.weight, 0.0)
    size = jnp.maximum(size, _SMALL)
    direction = u[:, 1:] / size[:, None]
    friction = -cones.mu * sliding * (normal - cones.mu * size)
    gradient = jnp.stack(
        [
            sliding * (normal - cones.mu * size) + sticking * normal,
            friction * direction[:, 0] + sticking * u[:, 1],
            friction * direction[:, 1] + sticking * u[:, 2],
        ],
        axis=1,
    )
    hessian_u = ConeHessian(
        direction=direction,
        normal=sliding + sticking,
        mixed=cones.mu * sliding,
        along=cones.mu**2 * sliding + sticking,
        across=friction / size + sticking,
    )
    return gradient, hessian_u


def curvature(hessian_u: ConeHessian, v: Float[Array, "c 3 b"]) -> Float[Array, "c b"]:
    """Compute the second derivative of each contact's cost along a direction v in u."""
    along, across = _in_plane(hessian_u.direction, v[:, 1], v[:, 2])
    return (
        hessian_u.normal * v[:, 0] ** 2
        - 2 * hessian_u.mixed * v[:, 0] * along
        + hessian_u.along * along**2
        + hessian_u.across * across**2
    )


def hessian(cones: Cones, hessian_u: ConeHessian) -> Float[Array, "joints joints b"]:
    """Compute the second derivatives of the total contact cost in the joint accelerations."""
    along, across = _in_plane(hessian_u.direction[:, :, None], cones.jac[:, 1], cones.jac[:, 2])
    normal = cones.jac[:, 0]
    n, m, a, c = (x[:, None] for x in hessian_u[1:])
    left = (normal, along, across)
    right = (n * normal - m * along, a * along - m * normal, c * across)
    return reduce(add, (total(x[:, :, None] * y[:, None]) for x, y in zip(left, right, strict=True)))


def _zones(
    cones: Cones, u
) -> tuple[Float[Array, "c b"], Float[Array, "c b"], Bool[Array, "c b"], Bool[Array, "c b"]]:
    """Compute N, T, and masks of the sliding and the sticking contacts."""
    normal, size = u[:, 0], jnp.sqrt(u[:, 1] ** 2 + u[:, 2] ** 2)
    sticks = (cones.mu * normal + size <= 0) & (normal < 0)
    return normal, size, (normal < cones.mu * size) & ~sticks, sticks


def _in_plane(direction, x, y):
    """Project tangential vectors (x, y), of any shape, along and across a direction."""
    return direction[:, 0] * x + direction[:, 1] * y, direction[:, 0] * y - direction[:, 1] * x
