"""Frame of an estimate: the world as it would be seen if the socket were upright, where it is estimated.

With R the estimated rotation, (x, y) the estimated position, h its height and h₀ the nominal one, a point p
is seen at Rᵀ (p - (x, y, h)) + (x, y, h₀). Sensors read traces and policies act in this frame: neither has to
know how the socket stands. If only x and y are believed, the frame is the world.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxlie import SO3
from jaxtyping import Float

from mjx_fit.config.sections.filter import PLANAR
from mjx_fit.filters import chart
from mjx_fit.types import Array, Belief, Observation, pytree

_AXIS = {"x": 0, "y": 1, "z": 2} | chart.AXIS


@pytree
class Frame:
    """Frame of an estimate.

    Attributes:
        position_world: Estimated position, x and y, m.
        height_m: Estimated height over the nominal one, m.
        rotation_world: Estimated rotation from upright.
    """

    position_world: Float[Array, "*batch 2"]
    height_m: Float[Array, "*batch"]
    rotation_world: SO3

    def seen(self, point_world: Float[Array, "*batch 3"], top_m: float) -> Float[Array, "*batch 3"]:
        """Return where points are seen, m, given the nominal height of the socket's top, m."""
        top = jnp.full_like(self.height_m, top_m)
        here = self._at(top + self.height_m)
        return self.rotation_world.inverse() @ (point_world - here) + self._at(top)

    def world(self, point: Float[Array, "*batch 3"], top_m: float) -> Float[Array, "*batch 3"]:
        """Return where points are that are seen in the frame, m."""
        top = jnp.full_like(self.height_m, top_m)
        return self.rotation_world @ (point - self._at(top)) + self._at(top + self.height_m)

    def _at(self, height_m: Float[Array, "*batch"]) -> Float[Array, "*batch 3"]:
        return jnp.concatenate([self.position_world, height_m[..., None]], -1)


def is_world(coordinates: Sequence[str]) -> bool:
    """Return whether the frames of all estimates are the world: only x and y are believed."""
    return tuple(coordinates) == PLANAR


def turns(coordinates: Sequence[str]) -> bool:
    """Return whether a rotation is believed."""
    return any(name in chart.AXIS for name in coordinates)


def frame_of(estimate_world: Float[Array, "*batch D"], coordinates: Sequence[str]) -> Frame:
    """Return the frame of estimates of these coordinates, m and rad."""
    estimate = jnp.asarray(estimate_world)
    zero = jnp.zeros_like(estimate[..., 0])

    def component(name: str) -> Float[Array, "*batch"]:
        return estimate[..., coordinates.index(name)] if name in coordinates else zero

    rotation = jnp.stack([component(name) for name in chart.AXIS], -1)
    return Frame(estimate[..., :2], component("z"), SO3.exp(rotation))


def basis_of(frame: Frame, coordinates: Sequence[str]) -> Float[Array, "*batch D D"]:
    """Return B, whose columns are the tangent steps in the world of one unit of each coordinate in the frame.

    A rotation and a position turn alike, by R. What turns into coordinates that are not believed is dropped,
    of second order where these are small.
    """
    matrix = frame.rotation_world.as_matrix()

    def entry(row: str, column: str) -> Float[Array, "*batch"]:
        alike = (row in chart.AXIS) == (column in chart.AXIS)
        return matrix[..., _AXIS[row], _AXIS[column]] if alike else jnp.zeros_like(matrix[..., 0, 0])

    rows = [jnp.stack([entry(row, column) for column in coordinates], -1) for row in coordinates]
    return jnp.stack(rows, -2)


def observation_in_world(
    observation: Observation, estimate_world: Float[Array, "*batch D"], coordinates: Sequence[str]
) -> Observation:
    """Return observations of attempts about these estimates, read in their frames, as steps in the world."""
    if is_world(coordinates):
        return observation
    basis = basis_of(frame_of(estimate_world, coordinates), coordinates)
    return replace(
        observation,
        innovation=(basis * observation.innovation[..., None, :]).sum(-1),
        pos_noise_cov=_between(basis, observation.pos_noise_cov),
    )


def belief_in_frame(
    belief: Belief, estimate_world: Float[Array, "*batch D"], coordinates: Sequence[str]
) -> Belief:
    """Return beliefs as they are seen in the frames of estimates."""
    back = jnp.swapaxes(basis_of(frame_of(estimate_world, coordinates), coordinates), -1, -2)
    step = chart.step_between(estimate_world, belief.mean_world, coordinates)
    mean = upright(estimate_world) + (back * step[..., None, :]).sum(-1)
    memory = belief.memory
    if memory is not None:
        memory = replace(memory, before=belief_in_frame(memory.before, estimate_world, coordinates))
    return replace(belief, mean_world=mean, cov=_between(back, belief.cov), memory=memory)


def belief_in_world(
    belief: Belief, estimate_world: Float[Array, "*batch D"], coordinates: Sequence[str]
) -> Belief:
    """Return beliefs that are seen in the frames of estimates, in the world; see ``belief_in_frame``."""
    basis = basis_of(frame_of(estimate_world, coordinates), coordinates)
    step = belief.mean_world - upright(estimate_world)
    mean = chart.moved(estimate_world, (basis * step[..., None, :]).sum(-1), coordinates)
    return replace(belief, mean_world=mean, cov=_between(basis, belief.cov))


def upright(estimate_world: Float[Array, "*batch D"]) -> Float[Array, "*batch D"]:
    """Return estimates as they are seen in their own frames: in their places, upright, at nominal height."""
    estimate = jnp.asarray(estimate_world)
    return jnp.concatenate([estimate[..., :2], jnp.zeros_like(estimate[..., 2:])], -1)


def padded(place_world: Float[Array, "*batch k"], coordinates: Sequence[str]) -> Float[Array, "*batch D"]:
    """Return places with zeros for the coordinates that they lack."""
    rest = len(coordinates) - place_world.shape[-1]
    return jnp.pad(jnp.asarray(place_world), [(0, 0)] * (place_world.ndim - 1) + [(0, rest)])


def _between(
    basis: Float[Array, "*batch D D"], cov: Float[Array, "*batch D D"]
) -> Float[Array, "*batch D D"]:
    turned = jnp.einsum("...ia,...ab,...jb->...ij", basis, cov, basis, precision=jax.lax.Precision.HIGHEST)
    return (turned + jnp.swapaxes(turned, -1, -2)) / 2
