"""Coordinates of the place of a socket, and their differences: a chart of R³ × SO(3).

A place is a vector of the coordinates that are believed, in the order of ``filter.coordinates``: position x
and y, height z over the nominal one (m), and the rotation vector from upright about the world's axes (rad),
whose components are called yaw, roll and pitch. Coordinates that are not believed are zero. Steps are
tangent: with ω the rotation vector, a place moved by a step (s, θ) is

    x' = x + s,   ω' = log(exp(θ) exp(ω)).
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxlie import SO3
from jaxtyping import Float, Int

from mjx_fit.types import Array

_UNIT_M, _UNIT_RAD = 0.01, 0.1
AXIS = {"roll": 0, "pitch": 1, "yaw": 2}
"""Axis of the world of each rotation."""


def moved(
    place_world: Float[Array, "*batch D"], step_world: Float[Array, "*batch D"], coordinates: Sequence[str]
) -> Float[Array, "*batch D"]:
    """Return places moved by tangent steps, m and rad.

    Rotations about two axes make one about the third, of second order; it is dropped if that is not believed.
    """
    which, axes = _rotations(coordinates)
    summed = jnp.asarray(place_world + step_world)
    if not len(which):
        return summed
    turned = _so3(step_world[..., which], axes) @ _so3(place_world[..., which], axes)
    return summed.at[..., which].set(turned.log()[..., axes])


def step_between(
    from_world: Float[Array, "*batch D"], to_world: Float[Array, "*batch D"], coordinates: Sequence[str]
) -> Float[Array, "*batch D"]:
    """Return the tangent steps that lead from places to others by ``moved``, m and rad."""
    which, axes = _rotations(coordinates)
    difference = jnp.asarray(to_world - from_world)
    if not len(which):
        return difference
    turn = _so3(to_world[..., which], axes) @ _so3(from_world[..., which], axes).inverse()
    return difference.at[..., which].set(turn.log()[..., axes])


def turned_basis(
    step_world: Float[Array, "*batch D"], coordinates: Sequence[str]
) -> Float[Array, "*batch D D"]:
    """Return J of steps, which carries errors to the tangent space after a step: Σ' = J Σ Jᵀ.

    An error ε of a step θ turns the place behind it by log(exp(θ + ε) exp(-θ)), to first order J ε.
    """
    which, axes = _rotations(coordinates)
    n = step_world.shape[-1]
    basis = jnp.broadcast_to(jnp.eye(n, dtype=step_world.dtype), (*step_world.shape, n))
    if len(which) < 2:  # Rotations about one axis add up.
        return basis

    def error(epsilon: Float[Array, "k"], theta: Float[Array, "k"]) -> Float[Array, "k"]:
        return (_so3(theta + epsilon, axes) @ _so3(theta, axes).inverse()).log()[axes]

    thetas = step_world[..., which]
    flat = thetas.reshape(-1, len(which))
    inner = jax.vmap(jax.jacfwd(error))(jnp.zeros_like(flat), flat)
    return basis.at[..., which[:, None], which].set(inner.reshape(*thetas.shape, len(which)))


def carried(
    cov: Float[Array, "*batch D D"], step_world: Float[Array, "*batch D"], coordinates: Sequence[str]
) -> Float[Array, "*batch D D"]:
    """Return covariances J Σ Jᵀ in the tangent space behind steps; see ``turned_basis``."""
    if len(_rotations(coordinates)[0]) < 2:
        return cov
    basis = turned_basis(step_world, coordinates)
    turned = jnp.einsum("...ia,...ab,...jb->...ij", basis, cov, basis, precision=jax.lax.Precision.HIGHEST)
    return (turned + jnp.swapaxes(turned, -1, -2)) / 2


def units(coordinates: Sequence[str]) -> tuple[float, ...]:
    """Return the unit of each coordinate: 1 cm or 0.1 rad, so that lengths and angles are alike in size."""
    return tuple(_UNIT_RAD if name in AXIS else _UNIT_M for name in coordinates)


def _rotations(coordinates: Sequence[str]) -> tuple[Int[np.ndarray, "k"], Int[np.ndarray, "k"]]:
    """Return the places of the rotations among the coordinates, and their axes."""
    found = [(place, AXIS[name]) for place, name in enumerate(coordinates) if name in AXIS]
    which, axes = np.array(found, int).reshape(-1, 2).T
    return which, axes


def _so3(components: Float[Array, "*batch k"], axes: Int[np.ndarray, "k"]) -> SO3:
    whole = jnp.zeros((*components.shape[:-1], 3), components.dtype).at[..., axes].set(components)
    return SO3.exp(whole)
