"""Sockets that stand askew and pegs held askew: what is simulated and how it is judged, in both engines."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from jaxlie import SE3, SO3
from mujoco import mjx

from mjx_fit.api import draw_attempts
from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.engines import attempt_rules
from mjx_fit.engines.attempt_rules import Tip
from mjx_fit.engines.mjx.compiler import compiler_options
from mjx_fit.engines.mjx.step import Models as MjxModels
from mjx_fit.engines.mjx.step import accelerate, observe
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.engines.native.models import Models
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.placement import GRASP, SOCKET, setting_of
from mjx_fit.types.physics import Physics

N = 72
CONFIG = Config()
UPSIDE_DOWN = SO3(jnp.array([0.0, 1.0, 0.0, 0.0]))


def askew(rng: np.random.Generator, n: int) -> Physics:
    """Draw poses of sockets and pegs."""
    large = {"z_m": 0.01, "x_m": 0.004, "y_m": 0.004, "yaw_rad": 0.3, "roll_rad": 0.1, "pitch_rad": 0.1}
    spread = {name: large[name.partition("_")[2]] for name in (*SOCKET, *GRASP)}
    return Physics(**{name: rng.uniform(-most, most, n).astype(np.float32) for name, most in spread.items()})


def reached(model: mujoco.MjModel, tip_world: SE3) -> np.ndarray:
    """Return joint angles that bring the TCP to a pose, by Gauss-Newton on MuJoCo's kinematics."""
    data, turn, error = mujoco.MjData(model), np.empty(4), np.empty(6)
    data.qpos[:] = [0, 0.2, 0, -2.0, 0, 2.2, 0.785]
    for _ in range(100):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        site = data.site("tip")
        mujoco.mju_mat2Quat(turn, site.xmat)
        away = SO3(jnp.asarray(tip_world.rotation().wxyz)) @ SO3(jnp.asarray(turn)).inverse()
        error[:3], error[3:] = np.asarray(tip_world.translation()) - site.xpos, np.asarray(away.log())
        jac = np.zeros((2, 3, model.nv))
        mujoco.mj_jacSite(model, data, jac[0], jac[1], site.id)
        data.qpos += np.linalg.lstsq(jac.reshape(6, -1), error, rcond=1e-6)[0]
    return data.qpos.copy()


@pytest.fixture(scope="module")
def states(scene):
    """Pegs that touch their sockets by 20 to 150 µm or hang above them, in the sockets' own frames."""
    rng = np.random.default_rng(1)
    physics, pair = askew(rng, N), np.arange(N) % 9
    hole = np.column_stack([rng.uniform(0.45, 0.55, N), rng.uniform(-0.1, 0.1, N)]).astype(np.float32)
    setting = setting_of(hole, physics, CONFIG)
    assert setting.socket_world is not None
    assert setting.peg_tip is not None
    depth = np.where(np.arange(N) < 12, -0.01, rng.uniform(2e-5, 1.5e-4, N))
    place = np.column_stack([rng.uniform(-0.02, 0.02, (N, 2)), -depth])
    lean = SO3.exp(jnp.asarray(rng.normal(0, 2e-3, (N, 3)), jnp.float32))
    peg = SE3.from_rotation_and_translation(lean @ UPSIDE_DOWN, jnp.asarray(place, jnp.float32))
    tip = setting.socket_world @ peg @ setting.peg_tip.inverse()
    each = [jax.tree.map(lambda leaf, i=i: leaf[i], tip) for i in range(N)]
    qpos = np.array([reached(scene.models[0], one) for one in each])
    qvel, push = rng.normal(0, 0.02, (N, 7)), rng.normal(0, 3, (N, 7))
    return pair, hole, physics, setting, peg, *(x.astype(np.float32) for x in (qpos, qvel, push))


@pytest.fixture(scope="module")
def one_step(scene, states):
    """Accelerations and readings of MJX and of C in each state, and the distances of their contacts."""
    pair, _, physics, setting, _, *fields = states
    models, axes = MjxModels.of(scene).of_worlds(pair)
    models, axes = models._replace(setting=setting), axes._replace(setting=0)

    def step(model, qpos, qvel, push):
        socket = model.setting.socket_world
        place = {"mocap_pos": socket.translation()[None], "mocap_quat": socket.rotation().wxyz[None]}
        data = observe(model, mjx.make_data(model.mjx).replace(qpos=qpos, qvel=qvel, **place))
        data = accelerate(model, data.replace(ctrl=push + data.qfrc_bias))
        return data.qacc_smooth, data.qacc, data.sensordata, data._impl.contact.dist.min()

    compiled = jax.jit(jax.vmap(step, (axes, 0, 0, 0)), compiler_options=compiler_options())
    in_mjx = [np.asarray(x) for x in compiled(models, *fields)]
    own = Models(scene).of(pair, physics, setting.peg_hand)
    in_c = [in_c_engine(model, setting.socket_world, i, fields) for i, model in enumerate(own)]
    return in_mjx, [np.stack(x) for x in zip(*in_c, strict=True)]


def in_c_engine(model: mujoco.MjModel, socket: SE3, i: int, fields: list[np.ndarray]):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], push = (field[i] for field in fields)
    data.mocap_pos[0] = np.asarray(socket.translation())[i]
    data.mocap_quat[0] = np.asarray(socket.rotation().wxyz)[i]
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    data.ctrl[:] = push + data.qfrc_bias
    mujoco.mj_forward(model, data)
    deepest = data.contact.dist.min() if data.ncon else 1.0
    return data.qacc_smooth.copy(), data.qacc.copy(), data.sensordata.copy(), deepest


