import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks import python_loop
from mjx_fit.api import load_config
from mjx_fit.config.schema import Config
from mjx_fit.control import operational_space
from mjx_fit.control.kinematics import STRAIGHT_DOWN, chain_of, inverse, rotation_error
from mjx_fit.scene.robot import PANDA

GAINS = operational_space.gains_of(Config())
LIMIT_NM = np.array(PANDA.torque_limit_nm, np.float32)


def random_states(model, n, seed=0):
    """MjData at random states near the working posture, position and velocity stages current."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        data = mujoco.MjData(model)
        data.qpos[:] = np.asarray(PANDA.posture_rad) + rng.normal(0, 0.15, 7)
        data.qvel[:] = rng.normal(0, 0.3, 7)
        mujoco.mj_forward(model, data)
        yield data


def textbook_torque(model, data, goal):
    """VICES's form with explicit inverses and projector, float64, from MuJoCo's own Jacobian."""
    mass = np.zeros((7, 7))
    mujoco.mj_fullM(model, data, mass)
    linear, angular = np.zeros((3, 7)), np.zeros((3, 7))
    mujoco.mj_jacSite(model, data, linear, angular, model.site("tip").id)
    jac = np.vstack([linear, angular])
    quat, goal_quat, error_quat, turn = np.empty(4), np.empty(4), np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat, data.site("tip").xmat)
    mujoco.mju_mat2Quat(goal_quat, STRAIGHT_DOWN.astype(float).ravel())
    mujoco.mju_negQuat(quat, quat)
    mujoco.mju_mulQuat(error_quat, goal_quat, quat)
    # The controller's error is the sine of the angle along the axis; quat2Vel gives the angle.
    mujoco.mju_quat2Vel(turn, error_quat, 1.0)
    angle = np.linalg.norm(turn)
    turn *= np.sin(angle) / angle
    error = np.concatenate([goal - data.site("tip").xpos, turn])
    kp = np.repeat([GAINS.kp_position, GAINS.kp_orientation], 3)
    task = np.linalg.inv(jac @ np.linalg.inv(mass) @ jac.T)
    of_position = np.linalg.inv(linear @ np.linalg.inv(mass) @ linear.T)
    of_rotation = np.linalg.inv(angular @ np.linalg.inv(mass) @ angular.T)
    wanted = kp * error - 2 * GAINS.damping_ratio * np.sqrt(kp) * (jac @ data.qvel)
    bearing = np.arctan2(data.site("tip").xpos[1], data.site("tip").xpos[0])
    posture = np.asarray(PANDA.posture_rad) + bearing * np.eye(7)[0] + bearing * np.eye(7)[6]
    null = mass @ (GAINS.kp_posture * (posture - data.qpos) - 2 * np.sqrt(GAINS.kp_posture) * data.qvel)
    projector = np.eye(7) - jac.T @ task @ jac @ np.linalg.inv(mass)
    impedance = linear.T @ of_position @ wanted[:3] + angular.T @ of_rotation @ wanted[3:]
    unlimited = impedance + projector @ null + data.qfrc_bias
    return np.clip(unlimited, -LIMIT_NM, LIMIT_NM)


def test_torque_is_the_textbooks(scene):
    model = scene.models[0]
    rng = np.random.default_rng(5)
    for data in random_states(model, 30):
        goal = data.site("tip").xpos + rng.uniform(-0.02, 0.02, 3)
        arm = python_loop.arm_state(model, data)
        got = np.asarray(operational_space.torque(arm, jnp.asarray(goal, jnp.float32), GAINS))
        want = textbook_torque(model, data, goal)
        assert np.abs(got - want).max() < 2e-3 * np.abs(want).max()
        assert python_loop.torque(model, data, goal, Config().control) == pytest.approx(
            want, rel=1e-6, abs=1e-6
        )


def test_a_push_is_the_force_of_the_formula(scene):
    """τ = Jᵀ (F_xy, F_z, Λr ar) + posture, with explicit inverses in float64."""
    model, config = scene.models[0], load_config(None, "control.push=force", "control.slide_n=5")
    gains, control, rng = operational_space.gains_of(config), config.control, np.random.default_rng(6)
    for data in random_states(model, 20):
        command = rng.uniform(-0.02, 0.02, 3)
        goal = data.site("tip").xpos * [1, 1, 0] + command
        arm = python_loop.arm_state(model, data)
        got = np.asarray(operational_space.torque(arm, jnp.asarray(goal, jnp.float32), gains))
        mass, linear, angular = np.zeros((7, 7)), np.zeros((3, 7)), np.zeros((3, 7))
        mujoco.mj_fullM(model, data, mass)
        mujoco.mj_jacSite(model, data, linear, angular, model.site("tip").id)
        plane = np.linalg.inv(linear[:2] @ np.linalg.inv(mass) @ linear[:2].T)
        pull = plane @ (control.kp_position * command[:2])
        pull *= min(1, control.slide_n / np.linalg.norm(pull))
        damping = 2 * control.damping_ratio * np.sqrt(control.kp_position)
        velocity = linear @ data.qvel
        sideways = pull - plane @ (damping * velocity[:2])
        down = control.press_n * (command[2] / 0.004 - velocity[2] / control.press_speed_mps)
        moved = textbook_torque(model, data, data.site("tip").xpos)
        of_position = np.linalg.inv(linear @ np.linalg.inv(mass) @ linear.T)
        moved_force = -of_position @ (damping * velocity)  # what the textbook has instead, at its own goal
        want = moved + linear.T @ (np.append(sideways, down) - moved_force)
        inside = np.abs(got) < LIMIT_NM
        assert inside.sum() >= 3  # at random states the first joints may be at their limits
        assert np.abs(got - want)[inside].max() < 3e-3 * np.abs(want).max()


def test_torques_stay_within_limits(scene):
    model = scene.models[0]
    data = next(random_states(model, 1))
    arm = python_loop.arm_state(model, data)
    got = np.asarray(operational_space.torque(arm, jnp.array([3.0, -3.0, 3.0]), GAINS))
    assert (np.abs(got) <= LIMIT_NM).all()
    assert (np.abs(got) == LIMIT_NM).any()


def test_tip_velocity_and_quaternion_are_mujocos(scene):
    model = scene.models[0]
    for data in random_states(model, 10, seed=2):
        arm = python_loop.arm_state(model, data)
        velocity, quat = np.zeros(6), np.zeros(4)
        site = mujoco.mjtObj.mjOBJ_SITE
        mujoco.mj_objectVelocity(model, data, site, model.site("tip").id, velocity, 0)
        assert operational_space.tip_velocity(arm) == pytest.approx(np.roll(velocity, 3), abs=1e-5)
        mujoco.mju_mat2Quat(quat, data.site("tip").xmat)
        assert operational_space.tip_quaternion(arm) == pytest.approx(quat * np.sign(quat[1]), abs=1e-5)


def test_the_wrist_reads_what_is_commanded(scene):
    """A square peg pressed on the plate, off the hole: at rest the sensor reads Λp kp e, mostly down."""
    model = scene.models[8]
    hole, place = np.array([0.45, 0.1]), np.array([0.49, 0.13, scene.plate_top_m])
    data = mujoco.MjData(model)
    data.mocap_pos[0] = [*hole, scene.plate_top_m]
    data.qpos[:] = inverse(chain_of(model), jnp.asarray(place, jnp.float32))
    goal = place + np.array([0.0003, -0.0002, -0.004])
    command = jax.jit(lambda arm: operational_space.torque(arm, jnp.asarray(goal, jnp.float32), GAINS))
    for _ in range(1000):
        mujoco.mj_step1(model, data)
        data.ctrl[:] = command(python_loop.arm_state(model, data))
        mujoco.mj_step2(model, data)
    mujoco.mj_forward(model, data)
    *_, apart = python_loop.task_space(model, data)
    turn = np.asarray(rotation_error(data.site("tip").xmat.reshape(3, 3), STRAIGHT_DOWN))
    commanded = GAINS.kp_position * apart @ np.concatenate([goal - data.site("tip").xpos, turn])
    frame = data.site("wrist_sensor").xmat.reshape(3, 3)
    reading = frame @ (data.sensordata[:3] - np.array([0, 0, -0.1 * 9.81]))
    assert commanded[2] < -10
    # A push turns nothing: the peg stays flat, to a hundredth of a degree.
    assert np.abs(turn).max() < 2e-4
    assert reading == pytest.approx(commanded[:3], abs=0.02 * float(np.linalg.norm(commanded[:3])))


def test_free_space_reach_settles_without_overshoot(scene):
    """A closed loop in C at 500 Hz: 1 cm along each axis, hardly passed."""
    model = scene.models[0]
    torque = jax.jit(lambda arm, goal: operational_space.torque(arm, goal, GAINS))
    for axis in range(3):
        data = mujoco.MjData(model)
        data.qpos[:] = PANDA.posture_rad
        mujoco.mj_forward(model, data)
        start = data.site("tip").xpos.copy()
        goal = start + 0.01 * np.eye(3)[axis]
        data.mocap_pos[0] = [2.0, 2.0, 0.0]
        track = []
        for _ in range(300):
            mujoco.mj_forward(model, data)
            arm = python_loop.arm_state(model, data)
            data.ctrl[:] = torque(arm, jnp.asarray(goal, jnp.float32))
            mujoco.mj_step(model, data)
            track.append((data.site("tip").xpos - start)[axis])
        assert max(track) < 0.0105
        assert abs(track[-1] - 0.01) < 0.0005
