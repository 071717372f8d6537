"""Observation and action of the environments: what a robot has, in fixed units, and nothing of the truth."""

import jax.numpy as jnp
from jaxlie import SO3
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.control.policies import PolicyInput
from mjx_fit.filters import frame
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import Array

LATERAL_M, PUSH_M = 0.004, 0.006
"""Largest lateral command of an action, and the deepest push: that of ``seek`` after a drop."""
DOWN = (0.0, 1.0, 0.0, 0.0)
"""Orientation of a TCP that points straight down, w x y z."""
TURN_RAD = 0.2
"""Largest component of a commanded rotation vector, and unit of an observed one."""
POSITION_M, HEIGHT_M, SPEED_MPS, FORCE_N, TORQUE_NM = 0.01, 0.005, 0.05, 10.0, 0.3
"""Units of an observation."""


def observed(seen: PolicyInput, command: Float[Array, "a"], config: Config) -> Float[Array, "k"]:
    """Return the observation before an action.

    It holds the TCP relative to the estimate (2) and over the nominal top of the socket (1), its velocity
    (3), mean and standard deviation of the wrench of the previous action (6 each), its largest force, whether
    it touched, the previous command (3 or 6), the share of the attempt's time that is over, and the type of
    the peg, one-hot. Where a rotation is believed, the TCP's rotation vector from straight down (3) follows.
    All is in the frame of the estimate, in which the socket stands upright.

    Args:
        seen: What a policy sees.
        command: Command of the previous action, m and rad.
        config: Defines the heights and the number of types.
    """
    tip = seen.tip_pos_world
    height = jnp.clip((tip[2] - plate_top_m(config.scene)) / HEIGHT_M, -4, 1)
    wrench = seen.wrench_sensor / jnp.array([FORCE_N] * 3 + [TORQUE_NM] * 3)
    peak = jnp.linalg.norm(wrench[:, :3], axis=1).max()
    turned = []
    if frame.turns(config.filter.coordinates):
        turned = [(SO3(jnp.asarray(seen.tip_quat_world)) @ SO3(jnp.asarray(DOWN)).inverse()).log() / TURN_RAD]
    return jnp.concatenate([
        (tip[:2] - seen.start.estimate_world) / POSITION_M,
        height[None],
        seen.tip_linvel_world / SPEED_MPS,
        jnp.clip(wrench.mean(0), -5, 5),
        jnp.clip(wrench.std(0), 0, 5),
        jnp.clip(peak, 0, 5)[None],
        seen.contact[None].astype(float),
        command[:3] / LATERAL_M,
        command[3:] / TURN_RAD,
        (seen.step / seen.horizon)[None],
        jnp.eye(config.scene.n_types)[seen.start.peg_type],
        *turned,
    ])  # fmt: skip


def size(config: Config) -> int:
    """Return the number of components of an observation."""
    turns = frame.turns(config.filter.coordinates)
    return 24 + config.scene.n_types + (6 if turns else 0)


def width(config: Config) -> int:
    """Return the number of components of an action: six where a rotation is believed, else three."""
    return 6 if frame.turns(config.filter.coordinates) else 3


def commanded(action: Float[Array, "*n a"]) -> Float[Array, "*n a"]:
    """Return the command (m and rad) of an action in [-1, 1].

    Its components say how far to move sideways, from no push to the deepest one, and how the TCP is to be
    turned from straight down.
    """
    action = jnp.clip(action, -1, 1)
    lateral, push = LATERAL_M * action[..., :2], -PUSH_M * (action[..., 2:3] + 1) / 2
    return jnp.concatenate([lateral, push, TURN_RAD * action[..., 3:]], -1)
