"""Beliefs after simulated attempts: what their outcomes let a robot learn."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Key

from mjx_fit.task.estimator import Update, where_rows
from mjx_fit.types import Array, Belief, Rollout


def after_failures(update: Update, beliefs: Belief, rollouts: Rollout, keys: Key[Array, "n"]) -> Belief:
    """Return the beliefs after simulated attempts: the posterior after failures, else the prior.

    The update never sees the measurements of an attempt that succeeded or diverged. A policy that updates the
    belief itself (``task.seek``) has the last word: its belief is what it reported with its last action. If
    its attempt lasted to the end, it has searched where it believed the hole to be, and it was not there: the
    position then is what it was before, and only the type is learnt.
    """
    failed = np.asarray(rollouts.truth.valid & ~rollouts.taken)
    if isinstance(rollouts.report, Belief):
        learnt = last_report(rollouts)
        refuted = np.asarray(rollouts.felt.length) == rollouts.report.cov.shape[1]
        place = failed & ~refuted
        return Belief(
            mean_world=where_rows(place, learnt.mean_world, beliefs.mean_world),
            cov=where_rows(place, learnt.cov, beliefs.cov),
            type_logp=where_rows(failed, learnt.type_logp, beliefs.type_logp),
        )
    length = np.where(failed, rollouts.felt.length, 0).astype(np.int32)
    learnt = update(beliefs, replace(rollouts.felt, length=length), keys)
    return jax.tree.map(lambda new, old: where_rows(failed, new, old), learnt, beliefs)


def last_report(rollouts: Rollout) -> Any:
    """Return what a policy reported with the last action of each attempt."""
    last = np.maximum(np.asarray(rollouts.felt.length) - 1, 0)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[np.arange(len(last)), last], rollouts.report)


def after_insertions(confirm: Update, beliefs: Belief, rollouts: Rollout, keys: Key[Array, "n"]) -> Belief:
    """Return the beliefs after simulated attempts: the posterior after insertions, else the prior.

    Args:
        confirm: Update after an insertion.
        beliefs: Beliefs before the attempts, (n,).
        rollouts: The attempts, (n,).
        keys: Seeds of the noise.
    """
    inserted = np.asarray(rollouts.taken)
    length = np.where(inserted, rollouts.felt.length, 0).astype(np.int32)
    learnt = confirm(beliefs, replace(rollouts.felt, length=length), keys)
    return jax.tree.map(lambda new, old: where_rows(inserted, new, old), learnt, beliefs)
