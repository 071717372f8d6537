"""One step of MJX against one step of C MuJoCo."""

import copy

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from mjx_fit.control.kinematics import chain_of, inverse
from mjx_fit.engines.mjx import contact
from mjx_fit.engines.mjx.compiler import compiler_options
from mjx_fit.engines.mjx.step import Models, WorldModel, accelerate, observe
from mjx_fit.scene.build import Scene

N_FREE = N_CONTACT = 54
N_AT_A_LIMIT = 14


@pytest.fixture(scope="module")
def states(scene):
    """Random states, all nine pairs: first far over the plate, then touching it by 20 to 150 µm, tilted."""
    rng = np.random.default_rng(0)
    n = N_FREE + N_CONTACT
    free = np.arange(n) < N_FREE
    hole = np.column_stack([rng.uniform(0.4, 0.6, n), rng.uniform(-0.2, 0.2, n)])
    depth = np.where(free, -0.02, rng.uniform(2e-5, 1.5e-4, n))
    tip = np.column_stack([hole + rng.uniform(-0.025, 0.025, (n, 2)), scene.plate_top_m - depth])
    qpos = np.array(jax.vmap(inverse, (None, 0))(chain_of(scene.models[0]), tip.astype(np.float32)))
    qpos += rng.normal(0, 1, (n, 7)) * np.where(free[:, None], [0.2, 0.02, 0.2, 0.02, 0.2, 0.02, 0.2], 2e-4)
    qvel = rng.normal(0, 1, (n, 7)) * np.where(free, 0.5, 0.02)[:, None]
    push = rng.normal(0, 3, (n, 7))
    # Some free ones press a joint beyond its limit, on either side.
    low, high = scene.models[0].jnt_range.T
    qpos[:7] = np.where(np.eye(7, dtype=bool), low - 0.01, qpos[:7])
    qpos[7:N_AT_A_LIMIT] = np.where(np.eye(7, dtype=bool), high + 0.01, qpos[7:N_AT_A_LIMIT])
    mocap = np.column_stack([hole, np.full(n, scene.plate_top_m)])
    return np.arange(n) % 9, *(x.astype(np.float32) for x in (qpos, qvel, push, mocap))


@pytest.fixture(scope="module")
def one_step(scene, states):
    """One step of MJX and of C from each state: (qacc_smooth, qacc, sensordata, next qvel) of both."""
    pair, *fields = states
    models, axes = Models.of(scene).of_worlds(pair)

    def step(model, qpos, qvel, push, mocap):
        data = mjx.make_data(model.mjx).replace(qpos=qpos, qvel=qvel, mocap_pos=mocap[None])
        data = observe(model, data)
        data = accelerate(model, data.replace(ctrl=push + data.qfrc_bias))
        return data.qacc_smooth, data.qacc, data.sensordata, contact.integrate(model.mjx, data).qvel

    batched = jax.vmap(step, (axes, 0, 0, 0, 0))
    compiled = jax.jit(lambda *a: batched(models, *a), compiler_options=compiler_options())
    in_mjx = [np.asarray(x) for x in compiled(*fields)]
    in_c = [_step_in_c(scene.models[p], *state) for p, *state in zip(pair, *fields, strict=True)]
    return in_mjx, [np.stack(x) for x in zip(*in_c, strict=True)]


def _step_in_c(model, qpos, qvel, push, mocap):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.mocap_pos[0] = qpos, qvel, mocap
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    data.ctrl[:] = push + data.qfrc_bias
    mujoco.mj_forward(model, data)
    before = data.qacc_smooth.copy(), data.qacc.copy(), data.sensordata.copy()
    mujoco.mj_step(model, data)
    return *before, data.qvel.copy()


def relative(a, b):
    return np.abs(a - b).max(-1) / np.abs(b).max(-1)


def test_smooth_dynamics_agree(one_step):
    in_mjx, in_c = one_step
    assert relative(in_mjx[0], in_c[0]).max() < 1e-4
    for a, b in zip(in_mjx, in_c, strict=True):
        assert relative(a[:N_FREE], b[:N_FREE]).max() < 1e-4


def test_contact_dynamics_agree_in_quantiles(one_step):
    """Ours are the 8 deepest points of faces on faces; C makes up to 8 per pair, and one of an edge on an
    edge.

    Where both find the same contacts the accelerations and readings agree to float32; the tail is states
    in which a face rests on several boxes and the choice of points differs.
    """
    in_mjx, in_c = one_step
    for which in (1, 2, 3):
        error = relative(in_mjx[which][N_FREE:], in_c[which][N_FREE:])
        q50, q75, q90 = np.quantile(error, [0.5, 0.75, 0.9])
        assert q50 < 2e-3
        assert q75 < 3e-2
        assert q90 < 0.15


def test_states_in_contact_do_touch(one_step):
    in_mjx, _ = one_step
    touched = np.abs(in_mjx[1] - in_mjx[0]).max(1) > 1.0
    assert not touched[N_AT_A_LIMIT:N_FREE].any()
    assert touched[:N_AT_A_LIMIT].mean() > 0.4  # others are on their way back
    assert touched[N_FREE:].mean() > 0.5


def test_a_corner_on_the_plate_is_one_contact(scene):
    """As in C, and with the same depth."""
    model = scene.models[8]
    qpos = np.asarray(inverse(chain_of(model), jnp.array([0.5, 0.05, 0.05])))
    qpos = qpos + np.array([0, 0, 0, 0, 0.01, 0.01, 0], np.float32)  # tilted about both axes
    in_c = mujoco.MjData(model)
    in_c.qpos[:] = qpos
    mujoco.mj_kinematics(model, in_c)
    corners = np.array([[x, y, 0] for x in (-0.015, 0.015) for y in (-0.015, 0.015)])
    lowest = (in_c.site("tip").xpos + corners @ in_c.site("tip").xmat.reshape(3, 3).T)[:, 2].min()
    hole = in_c.mocap_pos[0] = np.array([0.5, 0, lowest + 5e-5], np.float32)
    mujoco.mj_forward(model, in_c)
    assert (in_c.contact.dist < 0).sum() == 1
    on_device = WorldModel(mjx.put_model(model), None)
    data = mjx.make_data(on_device.mjx).replace(qpos=jnp.asarray(qpos), mocap_pos=jnp.asarray(hole[None]))
    distance = jax.jit(observe, compiler_options=compiler_options())(on_device, data)._impl.contact.dist
    assert (distance < 0).sum() == 1
    assert distance.min() == pytest.approx(in_c.contact.dist.min(), rel=0.05)


@pytest.mark.parametrize(
    ("change", "needed"),
    [
        (lambda model: setattr(model.opt, "cone", mujoco.mjtCone.mjCONE_PYRAMIDAL), "an elliptic cone"),
        (lambda model: setattr(model.opt, "integrator", mujoco.mjtIntegrator.mjINT_EULER), "implicitfast"),
        (lambda model: model.geom_condim.fill(4), "contacts of three dimensions"),
        (lambda model: model.jnt_limited.fill(0), "limits on every joint"),
    ],
)
def test_a_model_that_would_be_misread_is_refused(scene, change, needed):
    model = copy.copy(scene.models[0])
    change(model)
    with pytest.raises(ValueError, match=needed):
        Models.of(Scene((model,), scene.config, scene.robot))
