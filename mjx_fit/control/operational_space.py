"""Operational-space control: pure arrays in, joint torques out. Knows no simulator.

Takes one world's arrays or, with the worlds as their last axis, those of many (``mjx_fit.utils.linalg``).

Task-space impedance shaped by the task-space inertia (Khatib, "A unified approach for motion and force
control of robot manipulators", 1987), in the form of VICES (Martín-Martín et al., 2019) and robosuite, where
position and rotation have an inertia each:

    Λ = (J M⁻¹ Jᵀ)⁻¹,  Λp = (Jp M⁻¹ Jpᵀ)⁻¹,  Λr = (Jr M⁻¹ Jrᵀ)⁻¹
    a = kp e - 2 ζ √kp v                      desired task acceleration (ap, ar)
    q̈₀ = kp₀ (q₀ - q) - 2 √kp₀ q̇              posture, in the null space
    τ = Jᵀ ((Λp ap, Λr ar) - Λ J q̈₀) + M q̈₀ + h     h: Coriolis and gravity

which is the usual sum of Jᵀ F and the posture torque M q̈₀ projected by I - Jᵀ Λ J M⁻¹. With F = Λ a instead,
accelerations in free space would be held apart, and not forces: a peg that is pressed on a plate would be
turned by its own push, and stand on one edge.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.config.sections.world import ControlConfig
from mjx_fit.control.kinematics import STRAIGHT_DOWN, jacobian, posture_towards, rotation_error
from mjx_fit.scene.robot import PANDA, Robot
from mjx_fit.types import Array, pytree
from mjx_fit.utils.linalg import (
    CholeskyFactor,
    cholesky_factor,
    cholesky_solve,
    column,
    solve_lower,
    times,
    total,
)

# Keeps the Cholesky factors finite at a singular posture; inertias are 1e-2 kg m2 and up, inverse inertias
# 1e-1 1/kg and up, so the damping moves a torque by less than one part in a thousand.
_DAMPING_MASS = 1e-6
_DAMPING_TASK = 1e-5


@pytree
class ArmState:
    """What the controller needs to know of the arm.

    Attributes:
        qpos: Joint angles, rad.
        qvel: Joint velocities, rad/s.
        mass_matrix: Joint-space inertia M, kg·m².
        bias: Coriolis and gravity torques h, N·m.
        tip_pos_world: m.
        tip_frame_world: Orientation of the tip as a rotation matrix.
        joint_anchor_world: A point on each joint's axis, m.
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
    """Linear (m/s) over angular (rad/s) velocity of the tip in the world frame."""
    return times(jacobian(arm.joint_anchor_world, arm.joint_axis_world, arm.tip_pos_world), arm.qvel)


def tip_quaternion(arm: ArmState) -> Float[Array, "4 *b"]:
    """Orientation of the tip, w x y z, with x not negative.

    Shepperd's method for the branch in which x is largest, as it is near straight down.
    """
    m = arm.tip_frame_world
    x = 0.5 * jnp.sqrt(jnp.maximum(1 + m[0, 0] - m[1, 1] - m[2, 2], 1e-6))
    wyz = jnp.stack([m[2, 1] - m[1, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]]) / (4 * x)
    return jnp.stack([wyz[0], x, wyz[1], wyz[2]])


def torque(
    arm: ArmState, goal_pos_world: Float[Array, "3 *b"], gains: ControlConfig, robot: Robot = PANDA
) -> Float[Array, "joints *b"]:
    """Joint torques that pull the tip to a goal, straight down.

    Args:
        arm: State of the arm.
        goal_pos_world: Where the tip should be, m.
        gains: Stiffnesses.
        robot: Gives the posture in the null space, and the torque limits.

    Returns:
        Torques within the robot's limits, N·m.
    """
    jac = jacobian(arm.joint_anchor_world, arm.joint_axis_world, arm.tip_pos_world)
    error = jnp.concatenate(
        [goal_pos_world - arm.tip_pos_world, rotation_error(arm.tip_frame_world, STRAIGHT_DOWN)]
    )
    stiffness = column(jnp.repeat(jnp.array([gains.kp_position, gains.kp_orientation]), 3), error)
    damping = 2 * gains.damping_ratio * jnp.sqrt(stiffness)
    task_acc = stiffness * error - damping * times(jac, arm.qvel)

    # The posture turns with the first joint, so that it never pulls the arm to the middle of the workspace.
    posture_error = posture_towards(arm.tip_pos_world, robot) - arm.qpos
    posture_acc = gains.kp_posture * posture_error - 2 * jnp.sqrt(gains.kp_posture) * arm.qvel

    # With M = L Lᵀ, J M⁻¹ Jᵀ = (L⁻¹ Jᵀ)ᵀ (L⁻¹ Jᵀ): half a solve, and symmetric by construction.
    whitened = solve_lower(cholesky_factor(arm.mass_matrix, _DAMPING_MASS), jac.swapaxes(0, 1))
    inverse_inertia = total(whitened[:, :, None] * whitened[:, None])
    root = cholesky_factor(inverse_inertia, _DAMPING_TASK)
    # The factor of a leading block is the leading block of the factor.
    of_position = CholeskyFactor(root.lower[:3], root.inverse_diagonal[:3])
    of_rotation = cholesky_factor(inverse_inertia[3:, 3:], _DAMPING_TASK)
    apart = [cholesky_solve(of_position, task_acc[:3]), cholesky_solve(of_rotation, task_acc[3:])]
    force = jnp.concatenate(apart) - cholesky_solve(root, times(jac, posture_acc))
    unlimited = total(jac * force[:, None]) + times(arm.mass_matrix, posture_acc) + arm.bias
    limit = column(np.array(robot.torque_limit_nm, np.float32), unlimited)
    return jnp.clip(unlimited, -limit, limit)
