"""Contact points of boxes against C MuJoCo's."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import assume, event, given, settings
from hypothesis import strategies as st

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.engines.mjx import collision
from mjx_fit.scene.build import simulation_scene
from mjx_fit.scene.variation import box_ids

PEG = np.array([0.02, 0.0125, 0.035])
PLATE = np.array([[0.04, 0.03, 0.02], [0.01, 0.03, 0.02]])
PLATE_CENTRE = np.array([[0.0, 0, -0.02], [0.05, 0, -0.02]])
COUNT = 12

few_degrees = st.floats(-0.06, 0.06)
many_degrees = st.one_of(st.floats(-0.3, -0.01), st.floats(0.01, 0.3))
OFF_EDGES_M = 1.3e-6


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
    def one(pos, frame, count=COUNT):
        fixed = (np.zeros((1, 3)), PEG[None], PLATE_CENTRE, PLATE)
        peg_centre, peg, plate_centre, plate = (jnp.asarray(x, jnp.float32)[..., None] for x in fixed)
        where = pos[:, None], frame[:, :, None]
        boxes = collision.Boxes(peg_centre, peg), collision.Boxes(plate_centre, plate)
        return collision.deepest_points(*boxes, *where, count)

    return jax.jit(one, static_argnums=2)


def placed(in_c, ours, pos, turn):
    """Contacts of the box at a place, turned by a rotation vector: C's and ours."""
    model, data = in_c
    quat = turned(turn)
    data.qpos[:] = [*pos, *quat]
    mujoco.mj_forward(model, data)
    keep = data.contact.dist < 0
    frame = data.geom_xmat[-1].reshape(3, 3)
    points = ours(jnp.asarray(pos, jnp.float32), jnp.asarray(frame, jnp.float32))
    normal = data.contact.frame[keep, :3]
    of_a_face = np.maximum(np.abs(normal).max(1), np.abs(normal @ frame).max(1)) > 1 - 1e-9
    return data.contact.dist[keep], data.contact.pos[keep], normal, of_a_face, points


def turned(turn):
    """Straight down, as the tool is, and then turned by a rotation vector: a quaternion."""
    quat, angle = np.zeros(4), np.linalg.norm(turn)
    mujoco.mju_axisAngle2Quat(quat, np.asarray(turn) / max(angle, 1e-12), angle)
    mujoco.mju_mulQuat(quat, quat, np.array([0.0, 1, 0, 0]))
    return quat


def reach(turn):
    """How far the turned box reaches from its centre, along each axis of the plate."""
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, turned(turn))
    return np.abs(frame.reshape(3, 3)) @ PEG


def require_as_in_c(dist, pos, normal, of_a_face, points):
    """As many points, as deep, in the same places, with the same normals."""
    mine = np.asarray(points.dist[:, 0])
    assert (mine < 0).sum() == len(dist)
    assert mine[: len(dist)] == pytest.approx(np.sort(dist), abs=2e-7)
    apart = np.linalg.norm(np.asarray(points.pos_plate[: len(dist), :, 0])[None] - pos[:, None], axis=-1)
    nearest = apart.argmin(1)
    assert (apart.min(1) < 2e-5).all()
    along = (np.asarray(points.frame[:, 0, :, 0])[nearest] * -normal).sum(1)
    assert along == pytest.approx(1, abs=1e-6)


def require_mujocos(in_c, ours, pos, turn):
    """Compare with C, unless a point hardly touches: such points come and go with rounding.

    Hypothesis tries constants of the code, such as half a peg; at exactly those places edges coincide, and
    the engines count a point once or twice.
    """
    beside = np.array([pos[0] + OFF_EDGES_M, pos[1] + OFF_EDGES_M, pos[2]])
    dist, *_, of_a_face, _ = found = placed(in_c, ours, beside, turn)
    assume(0 < len(dist) <= COUNT)
    assume(dist.max() < -1e-7)
    event(f"{len(dist)} points, {'faces' if of_a_face.all() else 'edges'}")
    require_as_in_c(*found)