def test_both_engines_find_the_same_contact_and_forces(one_step):
    (smooth, acc, reading, dist), in_c = one_step
    touches = in_c[3] < 0
    assert 0.5 < touches.mean() < 0.9
    assert (touches == (dist < 0)).all()
    np.testing.assert_allclose(dist[touches], in_c[3][touches], atol=2e-6)
    relative = [
        abs(a - b).max(1) / abs(b).max(1) for a, b in zip((smooth, acc, reading), in_c[:3], strict=True)
    ]
    assert relative[0].max() < 1e-4
    for error in relative[1:]:
        assert error[~touches].max() < 1e-4
        assert np.quantile(error[touches], 0.5) < 2e-3
        assert np.quantile(error[touches], 0.9) < 0.15


def contacts(model: mujoco.MjModel, qpos: np.ndarray, socket_pose: np.ndarray, tip: np.ndarray):
    """Return points and depths of the contacts of an arm at rest, and their wrench at the peg's tip."""
    data, each, wrench = mujoco.MjData(model), np.zeros(6), np.zeros(6)
    data.qpos[:] = qpos
    data.mocap_quat[0], data.mocap_pos[0] = socket_pose[:4], socket_pose[4:]
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    data.ctrl[:] = data.qfrc_bias
    mujoco.mj_forward(model, data)
    for i, one in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, i, each)
        force = one.frame.reshape(3, 3).T @ each[:3]
        wrench += np.concatenate([force, np.cross(one.pos - tip, force)])
    points = [[*one.pos, one.dist] for one in data.contact]
    return np.array(sorted(points, key=lambda point: tuple(np.round(point, 5)))), wrench


def test_a_peg_askew_in_a_socket_askew_alike_feels_the_same(scene, states):
    """As a straight peg of a tool that is turned as much: the same contacts, and the same wrench.

    Where the tool is turned the arm stands otherwise, and a soft contact's force depends on its inertia.
    """
    pair, _, physics, setting, peg, qpos, *_ = states
    askew_pegs, straight = Models(scene).of(pair, physics, setting.peg_hand), setting.socket_world @ peg
    errors = []
    for i in range(12, 42):
        one = jax.tree.map(lambda leaf, i=i: leaf[i], straight)
        socket, tip = np.asarray(setting.socket_world.wxyz_xyz)[i], np.asarray(one.translation())
        points, wrench = contacts(askew_pegs[i], qpos[i], socket, tip)
        turned = reached(scene.models[0], one)
        expected, like = contacts(scene.models[pair[i]], turned, socket, tip)
        assert points.shape == expected.shape
        if len(points):
            np.testing.assert_allclose(points, expected, atol=1e-6)
            errors.append(np.linalg.norm((wrench - like)[:3]) / np.linalg.norm(like[:3]))
    assert len(errors) > 20
    assert np.median(errors) < 0.04
    assert max(errors) < 0.15


def test_pegs_are_judged_in_the_frame_of_their_socket(states):
    """A peg askew in a socket askew is where it would be in an upright one."""
    _, hole, physics, setting, peg, *_ = states
    tip = setting.socket_world @ peg @ setting.peg_tip.inverse()
    still = np.zeros((N, 3), np.float32)
    seen = Tip(tip.translation(), tip.rotation().wxyz, still, still)
    found = jax.vmap(partial(attempt_rules.peg_of, config=CONFIG))(seen, setting, physics)
    top = plate_top_m(CONFIG.scene)
    expected = np.asarray(peg.translation()) + np.column_stack([hole, np.full(N, top)])
    np.testing.assert_allclose(found.pos_world, expected, atol=2e-7)
    same = abs((np.asarray(found.quat_world) * np.asarray(peg.rotation().wxyz)).sum(1))
    np.testing.assert_allclose(same, 1, atol=1e-6)
    assert (np.asarray(found.quat_world)[:, 1] > 0).all()


def test_an_upright_world_costs_nothing():
    setting = setting_of(np.zeros((3, 2), np.float32), Physics(), CONFIG)
    assert setting.socket_world is setting.peg_tip is setting.peg_hand is None
    tip = Tip(*(np.zeros((3, width)) for width in (3, 4, 3, 3)))
    assert attempt_rules.peg_of(tip, setting, Physics(), CONFIG) is tip


@pytest.mark.parametrize("key", [*SOCKET, *GRASP])
def test_a_constant_pose_is_that_of_worlds_that_draw_it(key):
    constant = setting_of(
        np.ones((2, 2), np.float32), Physics(), read_config(None, [f"placement.{key}=0.001"])
    )
    drawn = setting_of(np.ones((2, 2), np.float32), Physics(**{key: np.full(2, 0.001, np.float32)}), CONFIG)
    for one, other in zip(jax.tree.leaves(constant), jax.tree.leaves(drawn), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7)


@pytest.mark.parametrize(("grasp_yaw", "inserted"), [(-0.15, True), (0.0, False)])
def test_a_turned_peg_fits_a_turned_socket_alone(grasp_yaw, inserted):
    """The TCP's z axis points down: yaws in the hand and on the table have opposite signs."""
    turned = ["placement.socket_yaw_rad=0.15", f"placement.grasp_yaw_rad={grasp_yaw}"]
    config = read_config(None, [*turned, "spiral.radius_m=0.001", "spiral.wiggle_m=0"])
    drawn = draw_attempts(jax.random.key(0), 6, config=config)
    attempts = replace(drawn, hole_type=drawn.peg_type, estimate_world=drawn.hole_pos_world)
    done = NativeEngine(config, threads=1).run(attempts, 30)
    assert (np.asarray(done.truth.inserted) == inserted).all()
    assert np.asarray(done.truth.valid).all()
