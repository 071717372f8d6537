"""Observation and action of the policy that is trained by reinforcement: what a robot has, in fixed units."""

import jax.numpy as jnp
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.control.policies import PolicyInput
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import Array

LATERAL_M, PUSH_M = 0.004, 0.006
"""Largest lateral command of an action, and the deepest push: that of `seek` after a drop."""
FORCE, TORQUE = 10.0, 0.3
"""Units of the wrench: N and N·m."""


def observed(seen: PolicyInput, command_world: Float[Array, "3"], config: Config) -> Float[Array, "k"]:
    """Return the observation before an action, with the previous command."""
    tip = seen.tip_pos_world
    height = jnp.clip((tip[2] - plate_top_m(config.scene)) / 0.005, -4, 1)
    units = jnp.array([FORCE] * 3 + [TORQUE] * 3)
    wrench = seen.wrench_sensor / units
    peak = jnp.linalg.norm(wrench[:, :3], axis=1).max()
    return jnp.concatenate([
        (tip[:2] - seen.start.estimate_world) / 0.01,
        height[None],
        seen.tip_linvel_world / 0.05,
        jnp.clip(wrench.mean(0), -5, 5),
        jnp.clip(wrench.std(0), 0, 5),
        jnp.clip(peak, 0, 5)[None],
        seen.contact[None].astype(float),
        command_world / LATERAL_M,
        (seen.step / config.task.attempt_actions)[None],
        jnp.eye(config.scene.n_types)[seen.start.peg_type],
    ])  # fmt: skip


def commanded(action: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Return the command (m) of an action in [-1, 1]: sideways, and from no push to the deepest one."""
    lateral, push = LATERAL_M * action[..., :2], -PUSH_M * (action[..., 2:] + 1) / 2
    return jnp.concatenate([lateral, push], -1)
