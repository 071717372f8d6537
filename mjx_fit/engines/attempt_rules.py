"""The rules of an attempt: how it starts, when it is over, and what is recorded. Both engines follow them.

Functions take NumPy or JAX arrays, of one world or of many.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.world import SceneConfig
from mjx_fit.control import operational_space
from mjx_fit.control.kinematics import Chain, inverse
from mjx_fit.control.operational_space import ArmState
from mjx_fit.engines import plausible
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.types import SUBSTEPS, Array, Attempt, Felt, Rollout, Trace, Truth, pytree

START_HEIGHT_M = 0.002
"""Height of the tip over the plate at which an attempt starts, at rest."""

BESIDE_M, BELOW_M = 0.02, 0.002
"""Horizontal distance from the hole's centre, and distance below the hole's floor, beyond which a peg that is
low has left the plate instead: a quarter of the smallest plate's half width, more than any contact yields."""


@pytree
class Tip:
    """Pose and twist of the tip, as a row of a ``Trace`` has them.

    Attributes:
        pos_world: m.
        quat_world: w x y z.
        linvel_world: m/s.
        angvel_world: rad/s.
    """

    pos_world: Float[Array, "*n 3"]
    quat_world: Float[Array, "*n 4"]
    linvel_world: Float[Array, "*n 3"]
    angvel_world: Float[Array, "*n 3"]


@pytree
class Verdict:
    """Where worlds stand at the end of an action.

    Attributes:
        valid: Whether the simulation is finite and believed (``mjx_fit.engines.plausible``).
        inserted: Whether the peg is in, in a world that is valid.
        limited: Actions in a row, up to this one, at the end of which a joint was at its torque limit.
    """

    valid: Bool[Array, "*n"]
    inserted: Bool[Array, "*n"]
    limited: Int[Array, "*n"]

    @property
    def over(self) -> Bool[Array, "*n"]:
        """Whether the attempt ends here: then its world is frozen, and the others of its batch go on."""
        return self.inserted | ~self.valid


def start_qpos(chain: Chain, attempts: Attempt, scene: SceneConfig) -> Float[Array, "n joints"]:
    """Joint angles (rad) at which attempts start: the tip over the estimate, straight down."""
    height = jnp.full_like(attempts.estimate_world[:, :1], plate_top_m(scene) + START_HEIGHT_M)
    return jax.vmap(inverse, (None, 0))(chain, jnp.concatenate([attempts.estimate_world, height], 1))


def tip_of(arm: ArmState) -> Tip:
    """The tip of one arm."""
    velocity = operational_space.tip_velocity(arm)
    return Tip(arm.tip_pos_world, operational_space.tip_quaternion(arm), velocity[:3], velocity[3:])


def trace_row(tip: Tip, wrench_sensor: Float[Array, "*n 50 6"], action_world: Float[Array, "*n 3"]) -> Trace:
    """What is recorded of an action: its wrenches and command, and the tip at its end."""
    return Trace(
        wrench_sensor=wrench_sensor,
        tip_pos_world=tip.pos_world,
        tip_quat_world=tip.quat_world,
        tip_linvel_world=tip.linvel_world,
        tip_angvel_world=tip.angvel_world,
        action_world=action_world,
    )


def judge(
    tip: Tip,
    hole_pos_world: Float[Array, "*n 2"],
    finite: Bool[Array, "*n"],
    at_limit: Bool[Array, "*n"],
    limited: Int[Array, "*n"],
    config: Config,
) -> Verdict:
    """Rules on worlds at the end of an action.

    Args:
        tip: The tip at that moment.
        hole_pos_world: True centre of the hole, m.
        finite: Whether the state is finite, and what led to it.
        at_limit: Whether a joint is at its torque limit at that moment.
        limited: ``Verdict.limited`` of the action before; 0 at the start.
        config: ``scene`` and ``task.insertion_depth_m`` are used.
    """
    limited = plausible.actions_at_limit(limited, at_limit)
    lost = plausible.is_lost(tip.pos_world, tip.quat_world, hole_pos_world, config.scene)
    valid = finite & ~lost & (limited < plausible.LIMIT_ACTIONS)
    inserted = is_inserted(tip.pos_world, hole_pos_world, config.scene, config.task.insertion_depth_m)
    return Verdict(valid, valid & inserted, limited)


def is_inserted(
    tip_pos_world: Float[Array, "*n 3"],
    hole_pos_world: Float[Array, "*n 2"],
    scene: SceneConfig,
    depth_m: float,
) -> Bool[Array, "*n"]:
    """Whether pegs are in their holes: the tip so far below the plate's top, not under the hole, nor beside.

    Args:
        tip_pos_world: Centre of the peg's lower face, m.
        hole_pos_world: True centre of the hole, m.
        scene: Gives the height of the plate's top.
        depth_m: ``task.insertion_depth_m``.
    """
    x, y = (tip_pos_world[..., i] - hole_pos_world[..., i] for i in range(2))
    below = plate_top_m(scene) - tip_pos_world[..., 2]
    deep = (below >= depth_m) & (below < scene.hole_depth_m + BELOW_M)
    return deep & (x**2 + y**2 < BESIDE_M**2)


def nothing_done(attempts: Attempt, actions: int, joints: int) -> Rollout:
    """Rollouts of length 0, as NumPy arrays to write into."""
    n = len(attempts.peg_type)

    def zeros(*shape: int) -> np.ndarray:
        return np.zeros((n, *shape), np.float32)

    trace = Trace(
        wrench_sensor=zeros(actions, SUBSTEPS, 6),
        tip_pos_world=zeros(actions, 3),
        tip_quat_world=zeros(actions, 4),
        tip_linvel_world=zeros(actions, 3),
        tip_angvel_world=zeros(actions, 3),
        action_world=zeros(actions, 3),
    )
    felt = Felt(
        trace=trace,
        length=np.zeros(n, np.int32),
        tare_sensor=zeros(6),
        estimate_world=np.asarray(attempts.estimate_world),
        peg_type=np.asarray(attempts.peg_type),
    )
    truth = Truth(
        hole_type=np.asarray(attempts.hole_type),
        hole_pos_world=np.asarray(attempts.hole_pos_world),
        inserted=np.zeros(n, bool),
        valid=np.ones(n, bool),
        end_qpos=zeros(joints),
        end_qvel=zeros(joints),
    )
    return Rollout(felt, truth)
