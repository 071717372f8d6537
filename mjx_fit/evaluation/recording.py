"""One assembly as it was played: every attempt with all that was believed."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.types import Belief, Rollout
from mjx_fit.utils.errors import require


@dataclass(frozen=True)
class Step:
    """One attempt.

    Attributes:
        number: Of the attempt in the assembly, from 1.
        peg: Number of the peg in hand, from 0.
        attempt: Number of the attempt with it, from 1.
        hole: Which hole was tried.
        rollout: What happened.
        before: What was believed of all n holes as it began.
        after: What was believed once it had been learned from.
        content: Type of the peg in each hole as it began; -1 where it was empty.
        helped: The hole that a human filled thereafter, or None.
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
        method: Its name.
        trial: Its id.
        config: The configuration.
        hole_type: (n,).
        hole_pos_world: (n, 2), m.
        peg_type: (n,), in the order in which they were grasped.
        steps: Every attempt in order.
    """

    method: str
    trial: int
    config: Config
    hole_type: Int[np.ndarray, "n"]
    hole_pos_world: Float[np.ndarray, "n 2"]
    peg_type: Int[np.ndarray, "n"]
    steps: tuple[Step, ...]

    def only(self, number: int) -> "Recording":
        """The attempt with a number, alone.

        Raises:
            RequestError: There is none.
        """
        require_attempt(number, len(self.steps))
        return replace(self, steps=(self.steps[number - 1],))


def require_attempt(number: int | None, most: int) -> None:
    """Refuse to look at an attempt that there is not."""
    if number is not None:
        require("--attempt", number, 1, most)
