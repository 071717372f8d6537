"""State of many assemblies at one time, and their next choices."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.types import Belief

EMPTY = -1
"""Content of an empty hole."""
KEPT_FROM = 0.5
"""Least probability of a match with which an inserted peg stays in a hole."""


@dataclass(frozen=True)
class State:
    """State of all R rows, n holes each.

    Attributes:
        active: Whether each row has pegs left.
        peg: Number of the peg in hand, from 0.
        beliefs: Current belief about every hole, (R, n).
        content: Type of the peg that the robot or a human put into each hole; -1 if empty.
    """

    active: Bool[np.ndarray, "R"]
    peg: Int[np.ndarray, "R"]
    beliefs: Belief
    content: Int[np.ndarray, "R n"]

    @property
    def filled(self) -> Bool[np.ndarray, "R n"]:
        """Whether each hole is filled."""
        return self.content != EMPTY


@dataclass(frozen=True)
class Choice:
    """Next hole of each row, with the probabilities that led to the choice.

    Attributes:
        hole: Index of the chosen hole.
        chance: Predicted success probability of the attempt; P(match) under ``task.next_hole: rate``.
        next_best: The highest of these among the other empty holes; NaN if there are no others.
    """

    hole: Int[np.ndarray, "R"]
    chance: Float[np.ndarray, "R"]
    next_best: Float[np.ndarray, "R"]
