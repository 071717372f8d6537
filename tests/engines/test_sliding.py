"""Contact of a sliding peg: it stays on, and friction is Coulomb's, in both worlds' parameters."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.control.kinematics import chain_of, inverse
from mjx_fit.control.policies import PolicyInput, stateless
from mjx_fit.engines.mjx.compiler import compiler_options
from mjx_fit.engines.mjx.step import WorldModel, observe
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.scene.build import simulation_scene
from mjx_fit.types import Attempt
from mjx_fit.utils.rates import SUBSTEPS

PUSH_M, BESIDE_M = 0.004, 0.055
DIRECTIONS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]], float)


def drag(world: str, speed_mps: float, friction: float) -> tuple[np.ndarray, np.ndarray]:
    """Drag four pegs past their holes; return contact (n, steps) and the wrenches of the last half second."""
    config = read_config(world_file(world), [f"scene.friction={friction}"])
    actions = round(0.02 / speed_mps * 10)
    touching = np.zeros((4, actions * SUBSTEPS), bool)
    step = np.zeros(4, int)

    def look(ids, batch):
        data = mujoco.MjData(engine.scene.models[0])
        for i, one in enumerate(ids):
            batch.get_data(i, data)
            touching[one, step[one]] = data.ncon > 0
        step[ids] += 1

    def command(seen: PolicyInput):
        goal = speed_mps * (seen.step + 1) / 10 * jnp.asarray(DIRECTIONS)[seen.start.policy]
        return jnp.append(goal - (seen.tip_pos_world[:2] - seen.start.estimate_world), -PUSH_M)

    engine = NativeEngine(config, 1, stateless(command), on_step=look)
    hole, kind = jnp.tile(jnp.array([[0.5, 0.0]]), (4, 1)), jnp.zeros(4, int)
    beside = hole + BESIDE_M * jnp.abs(jnp.asarray(DIRECTIONS))[:, ::-1]
    attempts = Attempt(kind, kind, hole, beside, jnp.arange(4), jax.random.split(jax.random.key(0), 4))
    felt = engine.run(attempts, actions).felt
    wrench = felt.trace.wrench_sensor - felt.tare_sensor[:, None, None]
    return touching, np.asarray(wrench)[:, -5:].reshape(4, -1, 6)


def losses_per_s(touching: np.ndarray) -> float:
    sliding = touching[:, touching.shape[1] // 3 :]
    return (sliding[:, :-1] & ~sliding[:, 1:]).sum() / (sliding.size * 0.002)


@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_a_dragged_peg_stays_on_the_socket_and_feels_coulombs_friction(friction):
    touching, wrench = drag("paper", 0.01, friction)
    assert losses_per_s(touching) < 1
    mean = wrench.mean(1)
    np.testing.assert_allclose(np.linalg.norm(mean[:, :2], axis=1) / mean[:, 2], friction, rtol=0.03)


def test_it_chattered_before():
    touching, _ = drag("as-2026-11", 0.02, 0.3)
    assert losses_per_s(touching) > 20


@pytest.mark.slow
def test_both_engines_ask_friction_for_the_same_acceleration():
    """One corner in contact, sliding: reference accelerations of its normal and its two tangents."""
    config = read_config(world_file("paper"))
    model = simulation_scene(config.scene).models[8]
    qpos = np.asarray(inverse(chain_of(model), jnp.array([0.5, 0.05, 0.05])))
    qpos = qpos + np.array([0, 0, 0, 0, 0.01, 0.01, 0], np.float32)
    qvel = np.array([0.02, 0.01, -0.02, 0.01, 0.03, 0.0, 0.01], np.float32)
    in_c = mujoco.MjData(model)
    in_c.qpos[:], in_c.qvel[:] = qpos, qvel
    mujoco.mj_kinematics(model, in_c)
    corners = np.array([[x, y, 0] for x in (-0.015, 0.015) for y in (-0.015, 0.015)])
    lowest = (in_c.site("tip").xpos + corners @ in_c.site("tip").xmat.reshape(3, 3).T)[:, 2].min()
    hole = in_c.mocap_pos[0] = np.array([0.5, 0, lowest + 5e-5], np.float32)
    mujoco.mj_forward(model, in_c)
    assert in_c.ncon == 1
    on_device = WorldModel(mjx.put_model(model), None)
    data = mjx.make_data(on_device.mjx).replace(
        qpos=jnp.asarray(qpos), qvel=jnp.asarray(qvel), mocap_pos=jnp.asarray(hole[None])
    )
    impl = jax.jit(observe, compiler_options=compiler_options())(on_device, data)._impl
    row = 7 + 3 * int(np.argmin(impl.contact.dist))
    acc, weight = (np.asarray(leaf[row : row + 3]) for leaf in (impl.efc_aref, impl.efc_D))
    expected_acc, expected_weight = in_c.efc_aref[-3:], in_c.efc_D[-3:]
    assert acc[0] == pytest.approx(expected_acc[0], rel=0.1)
    assert np.linalg.norm(acc[1:]) == pytest.approx(np.linalg.norm(expected_acc[1:]), rel=1e-3)
    np.testing.assert_allclose(weight, expected_weight, rtol=0.05)
