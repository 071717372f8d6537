"""Reveal the truth to beliefs, for the methods that serve as upper bounds."""

from typing import Any

import numpy as np
from jaxtyping import Int

from mjx_fit.task.methods import KNOWN_VARIANCE_M2
from mjx_fit.types import Belief

_LOG_IMPOSSIBLE = -30.0
"""Log probability ln ξ of a type that is known to be wrong: finite, and negligible."""


def reveal_hole(beliefs: Belief, world: dict[str, np.ndarray], which: Any) -> None:
    """Replace the beliefs about selected holes by the truth, in place.

    Args:
        beliefs: Writable beliefs, (R, n).
        world: Ground truth: ``hole_type`` (R, n) and ``place_world`` (R, n, D), m and rad.
        which: Index into (R, n).
    """
    one_hot = np.arange(beliefs.type_logp.shape[-1]) == world["hole_type"][which][..., None]
    reveal_place(beliefs, world, which)
    beliefs.type_logp[which] = np.where(one_hot, 0.0, _LOG_IMPOSSIBLE)


def reveal_match(
    beliefs: Belief, world: dict[str, np.ndarray], which: Any, peg_type: Int[np.ndarray, "k"]
) -> None:
    """Reveal to k beliefs the true position and whether the hole matches the peg, in place.

    Args:
        beliefs: Writable beliefs, (R, n).
        world: Ground truth, see ``reveal_hole``.
        which: Index into (R, n).
        peg_type: Type of the peg in hand for each belief, (k,).
    """
    is_peg = np.arange(beliefs.type_logp.shape[-1]) == peg_type[:, None]
    same = (world["hole_type"][which] == peg_type)[:, None]
    reveal_place(beliefs, world, which)
    left = np.where(is_peg == same, beliefs.type_logp[which], _LOG_IMPOSSIBLE)
    beliefs.type_logp[which] = left - np.logaddexp.reduce(left, axis=1, keepdims=True)


def reveal_place(beliefs: Belief, world: dict[str, np.ndarray], which: Any) -> None:
    """Reveal the true places of selected holes, in place; see ``reveal_hole``."""
    beliefs.mean_world[which] = world["place_world"][which]
    beliefs.cov[which] = KNOWN_VARIANCE_M2 * np.eye(beliefs.cov.shape[-1])