@settings(max_examples=300, deadline=None)
@given(
    st.tuples(few_degrees, few_degrees, few_degrees),
    st.floats(-0.08, 0.08),
    st.floats(-0.04, 0.04),
    st.floats(1e-5, 2e-4),
)
def test_points_are_mujocos(in_c, ours, turn, x, y, deep):
    require_mujocos(in_c, ours, [x, y, reach(turn)[2] - deep], turn)


@settings(max_examples=300, deadline=None)
@given(
    st.tuples(many_degrees, many_degrees, many_degrees),
    st.floats(-0.02, 0.02),
    st.floats(2e-4, 2e-3),
    st.one_of(st.floats(-0.03, 0.0), st.floats(1e-5, 2e-3)),
)
def test_points_at_the_rim_and_beside_it_are_mujocos(in_c, ours, turn, y, deep, height):
    """The peg overlaps the side of the plate, at any height or at the height of its rim."""
    along_x, _, along_z = reach(turn)
    z = along_z - height if height > 0 else height
    require_mujocos(in_c, ours, [0.06 + along_x - deep, y, z], turn)


@pytest.mark.parametrize(
    ("pos", "turn"),
    [
        ([-0.05975, -0.02738, 0.03533], [-0.0393, 0.0, 0.0217]),  # edges along the same axis of both boxes
        ([0.07998, 0.001, 0.0349], [0.0, 0.002, 0.0]),
    ],
)
def test_edges_of_the_same_axis_and_rims_are_mujocos(in_c, ours, pos, turn):
    require_as_in_c(*placed(in_c, ours, pos, turn))


@pytest.mark.parametrize("tilt", [0.0, 0.002])
def test_a_wall_pushes_sideways(in_c, ours, tilt):
    """Beside the plate, overlapping it by some micrometres: a horizontal normal, as in C."""
    pos = [0.06 + 0.02 - 5e-5, 0.001, -0.002]
    dist, _, normal, of_a_face, points = placed(in_c, ours, pos, [0, tilt, 0])
    assert of_a_face.all()
    mine = np.asarray(points.dist[:, 0])
    assert (mine < 0).sum() == len(dist)
    assert mine[: len(dist)] == pytest.approx(np.sort(dist), abs=2e-7)
    assert np.abs(normal[:, 0]).min() > 0.999
    assert np.asarray(points.frame[: len(dist), 0, :, 0]) == pytest.approx(-normal, abs=1e-6)
    for frame in np.asarray(points.frame)[: len(dist), :, :, 0]:
        assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-6)
        assert np.linalg.det(frame) == pytest.approx(1, abs=1e-6)


def test_frames_are_orthonormal_and_right_handed():
    """Take normals in all directions, also along the axes: a world diverged where a frame was not finite."""
    normals = np.random.default_rng(0).normal(0, 1, (3, 200))
    normals[:, :6] = [[1, -1, 0, 0, 0, 0], [0, 0, 1, -1, 0, 0], [0, 0, 0, 0, 1, -1]]
    normals /= np.linalg.norm(normals, axis=0)
    frames = np.moveaxis(
        np.asarray(collision.frames(jnp.asarray(normals, jnp.float32)[..., None]))[..., 0], -1, 0
    )
    assert frames[:, 0] == pytest.approx(normals.T, abs=1e-6)
    assert frames @ frames.swapaxes(1, 2) == pytest.approx(np.tile(np.eye(3), (200, 1, 1)), abs=2e-6)
    assert np.linalg.det(frames) == pytest.approx(1, abs=2e-6)


def test_all_pairs_of_a_peg_of_four_boxes_touch():
    """Four prongs flat on the seam between two boxes: eight pairs of four points each."""
    prongs = [[x, 0.0, 0.0] for x in (-0.03, -0.01, 0.01, 0.03)], [[0.004, 0.01, 0.01]] * 4
    halves = [[0.0, y, 0.0] for y in (-0.05, 0.05)], [[0.05, 0.05, 0.01]] * 2

    @jax.jit
    def dist(pos, frame):
        boxes = ([jnp.array(field)[..., None] for field in body] for body in (prongs, halves))
        peg, plate = (collision.Boxes(*fields) for fields in boxes)
        return collision.deepest_points(peg, plate, pos, frame, 40).dist

    touching = dist(jnp.array([[0.0], [0.0], [0.0199]]), jnp.eye(3)[..., None]) < 0
    assert touching.sum() == 32


