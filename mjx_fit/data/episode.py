"""Episodes: the rows of a data set, each an interaction and the information available before it."""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.scene.robot import ROBOTS
from mjx_fit.types import Array, Rollout, Truth, pytree

UNKNOWN = -1
"""Type of a hole that nobody knows."""


@pytree
class Episode:
    """One rollout and its position in a sequence of attempts with one peg at one hole.

    Attributes:
        episode: Id of the episode: sequence times attempts per sequence, plus number.
        sequence: Id of the sequence.
        number: Index of the attempt in the sequence, from 0.
        policy: Index into ``mjx_fit.control.policies.NAMES``.
        estimate_cov: Covariance of ``rollout.felt.estimate_world`` before the attempt, m² and rad².
        rollout: Simulated attempt, of length 0 if the sequence had already ended.
    """

    episode: Int[Array, "*batch"]
    sequence: Int[Array, "*batch"]
    number: Int[Array, "*batch"]
    policy: Int[Array, "*batch"]
    estimate_cov: Float[Array, "*batch D D"]
    rollout: Rollout


def unknown_truth(n: int, config: Config) -> Truth:
    """Return the truth about n attempts of a robot: no type, no place, and nothing that is an insertion.

    ``hole_type`` is ``UNKNOWN`` and all numbers are NaN, so that whatever is computed from them shows it.
    """
    joints = len(ROBOTS[config.scene.robot].joints)

    def nothing(*shape: int) -> Array:
        return np.full((n, *shape), np.nan, np.float32)

    return Truth(
        hole_type=np.full(n, UNKNOWN, np.int32),
        hole_pos_world=nothing(2),
        inserted=np.zeros(n, bool),
        valid=np.ones(n, bool),
        end_qpos=nothing(joints),
        end_qvel=nothing(joints),
    )


def happened(data: Episode) -> Bool[Array, "*batch"]:
    """True for episodes that were performed and did not diverge."""
    return data.rollout.truth.valid & (data.rollout.felt.length > 0)


def padded(rollouts: Rollout, actions: int) -> Rollout:
    """Pad the traces of n rollouts, and what policies reported, with zeros to this number of actions."""

    def pad(leaf):
        return np.pad(leaf, [(0, 0), (0, actions - leaf.shape[1]), *[(0, 0)] * (leaf.ndim - 2)])

    felt = rollouts.felt
    report = jax.tree.map(pad, rollouts.report)
    return replace(rollouts, felt=replace(felt, trace=jax.tree.map(pad, felt.trace)), report=report)
