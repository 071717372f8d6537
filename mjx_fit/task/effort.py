"""Effort of attempts: the seconds they take, the forces they exert, and the seconds of moves between them.

Forces are the noise-free, tared forces of the simulator: they score a method, and no method sees them.
"""

from dataclasses import fields

import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.config.sections.moves import MovesConfig
from mjx_fit.types import Array, Felt
from mjx_fit.utils.pytrees import pytree
from mjx_fit.utils.rates import ACTION_S, STEP_S

HARD_N = 20.0
"""Force above which seconds are counted, N: a limit of a 2026 assembly competition."""
CONTACT_N = 1.0
"""Force from which a sample counts as contact, N: ``wrist.contact_force_n`` by default, without noise."""
_AT_ONCE = 256


@pytree
class Effort:
    """Effort of attempts.

    Attributes:
        seconds: Duration from the start, 2 mm above the socket, to the insertion or to the end, s.
        contact_s: Time with at least ``CONTACT_N``, s.
        peak_force_n: Largest force, N.
        over_20n_s: Time above ``HARD_N``, s.
        impulse_ns: Integral of the magnitude of the force over the contact time, N·s; divided by that time it
            is the mean contact force.
    """

    seconds: Float[np.ndarray, "*n"]
    contact_s: Float[np.ndarray, "*n"]
    peak_force_n: Float[np.ndarray, "*n"]
    over_20n_s: Float[np.ndarray, "*n"]
    impulse_ns: Float[np.ndarray, "*n"]


COLUMNS = tuple(field.name for field in fields(Effort))


def effort_of(felt: Felt) -> Effort:
    """Compute the effort of n attempts; forces of a non-finite simulation are NaN."""
    length = np.asarray(felt.length)
    parts = []
    for first in range(0, len(length), _AT_ONCE):  # taring copies the wrenches
        rows = slice(first, first + _AT_ONCE)
        size = forces_n(felt.trace.wrench_sensor[rows], felt.tare_sensor[rows])
        real = np.arange(size.shape[1]) < length[rows, None]
        parts.append(_columns(np.where(real[..., None], size, 0)))
    joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    return Effort(ACTION_S * length.astype(np.float32), *joined)


def forces_n(
    wrench_sensor: Float[Array, "*n J samples 6"], tare_sensor: Float[Array, "*n 6"]
) -> Float[np.ndarray, "*n J samples"]:
    """Compute the magnitude of tared forces, N."""
    tare = np.asarray(tare_sensor)[..., None, None, :3]
    return np.linalg.norm(np.asarray(wrench_sensor)[..., :3] - tare, axis=-1)


def _columns(force_n: Float[np.ndarray, "m J samples"]) -> tuple[Float[np.ndarray, "m"], ...]:
    """Return the columns of ``Effort`` after the first, from forces with zeros as padding."""
    lost = np.isnan(force_n).any((1, 2))
    touching = np.where(force_n >= CONTACT_N, force_n, 0)
    columns = (
        STEP_S * (touching > 0).sum((1, 2)),
        force_n.max((1, 2)),
        STEP_S * (force_n > HARD_N).sum((1, 2)),
        STEP_S * touching.sum((1, 2), dtype=np.float64),
    )
    return tuple(np.where(lost, np.nan, column).astype(np.float32) for column in columns)


def move_time_s(
    from_world: Float[np.ndarray, "n D"], to_world: Float[np.ndarray, "n D"], moves: MovesConfig
) -> Float[np.ndarray, "n"]:
    """Compute the time of the moves from the start of one attempt to the start of the next, s.

    The peg is lifted, moved straight and lowered, each from rest to rest with the trapezoidal velocity
    profile of ``moves``, and rests for ``settle_s``. The depth at which the first attempt ended is left out.

    Args:
        from_world: Estimates of the attempts before, x and y first, m.
        to_world: Estimates of the next attempts, likewise.
        moves: Heights, speed and acceleration.
    """
    across = np.linalg.norm((np.asarray(to_world) - np.asarray(from_world))[..., :2], axis=-1)
    vertical = rest_to_rest_s(np.array([moves.lift_m]), moves)
    return rest_to_rest_s(across, moves) + 2 * vertical + moves.settle_s


def rest_to_rest_s(distance_m: Float[np.ndarray, "n"], moves: MovesConfig) -> Float[np.ndarray, "n"]:
    """Compute the time of straight moves: d / v + v / a, or 2 √(d / a) where v is not reached, s."""
    speed, acceleration = moves.speed_mps, moves.acceleration_mps2
    reached = distance_m >= speed**2 / acceleration
    return np.where(
        reached, distance_m / speed + speed / acceleration, 2 * np.sqrt(distance_m / acceleration)
    )


class Travel:
    """Moves of R rows from attempt to attempt.

    Args:
        starts_world: Where the pegs are at first, (R, D), x and y first, m.
        moves: Heights, speed and acceleration.

    Attributes:
        here_world: Starts of the latest attempts, (R, D), m.
        seconds: Time of the moves so far, (R,).
    """

    def __init__(self, starts_world: Float[np.ndarray, "R D"], moves: MovesConfig):
        self.here_world, self._moves = np.array(starts_world), moves
        self.seconds = np.zeros(len(starts_world))

    def go(
        self,
        to_world: Float[np.ndarray, "R D"],
        active: Bool[np.ndarray, "R"],
        counted: Bool[np.ndarray, "R"],
    ) -> None:
        """Move the active rows to the starts of their next attempts; a move that is not counted is free."""
        seconds = move_time_s(self.here_world, to_world, self._moves)
        self.seconds += np.where(active & counted, seconds, 0)
        self.here_world[active] = np.asarray(to_world)[active]
