"""Contact points of boxes against C MuJoCo's."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mjx_fit.simulate import boxes

PEG = np.array([0.02, 0.0125, 0.035])
PLATE = np.array([[0.04, 0.03, 0.02], [0.01, 0.03, 0.02]])
PLATE_CENTRE = np.array([[0.0, 0, -0.02], [0.05, 0, -0.02]])
COUNT = 12

few_degrees = st.floats(-0.06, 0.06)


@pytest.fixture(scope="module")
def in_c():
    """One box that can be put anywhere over two boxes side by side."""
    spec = mujoco.MjSpec()
    for centre, half in zip(PLATE_CENTRE, PLATE, strict=True):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=centre)
    body = spec.worldbody.add_body()
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=PEG)
    model = spec.compile()
    return model, mujoco.MjData(model)


@pytest.fixture(scope="module")
def ours():
    def one(pos, frame):
        fixed = (np.zeros((1, 3)), PEG[None], PLATE_CENTRE, PLATE)
        peg_centre, peg, plate_centre, plate = (jnp.asarray(x, jnp.float32)[..., None] for x in fixed)
        where = pos[:, None], frame[:, :, None]
        return boxes.deepest_points(peg_centre, peg, plate_centre, plate, *where, COUNT)

    return jax.jit(one)


def placed(in_c, ours, pos, turn):
    """Contacts of the box at a place, turned by a rotation vector: C's and ours."""
    model, data = in_c
    quat, frame = np.zeros(4), np.zeros(9)
    angle = np.linalg.norm(turn)
    mujoco.mju_axisAngle2Quat(quat, np.asarray(turn) / max(angle, 1e-12), angle)
    mujoco.mju_quat2Mat(frame, quat)
    data.qpos[:] = [*pos, *quat]
    mujoco.mj_forward(model, data)
    keep = data.contact.dist < 0
    points = ours(jnp.asarray(pos, jnp.float32), jnp.asarray(frame.reshape(3, 3), jnp.float32))
    return data.contact.dist[keep], data.contact.pos[keep], data.contact.frame[keep, :3], points


def lowest(turn):
    """How far below its centre the turned box reaches."""
    frame, quat = np.zeros(9), np.zeros(4)
    angle = np.linalg.norm(turn)
    mujoco.mju_axisAngle2Quat(quat, np.asarray(turn) / max(angle, 1e-12), angle)
    mujoco.mju_quat2Mat(frame, quat)
    return np.abs(frame.reshape(3, 3)[2]) @ PEG


@settings(max_examples=150, deadline=None)
@given(
    st.tuples(few_degrees, few_degrees, few_degrees),
    st.floats(-0.08, 0.08),
    st.floats(-0.04, 0.04),
    st.floats(1e-6, 2e-4),
)
def test_points_on_the_plate_are_mujocos(in_c, ours, turn, x, y, deep):
    """Same depth, place and normal of the deepest point, and none of C's points is far from ours."""
    dist, pos, normal, points = placed(in_c, ours, [x, y, lowest(turn) - deep], turn)
    assume(len(dist) <= COUNT)
    # Faces, not edges: C's normal is an axis of one of the two, all within a few degrees of the world's.
    assume(len(dist) and (np.abs(normal).max(1) > 0.99).all())
    assume(len(dist) == 1 or np.diff(np.sort(dist))[0] > 1e-7)
    mine = np.asarray(points.dist[:, 0]) < 0
    first = dist.argmin()
    assert points.dist[0, 0] == pytest.approx(dist[first], abs=2e-6)
    assert np.asarray(points.frame[0, 0, :, 0]) @ -normal[first] > 0.999
    apart = np.linalg.norm(np.asarray(points.pos_plate[mine, :, 0])[None] - pos[:, None], axis=-1)
    # Points that hardly touch come and go with rounding.
    assert (apart.min(1) < 5e-4)[dist < 0.05 * dist[first]].all()


def test_a_wall_pushes_sideways(in_c, ours):
    """Beside the plate, overlapping it by 50 micrometres: four corners and a horizontal normal."""
    pos = [0.06 + 0.02 - 5e-5, 0.001, -0.002]
    dist, _, normal, points = placed(in_c, ours, pos, [0, 0, 0])
    assert (dist < 0).sum() == 4
    assert np.abs(normal[:, 0]) == pytest.approx(1)
    assert (np.asarray(points.dist[:, 0]) < 0).sum() == 4
    assert np.asarray(points.dist[:4, 0]) == pytest.approx(-5e-5, abs=1e-7)
    assert np.asarray(points.frame[:4, 0, :, 0]) == pytest.approx(np.tile([-1, 0, 0], (4, 1)), abs=1e-6)


def test_frames_are_orthonormal_and_right_handed(ours):
    frame = np.asarray(ours(jnp.array([0.03, 0.02, 0.0349]), jnp.eye(3)).frame)[0, :, :, 0]
    assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-6)
    assert np.linalg.det(frame) == pytest.approx(1, abs=1e-6)


def test_apart_is_no_contact(ours):
    for pos in ([0, 0, 0.0351], [0.09, 0, 0.03], [0, 0.05, 0.03]):
        assert (np.asarray(ours(jnp.array(pos), jnp.eye(3)).dist) > 0).all()


@given(st.lists(st.integers(-1000, 1000), min_size=3, max_size=30, unique=True), st.integers(1, 5))
def test_the_largest_are_found_in_order(values, count):
    value = np.asarray(values, np.float32) / 1000
    fields = jnp.stack([jnp.asarray(value), jnp.arange(len(value), dtype=jnp.float32)])
    got = np.asarray(boxes._largest(jnp.asarray(value)[:, None], fields[..., None], count))
    positive = sorted((v for v in value.tolist() if v > 0), reverse=True)[:count]
    for (found, place), want in zip(got[:, :, 0], [*positive, *[0.0] * count], strict=False):
        assert found == pytest.approx(want, rel=1e-4)
        assert want == 0 or found == value[int(place)]
