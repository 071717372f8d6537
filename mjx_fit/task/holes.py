"""Trials of repeated attempts at one hole: their setup, and their outcome."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Key

from mjx_fit.task.effort import Effort
from mjx_fit.types import Array
from mjx_fit.types.physics import AS_CONFIGURED, Physics


@dataclass(frozen=True)
class Holes:
    """Setup of T single-hole trials.

    Attributes:
        peg_type: Type of the peg, (T,).
        hole_type: Type of the hole, (T,).
        hole_pos_world: True position of the hole, (T, 2), m.
        estimate_world: Detected position of the hole, (T, 2), m.
        key: Seeds of exploration noise, sensor noise and sampled estimates, (T,).
        physics: Quantities that each world has of its own, (T,).
    """

    peg_type: Int[np.ndarray, "T"]
    hole_type: Int[np.ndarray, "T"]
    hole_pos_world: Float[np.ndarray, "T 2"]
    estimate_world: Float[np.ndarray, "T 2"]
    key: Key[Array, "T"]
    physics: Physics = AS_CONFIGURED


@dataclass(frozen=True)
class Outcome:
    """Outcome of the trials under one method, with at most K attempts.

    Attributes:
        inserted_at: Number of the attempt that inserted the peg, from 1; 0 if no attempt did, (T,). The types
            need not match. An insertion that the robot does not notice is none (``task.success: sensed``); a
            peg that it takes for inserted ends the trial.
        attempts: Number of attempts made, (T,).
        mean_world: Mean place before the first and after each attempt, (T, K + 1, D), m and rad. It stays
            constant after an insertion; the insertion position never replaces it.
        cov: Covariance of the place, (T, K + 1, D, D), m² and rad².
        match_probability: Probability that the hole matches the peg, before the first and after each attempt,
            (T, K + 1).
        place_world: True place before the first and after each attempt, (T, K + 1, D), m and rad
            (``place_for_tool``). It changes where a peg slips in the hand.
        effort: Time and force of each attempt, (T, K); NaN for attempts that were not made.
        move_seconds: Time of the moves between the attempts, (T,), s.
    """

    inserted_at: Int[np.ndarray, "T"]
    attempts: Int[np.ndarray, "T"]
    mean_world: Float[np.ndarray, "T after D"]
    cov: Float[np.ndarray, "T after D D"]
    match_probability: Float[np.ndarray, "T after"]
    place_world: Float[np.ndarray, "T after D"]
    effort: Effort
    move_seconds: Float[np.ndarray, "T"]
