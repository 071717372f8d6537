"""Recording of one assembly: each attempt with the beliefs before and after it."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.types import Belief, Rollout
from mjx_fit.types.physics import AS_CONFIGURED, Physics
from mjx_fit.utils.errors import require


@dataclass(frozen=True)
class Step:
    """One attempt.

    Attributes:
        number: Number of the attempt in the assembly, from 1.
        peg: Index of the peg in hand, from 0.
        attempt: Number of the attempt with this peg, from 1.
        hole: Index of the hole tried.
        rollout: Rollout of the attempt.
        before: Belief about all n holes before the attempt.
        after: Belief after the update.
        content: Type of the peg in each hole before the attempt; -1 if empty.
        helped: Hole that a human filled after the attempt, or None.
    """

    number: int
    peg: int
    attempt: int
    hole: int
    rollout: Rollout
    before: Belief
    after: Belief
    content: Int[np.ndarray, "n"]
    helped: int | None


@dataclass(frozen=True)
class Recording:
    """One assembly under one method.

    Attributes:
        method: Name of the method.
        trial: Id of the trial.
        config: Configuration.
        hole_type: Type of each hole, (n,).
        hole_pos_world: Position of each hole, (n, 2), m.
        peg_type: Type of each peg in the order of grasping, (n,).
        steps: Attempts in order.
        physics: Quantities of the world of each hole, and of the grasp of each peg, (n,).
    """

    method: str
    trial: int
    config: Config
    hole_type: Int[np.ndarray, "n"]
    hole_pos_world: Float[np.ndarray, "n 2"]
    peg_type: Int[np.ndarray, "n"]
    steps: tuple[Step, ...]
    physics: Physics = AS_CONFIGURED

    def only(self, number: int) -> "Recording":
        """Return the recording of a single attempt.

        Raises:
            RequestError: The number is out of range.
        """
        require_attempt(number, len(self.steps))
        return replace(self, steps=(self.steps[number - 1],))


def require_attempt(number: int | None, most: int) -> None:
    """Check that an attempt number is within range."""
    if number is not None:
        require("--attempt", number, 1, most)
