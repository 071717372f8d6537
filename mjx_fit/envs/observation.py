"""Observation and action of the environments: what a robot has, in fixed units, and nothing of the truth."""

import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.control.policies import PolicyInput
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import Array

LATERAL_M, PUSH_M = 0.004, 0.006
"""Largest lateral command of an action, and the deepest push: that of ``seek`` after a drop."""
POSITION_M, HEIGHT_M, SPEED_MPS, FORCE_N, TORQUE_NM = 0.01, 0.005, 0.05, 10.0, 0.3
"""Units of an observation."""


def observed(seen: PolicyInput, command_world: Float[Array, "3"], config: Config) -> Float[Array, "k"]:
    """Return the observation before an action.

    It holds the TCP relative to the estimate (2) and over the nominal top of the socket (1), its velocity
    (3), mean and standard deviation of the wrench of the previous action (6 each), its largest force, whether
    it touched, the previous command (3), the share of the attempt's time that is over, and the type of the
    peg, one-hot.

    Args:
        seen: What a policy sees.
        command_world: Command of the previous action, m.
        config: Defines the heights, the time and the number of types.
    """
    tip = seen.tip_pos_world
    height = jnp.clip((tip[2] - plate_top_m(config.scene)) / HEIGHT_M, -4, 1)
    wrench = seen.wrench_sensor / jnp.array([FORCE_N] * 3 + [TORQUE_NM] * 3)
    peak = jnp.linalg.norm(wrench[:, :3], axis=1).max()
    return jnp.concatenate([
        (tip[:2] - seen.start.estimate_world) / POSITION_M,
        height[None],
        seen.tip_linvel_world / SPEED_MPS,
        jnp.clip(wrench.mean(0), -5, 5),
        jnp.clip(wrench.std(0), 0, 5),
        jnp.clip(peak, 0, 5)[None],
        seen.contact[None].astype(float),
        command_world / LATERAL_M,
        (seen.step / config.task.attempt_actions)[None],
        jnp.eye(config.scene.n_types)[seen.start.peg_type],
    ])  # fmt: skip


def size(config: Config) -> int:
    """Return the number of components of an observation."""
    return 24 + config.scene.n_types


def commanded(action: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Return the command (m) of an action in [-1, 1]: sideways, and from no push to the deepest one."""
    action = jnp.clip(action, -1, 1)
    lateral, push = LATERAL_M * action[..., :2], -PUSH_M * (action[..., 2:] + 1) / 2
    return jnp.concatenate([lateral, push], -1)
