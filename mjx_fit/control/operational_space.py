"""Operational-space control as pure functions from arrays to joint torques, independent of any simulator.

Arrays belong to one world or, with worlds as their last axis, to many (``mjx_fit.utils.linalg``).

Task-space impedance shaped by the task-space inertia (Khatib, "A unified approach for motion and force
control of robot manipulators", 1987), in the form of VICES (Martín-Martín et al., 2019) and robosuite, with
separate inertias for position and rotation:

    Λ = (J M⁻¹ Jᵀ)⁻¹,  Λp = (Jp M⁻¹ Jpᵀ)⁻¹,  Λr = (Jr M⁻¹ Jrᵀ)⁻¹
    a = kp e - 2 ζ √kp v                      desired task acceleration (ap, ar)
    q̈₀ = kp₀ (q₀ - q) - 2 √kp₀ q̇              posture, in the null space
    τ = Jᵀ ((Λp ap, Λr ar) - Λ J q̈₀) + M q̈₀ + h     h: Coriolis and gravity

This equals the usual sum of Jᵀ F and the posture torque M q̈₀ projected by I - Jᵀ Λ J M⁻¹. With F = Λ a,
accelerations in free space would be decoupled instead of forces: pressing the peg on the socket would rotate
it, so that it stands on one edge.
"""

from dataclasses import dataclass, fields
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.control.force_control import position_force
from mjx_fit.control.kinematics import (
    STRAIGHT_DOWN,
    jacobian,
    posture_towards,
    rotation_error,
    turned_down,
)
from mjx_fit.scene.robot import PANDA, Robot
from mjx_fit.types import Array, pytree
from mjx_fit.types.physics import AS_CONFIGURED, Physics
from mjx_fit.utils.arrays import is_off
from mjx_fit.utils.linalg import (
    CholeskyFactor,
    cholesky_factor,
    cholesky_solve,
    column,
    solve_lower,
    times,
    total,
)

# Damping keeps the Cholesky factors finite at singular postures; inertias are at least 1e-2 kg m2, inverse
# inertias at least 1e-1 1/kg, so it changes torques by less than one part in a thousand.
_DAMPING_MASS = 1e-6
_DAMPING_TASK = 1e-5
GRAVITY_MPS2 = 9.81
_FRICTION_RADPS = 0.03
"""Joint velocity at which Coulomb friction is mostly developed, rad/s; a step would be unstable at 500 Hz."""


@pytree
class ArmState:
    """State of the arm that the controller needs.

    Attributes:
        qpos: Joint angles, rad.
        qvel: Joint velocities, rad/s.
        mass_matrix: Joint-space inertia M, kg·m².
        bias: Coriolis and gravity torques h, N·m.
        tip_pos_world: Position of the TCP, m.
        tip_frame_world: Orientation of the TCP as a rotation matrix.
        joint_anchor_world: Point on each joint's axis, m.
        joint_axis_world: Direction of each joint's axis.
    """

    qpos: Float[Array, "joints *b"]
    qvel: Float[Array, "joints *b"]
    mass_matrix: Float[Array, "joints joints *b"]
    bias: Float[Array, "joints *b"]
    tip_pos_world: Float[Array, "3 *b"]
    tip_frame_world: Float[Array, "3 3 *b"]
    joint_anchor_world: Float[Array, "joints 3 *b"]
    joint_axis_world: Float[Array, "joints 3 *b"]


def tip_velocity(arm: ArmState) -> Float[Array, "6 *b"]:
    """Compute linear (m/s) over angular (rad/s) velocity of the TCP in the world frame."""
    return times(jacobian(arm.joint_anchor_world, arm.joint_axis_world, arm.tip_pos_world), arm.qvel)


def tip_quaternion(arm: ArmState) -> Float[Array, "4 *b"]:
    """Compute the orientation of the TCP as a quaternion w x y z with x >= 0.

    Shepperd's method is used in the branch with the largest x, which holds near straight down.
    """
    m = arm.tip_frame_world
    x = 0.5 * jnp.sqrt(jnp.maximum(1 + m[0, 0] - m[1, 1] - m[2, 2], 1e-6))
    wyz = jnp.stack([m[2, 1] - m[1, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]]) / (4 * x)
    return jnp.stack([wyz[0], x, wyz[1], wyz[2]])


@dataclass(frozen=True)
class Gains:
    """Gains of the controller, and imperfections of the arm that it does not know.

    Each is a number, or an array with one value per world. See ``ControlConfig`` and ``ArmConfig``.
    """

    kp_position: Any
    kp_orientation: Any
    damping_ratio: Any
    kp_posture: Any
    dead_zone_n: Any
    dead_zone_nm: Any
    joint_friction_nm: Any
    joint_damping_nms: Any
    payload_kg: Any
    tilt_x_rad: Any
    tilt_y_rad: Any
    push: str
    press_n: float
    press_speed_mps: float
    slide_n: float


def gains_of(config: Config, physics: Physics = AS_CONFIGURED) -> Gains:
    """Return the gains of a configuration, or of worlds that have some of their own."""
    own = {field.name: getattr(physics, field.name, None) for field in fields(Gains)}
    constant = vars(config.control) | vars(config.arm)
    return Gains(**{name: constant[name] if value is None else value for name, value in own.items()})


