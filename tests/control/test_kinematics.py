import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from mjx_fit.control.kinematics import STRAIGHT_DOWN, chain_of, forward, inverse, rotation_error
from mjx_fit.scene.robot import PANDA


def corners_and_inside(rng, n):
    low, high = np.asarray(PANDA.workspace_m).T
    planar = np.vstack([rng.uniform(low - 0.03, high + 0.03, (n, 2)), [low - 0.03, high + 0.03]])
    return np.column_stack([planar, rng.uniform(0.04, 0.12, len(planar))]).astype(np.float32)


def test_forward_and_jacobian_agree_with_mujoco(scene):
    model = scene.models[0]
    data = mujoco.MjData(model)
    chain = chain_of(model)
    for qpos in np.asarray(PANDA.posture_rad) + np.random.default_rng(0).normal(0, 0.3, (20, 7)):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        linear, angular = np.zeros((3, 7)), np.zeros((3, 7))
        mujoco.mj_jacSite(model, data, linear, angular, model.site("tip").id)
        position, frame, jac = forward(chain, jnp.asarray(qpos, jnp.float32))
        assert position == pytest.approx(data.site("tip").xpos, abs=2e-6)
        assert np.allclose(frame, data.site("tip").xmat.reshape(3, 3), atol=2e-6)
        assert np.allclose(jac, np.vstack([linear, angular]), atol=3e-6)


def test_inverse_reaches_the_workspace_within_joint_limits(scene):
    model = scene.models[0]
    data = mujoco.MjData(model)
    goals = corners_and_inside(np.random.default_rng(1), 60)
    solutions = jax.vmap(inverse, (None, 0))(chain_of(model), goals)
    for goal, qpos in zip(goals, np.asarray(solutions), strict=True):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        assert np.abs(data.site("tip").xpos - goal).max() < 20e-6
        assert np.allclose(data.site("tip").xmat.reshape(3, 3), STRAIGHT_DOWN, atol=1e-4)
        assert (qpos > model.jnt_range[:, 0]).all()
        assert (qpos < model.jnt_range[:, 1]).all()


def test_rotation_error_is_the_small_rotation_vector():
    turn = np.array([0.01, -0.02, 0.015])
    quat, matrix = np.empty(4), np.empty(9)
    mujoco.mju_axisAngle2Quat(quat, turn / np.linalg.norm(turn), np.linalg.norm(turn))
    mujoco.mju_quat2Mat(matrix, quat)
    goal = matrix.reshape(3, 3) @ STRAIGHT_DOWN
    assert rotation_error(jnp.asarray(STRAIGHT_DOWN), jnp.asarray(goal)) == pytest.approx(turn, abs=2e-5)
