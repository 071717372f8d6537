"""Random rollouts in which the wrench tells where the hole is and whether it matches the peg."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from mjx_fit.data.episode import Episode
from mjx_fit.types import Felt, Rollout, Trace, Truth

PAPER_SENSOR = {"noise": "peg", "contact_features": False, "places": 0}
PAPER_TRAINING = {"schedule": "constant", "weight_decay": 0.0, "mirror": False, "baseline_share": 1.0}
"""What the paper's sensor and training have where the defaults differ, but for sizes."""


_POSES = ((1, 4), (0.1, 3), (0.1, 3))
"""Spread and size of orientation, velocity and turning rate."""


def make_rollouts(
    episodes: int = 24, actions: int = 16, seed: int = 0, min_length: int = 8, sequence: int = 1
) -> Rollout:
    """Stacked interactions of random lengths; every number of a row is different, padding is zero.

    Fx and Fy are 10 N per cm of offset from the estimate to the hole, Fz is 5 N where the peg matches.
    """
    rng = np.random.default_rng(seed)
    length = rng.integers(min_length, actions + 1, episodes)
    turn = np.arange(episodes) // sequence
    peg_type, hole_type = turn % 3, turn // 3 % 3
    estimate = rng.uniform([0.2, -0.3], [0.8, 0.3], (episodes, 2))
    error = rng.uniform(-0.02, 0.02, (episodes, 2))
    hole_pos = (estimate + error)[turn * sequence]
    estimate = hole_pos - error
    wrench = rng.normal(0, 1.0, (episodes, actions, 50, 6))
    wrench[..., :2] += 1000 * (hole_pos - estimate)[:, None, None]
    wrench[..., 2] += 5 * (peg_type == hole_type)[:, None, None]
    tip = rng.normal(0, 0.01, (episodes, actions, 3))
    tip[..., :2] += estimate[:, None]
    real = np.arange(actions) < length[:, None]

    def pad(x):
        return _device(x * real.reshape(*real.shape, *[1] * (x.ndim - 2)))

    turn_, linvel, angvel = (rng.normal(0, std, (episodes, actions, k)) for std, k in _POSES)
    rng.uniform(size=(episodes, actions))  # once contact bits; what is drawn after them stays as it was
    trace = Trace(
        wrench_sensor=pad(wrench),
        tip_pos_world=pad(tip),
        tip_quat_world=pad(turn_),
        tip_linvel_world=pad(linvel),
        tip_angvel_world=pad(angvel),
        action_world=pad(rng.normal(0, 0.004, (episodes, actions, 3))),
    )
    inserted = (peg_type == hole_type) & (rng.uniform(size=episodes) < 0.5)
    tare = rng.normal(0, 1, (episodes, 6))
    felt = Felt(trace, _device(length), _device(tare), _device(estimate), _device(peg_type))
    still = _device(np.zeros((episodes, 7)))
    truth = Truth(
        hole_type=_device(hole_type),
        hole_pos_world=_device(hole_pos),
        inserted=_device(inserted),
        valid=_device(np.ones(episodes, bool)),
        end_qpos=still,
        end_qvel=still,
    )
    return Rollout(felt, truth)


def with_felt(rollout: Rollout, **changes: Any) -> Rollout:
    """The rollout with other fields of what was felt."""
    return replace(rollout, felt=replace(rollout.felt, **changes))


def with_trace(rollout: Rollout, **changes: Any) -> Rollout:
    """The rollout with other fields of its trace."""
    return with_felt(rollout, trace=replace(rollout.felt.trace, **changes))


def with_truth(rollout: Rollout, **changes: Any) -> Rollout:
    """The rollout with other fields of the truth."""
    return replace(rollout, truth=replace(rollout.truth, **changes))


def with_unit_quaternions(done: Rollout) -> Rollout:
    """Orientations that are some: what comes in from outside is checked for it."""
    quaternion = done.felt.trace.tip_quat_world
    size = jnp.linalg.norm(quaternion, axis=-1, keepdims=True)
    return with_trace(done, tip_quat_world=quaternion / jnp.where(size > 0, size, 1))


def make_episodes(
    episodes: int = 24, actions: int = 16, seed: int = 0, min_length: int = 8, sequence: int = 1
) -> Episode:
    """Those interactions as rows of a data set, each with a covariance of its own."""
    ids = np.arange(episodes)
    std = np.linspace(0.005, 0.01, episodes)
    return Episode(
        episode=_device(ids),
        sequence=_device(ids // sequence),
        number=_device(ids % sequence),
        policy=_device(0 * ids),
        estimate_cov=_device(std[:, None, None] ** 2 * np.eye(2)),
        rollout=make_rollouts(episodes, actions, seed, min_length, sequence),
    )


def _device(x):
    return jnp.asarray(x, jnp.float32 if x.dtype.kind == "f" else None)
