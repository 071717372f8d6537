"""Run the control law in NumPy on one C simulation, as most scripts do: a baseline and a check."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import jax
import mujoco
import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.world import ControlConfig
from mjx_fit.control.kinematics import STRAIGHT_DOWN, chain_of
from mjx_fit.control.operational_space import ArmState
from mjx_fit.engines.attempt_rules import start_qpos
from mjx_fit.scene.build import pair_index, simulation_scene
from mjx_fit.scene.robot import PANDA
from mjx_fit.types import Attempt


def torque(
    model, data, goal_pos_world: Float[np.ndarray, "3"], gains: ControlConfig
) -> Float[np.ndarray, "7"]:
    """Compute joint torques (N·m) by the control law in float64, with MuJoCo's Jacobian and mass matrix."""
    jac, mass, inertia, apart = task_space(model, data)
    damping = 2 * gains.damping_ratio * np.sqrt(np.repeat([gains.kp_position, gains.kp_orientation], 3))
    task_acc = stiffness_acc(data, goal_pos_world, gains) - damping * (jac @ data.qvel)
    posture = np.array(PANDA.posture_rad)
    posture[[0, 6]] += np.arctan2(*data.site("tip").xpos[1::-1])
    posture_acc = gains.kp_posture * (posture - data.qpos) - 2 * np.sqrt(gains.kp_posture) * data.qvel
    force = apart @ task_acc - inertia @ jac @ posture_acc
    limit = np.array(PANDA.torque_limit_nm)
    return np.clip(jac.T @ force + mass @ posture_acc + data.qfrc_bias, -limit, limit)


def stiffness_acc(
    data, goal_pos_world: Float[np.ndarray, "3"], gains: ControlConfig
) -> Float[np.ndarray, "6"]:
    """Compute the TCP acceleration from the stiffness term, kp e: m/s² stacked on rad/s²."""
    tip = data.site("tip")
    turn = 0.5 * np.cross(tip.xmat.reshape(3, 3), STRAIGHT_DOWN, axisa=0, axisb=0, axisc=0).sum(1)
    error = np.concatenate([goal_pos_world - tip.xpos, turn])
    return np.repeat([gains.kp_position, gains.kp_orientation], 3) * error


def task_space(
    model, data
) -> tuple[
    Float[np.ndarray, "6 7"], Float[np.ndarray, "7 7"], Float[np.ndarray, "6 6"], Float[np.ndarray, "6 6"]
]:
    """Compute TCP Jacobian, mass matrix M, task-space inertia Λ, and block-diagonal matrix of Λp and Λr."""
    jac, mass = np.zeros((6, model.nv)), np.zeros((model.nv, model.nv))
    mujoco.mj_jacSite(model, data, jac[:3], jac[3:], model.site("tip").id)
    mujoco.mj_fullM(model, data, mass)
    inverse = jac @ np.linalg.solve(mass, jac.T)
    apart = np.asarray(block_diag(np.linalg.inv(inverse[:3, :3]), np.linalg.inv(inverse[3:, 3:])))
    return jac, mass, np.linalg.inv(inverse), apart


def arm_state(model, data) -> ArmState:
    """Return the inputs of the library's controller from one C simulation."""
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    tip = data.site("tip")
    fields = (data.qpos, data.qvel, mass, data.qfrc_bias, tip.xpos, tip.xmat.reshape(3, 3))
    return ArmState(*(field.astype(np.float32) for field in (*fields, data.xanchor, data.xaxis)))


def one_world(
    config: Config, attempts: Attempt
) -> tuple[mujoco.MjModel, mujoco.MjData, Float[np.ndarray, "3"]]:
    """Set up the first attempt as one C simulation, with a goal that presses the peg onto the socket."""
    scene = simulation_scene(config.scene)
    first = jax.tree.map(lambda leaf: leaf[:1], attempts)
    model = scene.models[int(pair_index(first.peg_type, first.hole_type, scene.n_types)[0])]
    data = mujoco.MjData(model)
    data.qpos[:] = np.asarray(start_qpos(chain_of(model), first, config))[0]
    data.mocap_pos[0] = [*np.asarray(first.hole_pos_world)[0], scene.plate_top_m]
    return (
        model,
        data,
        np.append(np.asarray(first.estimate_world)[0], scene.plate_top_m - config.spiral.push_m),
    )
