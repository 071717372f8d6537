"""Rules of an attempt, shared by both engines: start, end and recorded data.

The functions take NumPy or JAX arrays, for one world or many.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxlie import SE3, SO3
from jaxtyping import Bool, Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.control import operational_space
from mjx_fit.control.kinematics import Chain, inverse
from mjx_fit.control.operational_space import ArmState
from mjx_fit.engines import plausible
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.placement import Setting, as_if_upright, setting_of
from mjx_fit.sensors.pose import start_pose, turned
from mjx_fit.types import Array, Attempt, Felt, Rollout, Trace, Truth, pytree
from mjx_fit.types.physics import Physics
from mjx_fit.utils.arrays import is_off
from mjx_fit.utils.rates import SUBSTEPS

BESIDE_M, BELOW_M = 0.02, 0.002
"""Horizontal distance from the hole's centre, m, and distance below the hole's floor, m.

A low peg beyond either one has left the socket and is not inserted. The first is a quarter of the smallest
socket's half width, the second more than the contact compliance allows.
"""


@pytree
class Tip:
    """Pose and twist of the TCP, as in a row of a ``Trace``.

    Attributes:
        pos_world: Position, m.
        quat_world: Orientation, quaternion w x y z.
        linvel_world: Linear velocity, m/s.
        angvel_world: Angular velocity, rad/s.
    """

    pos_world: Float[Array, "*n 3"]
    quat_world: Float[Array, "*n 4"]
    linvel_world: Float[Array, "*n 3"]
    angvel_world: Float[Array, "*n 3"]


@pytree
class Verdict:
    """Status of worlds at the end of an action.

    Attributes:
        valid: Whether the simulation is finite and plausible (``mjx_fit.engines.plausible``).
        inserted: Whether the peg is inserted and the world valid.
        limited: Number of consecutive actions, up to this one, that ended with a joint at its torque limit.
        sensed: Whether the robot measures an insertion in a valid world; None: it relies on the truth.
    """

    valid: Bool[Array, "*n"]
    inserted: Bool[Array, "*n"]
    limited: Int[Array, "*n"]
    sensed: Bool[Array, "*n"] | None = None

    @property
    def over(self) -> Bool[Array, "*n"]:
        """True if the attempt ends here. Its world is then frozen, and the rest of the batch continues."""
        return (self.inserted if self.sensed is None else self.sensed) | ~self.valid

    def as_sensed(self, sensed: Bool[Array, "*n"] | None) -> "Verdict":
        """Return this verdict with what the robot measures; None: it relies on the truth."""
        return self if sensed is None else replace(self, sensed=sensed & self.valid)


def start_qpos(chain: Chain, attempts: Attempt, config: Config) -> Float[Array, "n joints"]:
    """Compute the start posture of attempts, joint angles in rad.

    The TCP is above the estimate, on its axis and turned as it is, but for the tilt of the tool, of which the
    robot is unaware.
    """
    place, turn = start_pose(attempts.estimate_world, config)
    tilt = jnp.broadcast_to(tilt_world(attempts.physics, config), place.shape)
    return jax.vmap(inverse, (None, 0, 0, None if turn is None else 0))(chain, place, tilt, turn)


def tilt_world(physics: Physics, config: Config) -> Float[Array, "*n 3"]:
    """Return the rotation vector from straight down to where the robot takes the tool to point down, rad."""
    gains = operational_space.gains_of(config, physics)
    x, y = jnp.broadcast_arrays(*(jnp.asarray(tilt) for tilt in (gains.tilt_x_rad, gains.tilt_y_rad)))
    return jnp.stack([x, y, jnp.zeros_like(x)], -1)


def tip_of(arm: ArmState, physics: Physics, config: Config) -> Tip:
    """Return the pose and twist of one arm's TCP, as its kinematics report them: without the tool's tilt."""
    velocity = operational_space.tip_velocity(arm)
    quat = operational_space.tip_quaternion(arm)
    gains = operational_space.gains_of(config, physics)
    if not (is_off(gains.tilt_x_rad) and is_off(gains.tilt_y_rad)):
        quat = turned(quat, -tilt_world(physics, config))
    return Tip(arm.tip_pos_world, quat, velocity[:3], velocity[3:])


def peg_of(tip: Tip, setting: Setting | None, physics: Physics, config: Config) -> Tip:
    """Return one world's peg as if its socket were upright at its place and the nominal height.

    Pose and twist are the TCP's where the peg is straight in the hand and the socket upright; the twist is
    that of the TCP in any case.
    """
    if setting is None or (setting.socket_world is None and setting.peg_tip is None):
        return tip
    quat = jnp.asarray(turned(tip.quat_world, tilt_world(physics, config)))
    peg = SE3.from_rotation_and_translation(SO3(quat), jnp.asarray(tip.pos_world))
    peg = peg if setting.peg_tip is None else peg @ setting.peg_tip
    peg = as_if_upright(peg, setting, plate_top_m(config.scene))
    quat = peg.rotation().wxyz
    return replace(tip, pos_world=peg.translation(), quat_world=jnp.where(quat[1] < 0, -quat, quat))


def as_judged(rollouts: Rollout, config: Config) -> Rollout:
    """Return rollouts (n,) whose traces hold the pegs as they were judged (``peg_of``), not the TCPs."""
    physics, trace = rollouts.truth.physics, rollouts.felt.trace
    setting = setting_of(np.asarray(rollouts.truth.hole_pos_world), physics, config)
    tips = Tip(trace.tip_pos_world, trace.tip_quat_world, trace.tip_linvel_world, trace.tip_angvel_world)
    one = jax.vmap(partial(peg_of, config=config), (0, None, None))
    pegs = jax.vmap(one)(tips, setting, physics)
    trace = replace(
        trace, tip_pos_world=np.asarray(pegs.pos_world), tip_quat_world=np.asarray(pegs.quat_world)
    )
    return replace(rollouts, felt=replace(rollouts.felt, trace=trace))


def trace_row(tip: Tip, wrench_sensor: Float[Array, "*n 50 6"], command_world: Float[Array, "*n k"]) -> Trace:
    """Return the record of an action: wrenches, command, and the TCP state at its end."""
    return Trace(
        wrench_sensor=wrench_sensor,
        tip_pos_world=tip.pos_world,
        tip_quat_world=tip.quat_world,
        tip_linvel_world=tip.linvel_world,
        tip_angvel_world=tip.angvel_world,
        action_world=command_world[..., :3],
        turn_world=command_world[..., 3:] if command_world.shape[-1] > 3 else None,
    )


def judge(
    tip: Tip,
    hole_pos_world: Float[Array, "*n 2"],
    finite: Bool[Array, "*n"],
    at_limit: Bool[Array, "*n"],
    limited: Int[Array, "*n"],
    config: Config,
) -> Verdict:
    """Judge the worlds at the end of an action.

    Args:
        tip: Peg at the end of the action (``peg_of``).
        hole_pos_world: True centre of the hole, m.
        finite: Whether the state and the torques that led to it are finite.
        at_limit: Whether a joint is at its torque limit at the end of the action.
        limited: ``Verdict.limited`` of the previous action; 0 at the start.
        config: Configuration, with ``scene`` and ``task.insertion_depth_m`` in use.
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
    """Check for insertion: the TCP is this deep in the hole, not under its floor and not next to the socket.

    Args:
        tip_pos_world: TCP, the centre of the peg's lower face, m.
        hole_pos_world: True centre of the hole, m.
        scene: Defines the height of the socket's top and the depth of the hole.
        depth_m: Insertion depth ``task.insertion_depth_m``, m.
    """
    x, y = (tip_pos_world[..., i] - hole_pos_world[..., i] for i in range(2))
    below = plate_top_m(scene) - tip_pos_world[..., 2]
    deep = (below >= depth_m) & (below < scene.hole_depth_m + BELOW_M)
    return deep & (x**2 + y**2 < BESIDE_M**2)


def nothing_done(
    attempts: Attempt, actions: int, joints: int, config: Config, *, turns: bool = False
) -> Rollout:
    """Allocate rollouts of length 0, as writable NumPy arrays."""
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
        turn_world=zeros(actions, 3) if turns else None,
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
        physics=jax.tree.map(np.array, attempts.physics),
    )
    return Rollout(felt, truth, sensed=np.zeros(n, bool) if config.task.success == "sensed" else None)