def test_points_stay_on_the_boxes_where_edges_are_equally_deep():
    """A world diverged: two axes from two roundings of one choice, and a point kilometres away."""
    scene = simulation_scene(SceneConfig())
    model = scene.models[3]  # a rectangle in a cross
    pos = np.array([-0.00146442, -0.00147405, 0.06998096])
    frame = np.array(
        [
            [9.99999816e-01, -2.37272077e-04, -5.58832477e-04],
            [-2.37223225e-04, -9.99999968e-01, 8.74836113e-05],
            [-5.58853216e-04, -8.73510272e-05, -9.99999840e-01],
        ]
    )

    @jax.jit
    def found(pos, frame):
        ids = (box_ids(scene, name, count) for name, count in (("peg_", 2), ("hole_", 9)))
        fields = ((model.geom_pos[own], model.geom_size[own]) for own in ids)
        peg, plate = (
            collision.Boxes(*(jnp.tile(jnp.asarray(field, jnp.float32)[..., None], 64) for field in both))
            for both in fields
        )
        return collision.deepest_points(peg, plate, pos, frame, 24)

    rng = np.random.default_rng(0)
    for _ in range(30):
        points = found(
            jnp.asarray(pos[:, None] + rng.normal(0, 1e-9, (3, 64)), jnp.float32),
            jnp.asarray(frame[..., None] * (1 + rng.normal(0, 6e-8, (3, 3, 64))), jnp.float32),
        )
        touching = np.asarray(points.dist) < 0
        assert touching.sum(0).min() >= 10
        assert np.abs(np.asarray(points.pos_plate).swapaxes(1, 2)[touching]).max() < 0.1


def test_apart_is_no_contact(ours):
    for pos in ([0, 0, 0.0351], [0.09, 0, 0.03], [0, 0.05, 0.03]):
        assert (np.asarray(ours(jnp.array(pos), jnp.eye(3)).dist) > 0).all()


def test_few_slots_keep_the_deepest_points_and_spare_ones_stay_empty(ours):
    where = jnp.array([0.03, 0.02, 0.0349]), jnp.eye(3)
    dist = np.asarray(ours(*where).dist[:, 0])
    assert (dist < 0).sum() == 8
    for count in (4, 64):  # the least and the most that the configuration allows
        slots = np.asarray(ours(*where, count).dist[:, 0])
        assert len(slots) == count
        assert (slots < 0).sum() == min(count, 8)
        assert np.sort(slots)[: min(count, 8)] == pytest.approx(np.sort(dist)[: min(count, 8)])


@pytest.mark.parametrize(
    "turn", [[0.002, 0.05, 0], [0, 0.05, 0.05], [-0.002, 0.06, -0.03], [0.02, 0.03, 0.1]]
)
def test_a_peg_that_tilts_over_the_rim_touches_with_two_edges(in_c, ours, turn):
    """The peg overhangs, its lowest edge hangs free, the plate has an edge in its face: one point."""
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, turned(turn))
    frame = frame.reshape(3, 3)
    edge = np.stack([np.full(6001, 0.06), np.linspace(-0.03, 0.03, 6001), np.zeros(6001)], axis=1)
    # As high over x = 7.2 cm as puts some of that edge up to 0.1 mm into the face.
    pos = np.array([0.072, 0.002, 0.0])
    at = (edge - pos) @ frame
    pos[2] = (PEG[2] - 1e-4 - at[np.abs(at[:, 1]) < 0.01, 2]).max() / -frame[2, 2]
    dist, *_, of_a_face, _ = found = placed(in_c, ours, pos, turn)
    require_as_in_c(*found)
    assert len(dist) == 1
    assert not of_a_face.any()
