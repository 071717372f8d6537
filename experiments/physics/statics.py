"""Check that the F/T sensor reads the commanded force and that taring removes the weight everywhere.

    python experiments/physics/statics.py

A goal a few millimetres below the surface (and to a side, as far as friction holds) presses a peg on the
plate, off the hole. At rest nothing depends on damping: the commanded force is F = (Λp kp e, Λr kp e),
computed here with NumPy from MuJoCo's mass matrix and Jacobian. The sensor, whose z axis points down, must
read this force, and its torque about the right axes.
"""

# pyright: reportAttributeAccessIssue=false
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import shared

from benchmarks.python_loop import arm_state, stiffness_acc, task_space
from mjx_fit.config.schema import Config
from mjx_fit.control import operational_space
from mjx_fit.control.kinematics import chain_of, inverse
from mjx_fit.scene.build import Scene, pair_index, simulation_scene
from mjx_fit.scene.robot import PANDA

N = 60
SECONDS = 6.0
OFFSET_M = 0.045
"""Distance from the hole's centre to the pressed point, clear of every hole, m."""


def main() -> None:
    """Press pegs of all shapes at random positions."""
    config = shared.config()
    scene = simulation_scene(config.scene)
    rng = np.random.default_rng(0)
    gains = operational_space.gains_of(config)
    torque = jax.jit(lambda arm, goal: operational_space.torque(arm, goal, gains))
    chain = chain_of(scene.models[0])
    rows = [_press(scene, config, chain, torque, rng, i) for i in range(N)]
    pressed = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    force = np.linalg.norm(pressed["force_error"], axis=1) / np.linalg.norm(pressed["force"], axis=1)
    push = np.abs(pressed["force_error"][:, 2] / pressed["force"][:, 2])
    torque_error = np.linalg.norm(pressed["torque_error"], axis=1)
    tare = _tare(scene, chain, rng)
    results = {
        "presses": N,
        "push_n": shared.quantiles(pressed["force"][:, 2], (0, 0.5, 1)),
        "relative_error_of_the_push": shared.quantiles(push, (0.5, 1)),
        "relative_error_of_the_force_vector": shared.quantiles(force, (0.5, 1)),
        "torque_nm": shared.quantiles(np.linalg.norm(pressed["torque"], axis=1), (0, 0.5, 1)),
        "torque_error_nm": shared.quantiles(torque_error, (0.5, 1)),
        "tared_reading_at_rest_n": float(tare[:, :3].max()),
        "tared_reading_at_rest_nm": float(tare[:, 3:].max()),
        "tared_postures": len(tare),
        "holds": {
            "push_within_2_percent": bool(push.max() < 0.02),
            "torque_about_the_right_axis": bool(torque_error.max() < 0.05),
            "tare_removes_weight": bool(tare[:, :3].max() < 0.01),
        },
    }
    shared.save("statics", results)


def _press(scene: Scene, config: Config, chain, torque, rng: np.random.Generator, i: int) -> dict:
    """Press one peg for ``SECONDS`` and compare the last reading with the commanded force."""
    pair = i % scene.n_types, (i // scene.n_types) % scene.n_types
    model = scene.models[pair_index(*pair, scene.n_types)]
    data = mujoco.MjData(model)
    hole = rng.uniform(*np.array(PANDA.workspace_m).T)
    angle = rng.uniform(0, 2 * np.pi)
    start = np.append(hole + OFFSET_M * np.array([np.cos(angle), np.sin(angle)]), scene.plate_top_m + 1e-4)
    push = rng.uniform(0.002, 0.005)
    # Lateral force of at most half the friction limit.
    side = 0.5 * config.scene.friction * push * rng.uniform(-0.7, 0.7, 2)
    goal = (start + np.append(side, -push)).astype(np.float32)
    data.mocap_pos[0] = [*hole, scene.plate_top_m]
    data.qpos[:] = inverse(chain, jnp.asarray(start, jnp.float32))
    for _ in range(round(SECONDS / model.opt.timestep)):
        mujoco.mj_step1(model, data)
        data.ctrl[:] = torque(arm_state(model, data), goal)
        mujoco.mj_step2(model, data)
    mujoco.mj_forward(model, data)
    # Commanded wrench at rest, force stacked on torque, world frame.
    expected = task_space(model, data)[3] @ stiffness_acc(data, goal, config.control)
    weight = -0.1 * 9.81  # of the peg below the sensor, whose z axis points down: the arm holds it up
    reading = data.sensordata - np.array([0, 0, weight, 0, 0, 0])
    # Force of the arm on the peg, in the sensor's frame; the task-space force acts at the TCP.
    frame = data.site("wrist_sensor").xmat.reshape(3, 3)
    force = frame.T @ expected[:3]
    lever = frame.T @ (data.site("tip").xpos - data.site("wrist_sensor").xpos)
    torque_there = frame.T @ expected[3:] + np.cross(lever, force)
    return {
        "force": force,
        "force_error": reading[:3] - force,
        "torque": torque_there,
        "torque_error": reading[3:] - torque_there,
    }


def _tare(scene: Scene, chain, rng: np.random.Generator) -> np.ndarray:
    """Measure |tared reading| (n, 6) at rest in free space across the workspace, one second after taring."""
    config = shared.config()
    gains = operational_space.gains_of(config)
    torque = jax.jit(lambda arm, goal: operational_space.torque(arm, goal, gains))
    model = scene.models[0]
    rows = []
    for x, y in np.stack(np.meshgrid(np.linspace(0.35, 0.65, 5), np.linspace(-0.3, 0.3, 5)), -1).reshape(
        -1, 2
    ):
        place = np.array([x, y, scene.plate_top_m + rng.uniform(0.02, 0.1)], np.float32)
        data = mujoco.MjData(model)
        data.mocap_pos[0] = [0, 5, 0]
        data.qpos[:] = inverse(chain, place)
        mujoco.mj_forward(model, data)
        data.ctrl[:] = data.qfrc_bias
        mujoco.mj_forward(model, data)
        tare = data.sensordata.copy()
        for _ in range(500):
            mujoco.mj_step1(model, data)
            data.ctrl[:] = torque(arm_state(model, data), place)
            mujoco.mj_step2(model, data)
        rows.append(np.abs(data.sensordata - tare))
    return np.array(rows)


if __name__ == "__main__":
    shared.begin()
    main()