def torque(
    arm: ArmState, goal_world: Float[Array, "k *b"], gains: Gains, robot: Robot = PANDA
) -> Float[Array, "joints *b"]:
    """Compute joint torques that pull the TCP to a goal.

    Args:
        arm: State of the arm.
        goal_world: Goal of the TCP, k = 3: its position, m, straight down; or k = 6: followed by its rotation
            vector from straight down, rad. The third component is a vertical command if a push is a force
            (``mjx_fit.control.force_control``).
        gains: Stiffness and damping, and the arm's imperfections.
        robot: Robot with the null-space posture and the torque limits.

    Returns:
        Joint torques within the robot's limits, N·m.
    """
    jac = jacobian(arm.joint_anchor_world, arm.joint_axis_world, arm.tip_pos_world)
    goal_pos_world, goal_turn_world = goal_world[:3], goal_world[3:]
    goal_frame = STRAIGHT_DOWN
    if len(goal_world) == 6:
        # XLA would compute the sines again for each of the many entries below that depend on them.
        goal_frame = lax.optimization_barrier(turned_down(goal_turn_world))
    turn = rotation_error(arm.tip_frame_world, goal_frame)
    if not (is_off(gains.tilt_x_rad) and is_off(gains.tilt_y_rad)):
        tilt = (gains.tilt_x_rad, gains.tilt_y_rad, 0.0)
        turn += jnp.stack([jnp.broadcast_to(angle, turn.shape[1:]) for angle in tilt])
    error = jnp.concatenate([goal_pos_world - arm.tip_pos_world, turn])
    stiffness = _six(gains.kp_position, gains.kp_orientation, error)
    damping = 2 * gains.damping_ratio * jnp.sqrt(stiffness)
    velocity = times(jac, arm.qvel)
    task_acc = stiffness * error - damping * velocity

    # Turn the posture with the first joint, so that it never pulls the arm to the middle of the workspace.
    posture_error = posture_towards(arm.tip_pos_world, robot) - arm.qpos
    posture_acc = gains.kp_posture * posture_error - 2 * jnp.sqrt(gains.kp_posture) * arm.qvel

    # Given M = L Lᵀ, J M⁻¹ Jᵀ = (L⁻¹ Jᵀ)ᵀ (L⁻¹ Jᵀ): half a solve, and symmetric by construction.
    whitened = solve_lower(cholesky_factor(arm.mass_matrix, _DAMPING_MASS), jac.swapaxes(0, 1))
    inverse_inertia = total(whitened[:, :, None] * whitened[:, None])
    root = cholesky_factor(inverse_inertia, _DAMPING_TASK)
    # The factor of a leading block is the leading block of the factor.
    of_position = CholeskyFactor(root.lower[:3], root.inverse_diagonal[:3])
    of_rotation = cholesky_factor(inverse_inertia[3:, 3:], _DAMPING_TASK)
    if gains.push == "force":
        error = jnp.concatenate([error[:2], goal_pos_world[2:]])
        press = gains.press_n, gains.press_speed_mps, gains.slide_n
        on_tip = position_force(error, velocity[:3], of_position, (stiffness[:2], damping[:2]), press)
    else:
        on_tip = cholesky_solve(of_position, task_acc[:3])
    apart = [on_tip, cholesky_solve(of_rotation, task_acc[3:])]
    force = _felt_by_arm(jnp.concatenate(apart), gains) - cholesky_solve(root, times(jac, posture_acc))
    unlimited = total(jac * force[:, None]) + times(arm.mass_matrix, posture_acc) + arm.bias
    unlimited = _disturbed(unlimited, jac, arm.qvel, gains)
    limit = column(np.array(robot.torque_limit_nm, np.float32), unlimited)
    return jnp.clip(unlimited, -limit, limit)


def _felt_by_arm(force: Float[Array, "6 *b"], gains: Gains) -> Float[Array, "6 *b"]:
    """Reduce the magnitude of each component by the dead zone, at most to zero."""
    if is_off(gains.dead_zone_n) and is_off(gains.dead_zone_nm):
        return force
    zone = _six(gains.dead_zone_n, gains.dead_zone_nm, force)
    return jnp.sign(force) * jnp.maximum(abs(force) - zone, 0)


def _disturbed(
    torque_nm: Float[Array, "joints *b"],
    jac: Float[Array, "6 joints *b"],
    qvel: Float[Array, "joints *b"],
    gains: Gains,
) -> Float[Array, "joints *b"]:
    """Add friction in the joints, and the weight of the payload at the TCP."""
    if not is_off(gains.joint_friction_nm):
        torque_nm -= gains.joint_friction_nm * jnp.tanh(qvel / _FRICTION_RADPS)
    if not is_off(gains.joint_damping_nms):
        torque_nm -= gains.joint_damping_nms * qvel
    if not is_off(gains.payload_kg):
        torque_nm -= GRAVITY_MPS2 * gains.payload_kg * jac[2]
    return torque_nm


def _six(linear: Any, angular: Any, like: Float[Array, "6 *b"]) -> Float[Array, "6 *ones"]:
    """Repeat a linear and an angular value three times each; numbers broadcast over the worlds."""
    if isinstance(linear, float) and isinstance(angular, float):
        return column(jnp.repeat(jnp.array([linear, angular]), 3), like)
    worlds = [jnp.broadcast_to(value, like.shape[1:]) for value in (linear, angular)]
    return jnp.repeat(jnp.stack(worlds), 3, axis=0)
