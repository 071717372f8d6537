"""Joint Gaussian over the grasp of the peg in hand and the places of all holes: Algorithm 2, shared.

Contact tells where hole i is relative to the peg. With s_i the place of the hole and g the displacement of
the peg in the hand, both in the coordinates of ``mjx_fit.filters.chart`` and seen with the tool straight
down, a reading is o = s_i - g + v, v ~ N(0, R). The blocks of the covariance hold what the readings of one
peg share: what is felt at one hole corrects the others through g. A grasp without covariance makes holes
independent. For rotations the model holds to first order.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from mjx_fit.filters import chart, kalman
from mjx_fit.types import Array, pytree


@pytree
class Joint:
    """Gaussian over a grasp and n holes, m = n + 1 parts of D coordinates each; the grasp is the first part.

    Attributes:
        mean_world: Means, m and rad.
        cov: Covariances between the coordinates of all parts, m² and rad².
    """

    mean_world: Float[Array, "*batch m D"]
    cov: Float[Array, "*batch m D m D"]


def independent(
    mean_world: Float[Array, "*batch n D"],
    cov: Float[Array, "*batch n D D"],
    grasp_cov: Float[Array, "*#batch D D"],
) -> Joint:
    """Return the joint Gaussian of holes that share nothing yet, with a peg held straight on average."""
    n, d = mean_world.shape[-2:]
    grasp = jnp.broadcast_to(grasp_cov, (*mean_world.shape[:-2], 1, d, d))
    blocks = jnp.concatenate([grasp, cov], -3)
    spread = jnp.einsum("ij,...iab->...iajb", jnp.eye(n + 1, dtype=cov.dtype), blocks)
    return Joint(jnp.concatenate([jnp.zeros_like(mean_world[..., :1, :]), mean_world], -2), spread)


def with_new_peg(joint: Joint, grasp_cov: Float[Array, "*#batch D D"]) -> Joint:
    """Return the joint Gaussian after a change of the peg: its grasp is new, the holes stay as they are."""
    mean, cov = jnp.asarray(joint.mean_world), jnp.asarray(joint.cov)
    cov = cov.at[..., 0, :, :, :].set(0).at[..., :, :, 0, :].set(0)
    return Joint(mean.at[..., 0, :].set(0), cov.at[..., 0, :, 0, :].set(grasp_cov))


def learnt_at(
    joint: Joint,
    hole: Int[Array, "*batch"],
    mean_world: Float[Array, "*batch D"],
    cov: Float[Array, "*batch D D"],
    coordinates: Sequence[str],
) -> Joint:
    """Carry a new belief about the place of one hole relative to the peg to all parts.

    What is new is known through r = s_i - g alone, so that with G = cov(x, r) cov(r)⁻¹ every part x moves by
    G (r' - r), and Σ' = (I - G H) Σ (I - G H)ᵀ + G P' Gᵀ with P' the new covariance of r. After the update of
    a Kalman filter this conditions all parts on its reading; it also holds for any other update of r.

    Args:
        joint: Prior.
        hole: Index of the hole, from 0.
        mean_world: New mean of ``relative_to_peg``, m and rad.
        cov: Its new covariance, m² and rad².
        coordinates: Names of the D coordinates.
    """
    m, d = joint.mean_world.shape[-2:]
    before, _ = relative_to_peg(joint, hole, coordinates)
    flat, model = joint.cov.reshape(*joint.cov.shape[:-4], m * d, m * d), _model(hole, m, d)
    gain = kalman.gain_of(flat, model)
    residual = jnp.eye(m * d, dtype=flat.dtype) - kalman.product(gain, model)
    step = (gain * chart.step_between(before, mean_world, coordinates)[..., None, :]).sum(-1)
    after = kalman.sandwich(residual, flat) + kalman.sandwich(gain, cov)
    return _moved(joint, step, (after + jnp.swapaxes(after, -1, -2)) / 2, coordinates)


def _moved(
    joint: Joint,
    step: Float[Array, "*batch mD"],
    cov: Float[Array, "*batch mD mD"],
    coordinates: Sequence[str],
) -> Joint:
    """Return the Gaussian with its means moved by tangent steps, and its covariance carried along."""
    steps = step.reshape(joint.mean_world.shape)
    basis = chart.turned_basis(steps, coordinates)
    carried = jnp.einsum(
        "...mab,...mbnc,...ndc->...mand",
        basis,
        cov.reshape(joint.cov.shape),
        basis,
        precision=jax.lax.Precision.HIGHEST,
    )
    return Joint(chart.moved(joint.mean_world, steps, coordinates), carried)


def relative_to_peg(
    joint: Joint, hole: Int[Array, "*batch"], coordinates: Sequence[str]
) -> tuple[Float[Array, "*batch D"], Float[Array, "*batch D D"]]:
    """Return mean and covariance of where the tool has to be for the peg to be at a hole, s_i - g."""
    m, d = joint.mean_world.shape[-2:]
    place = jnp.take_along_axis(joint.mean_world, (hole + 1)[..., None, None], -2)[..., 0, :]
    mean = chart.step_between(joint.mean_world[..., 0, :], place, coordinates)
    model = _model(hole, m, d)
    flat = joint.cov.reshape(*joint.cov.shape[:-4], m * d, m * d)
    cov = jnp.einsum("...ia,...ab,...jb->...ij", model, flat, model, precision=jax.lax.Precision.HIGHEST)
    return mean, cov


def _model(hole: Int[Array, "*batch"], m: int, d: int) -> Float[Array, "*batch D mD"]:
    """Return H of a reading at a hole: its block is I, that of the grasp -I."""
    parts = jax.nn.one_hot(hole + 1, m) - jax.nn.one_hot(0, m)
    return jnp.einsum("...m,ij->...imj", parts, jnp.eye(d)).reshape(*parts.shape[:-1], d, m * d)
