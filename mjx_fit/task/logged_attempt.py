"""One attempt of a robot: read from its log, checked to belong to a hole, and padded."""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from mjx_fit.scene.robot import Robot
from mjx_fit.sensors.resampling import felt_from_log
from mjx_fit.sensors.sensor_log import SensorLog
from mjx_fit.types import Felt
from mjx_fit.utils.errors import RequestError

MOST_OFF_START_M = 1e-4
"""Largest offset of an attempt's start from the estimate, m: the innovation is relative to the start."""


class AtHole(NamedTuple):
    """Situation before an attempt.

    Attributes:
        hole: Index of the hole.
        estimate: Where the attempt should start, m.
        filled: Whether the hole is filled.
        peg: Type of the peg in hand; None: unknown.
    """

    hole: int
    estimate: Float[np.ndarray, "D"]
    filled: bool
    peg: int | None


def attempt_of(log: SensorLog, there: AtHole, robot: Robot, *, at_rest: bool) -> Felt:
    """Read a robot's log.

    Args:
        log: The log.
        there: Hole and peg.
        robot: The arm.
        at_rest: Whether the sensor needs the pose at rest before the first command.

    Raises:
        RequestError: No peg is in hand, or the log is unusable.
    """
    if there.peg is None:
        raise RequestError("update: no peg is in hand: call choose(peg=...) before the attempt")
    felt = felt_from_log(log, there.peg, there.estimate, robot)
    if felt.start is None and at_rest:
        raise RequestError(
            "log: pose_time_s: the poses cannot be used: expected one at rest in free space, before "
            "the first command; this sensor reads poses relative to it"
        )
    return felt


def require_own(felt: Felt, there: AtHole, names: tuple[str, ...]) -> None:
    """Check that an attempt belongs to this hole; any other would silently corrupt the belief.

    Raises:
        RequestError: It used another peg, another start or a filled hole.
    """
    peg = int(felt.peg_type)
    if there.peg not in (None, peg):
        raise RequestError(f"update: peg_type: {peg} cannot be used: {names[there.peg]} is in hand")
    if there.filled:
        raise RequestError(f"update: hole {there.hole} cannot be used: it is filled")
    start = np.asarray(felt.estimate_world)
    if not np.linalg.norm(start - there.estimate) <= MOST_OFF_START_M:
        raise RequestError(
            f"update: estimate_world: {np.round(start, 5).tolist()} cannot be used: an attempt at hole "
            f"{there.hole} must start from {np.round(there.estimate, 5).tolist()}"
        )


def padded(felt: Felt, rows: int) -> Felt:
    """Pad the attempt to a fixed number of rows, so that most attempts share one compilation."""

    def pad(leaf: Any) -> np.ndarray:
        leaf = np.asarray(leaf)
        return np.pad(leaf, [(0, rows - len(leaf)), *[(0, 0)] * (leaf.ndim - 1)])

    return replace(felt, trace=jax.tree.map(pad, felt.trace))
