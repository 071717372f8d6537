"""Gaps between peg and socket, against shapely's intersection of their sections and against dense points."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation
from shapely.affinity import affine_transform

import mjx_fit as mf
from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.config.sections.particles import ParticlesConfig
from mjx_fit.filters.contact_model import Pose, peg_pose, row_logp
from mjx_fit.filters.gaps import bearing_of
from mjx_fit.scene.outline import grown, hole_outline, inset, peg_outline
from mjx_fit.scene.surfaces import SPACING_M, surfaces_of
from mjx_fit.types import Rows

PARTS = {name: read_config(parts_file(name)).scene for name in ("nonconvex", "nist")}
SCENES = {"paper": mf.Config().scene, **PARTS}
THIS = np.array(0.0), np.array(0)  # the believed noise, and the attempt: this one


def of_part(scene, i):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf[i]), surfaces_of(scene))


@partial(jax.jit, static_argnums=4)
def gap_at(pose, row, peg, hole, _):
    return bearing_of(peg_pose(pose, row), peg, hole).gap


def drawn(rng):
    """A tool over a socket, both askew, with a peg askew in the hand; row, pose, and their matrices."""
    most_rad = {"tool": [0.1, 0.1, 0.2], "place": [0.05, 0.05, 0.2], "grasp": [0.05, 0.05, 0.05]}
    turns = {name: Rotation.from_rotvec(rng.uniform(-1, 1, 3) * most) for name, most in most_rad.items()}
    tip, place, grasp = (rng.uniform(-1, 1, 3) * np.array(most) for most in
                         ([0.02, 0.02, 0.005], [0.015, 0.015, 0.004], [0.002, 0.002, 0.002]))  # fmt: skip
    matrix = {name: turn.as_matrix() for name, turn in turns.items()}
    row = Rows(tip, matrix["tool"], np.array(5.0), np.zeros(2), np.array(1.0), *THIS)
    pose = Pose(place, matrix["place"], grasp, matrix["grasp"], np.array([0.0002]), np.array(1.0))
    return row, pose, matrix


def raised(row, pose, matrix):
    """The tool so high that the whole peg is above the plate, where gaps are vertical."""
    return replace(row, tip=row.tip + np.array([0, 0, 0.02])), pose, matrix


def peg_in_socket(row, pose, matrix):
    """Rotation and translation from the peg's axes to the socket's, by homogeneous matrices."""

    def rigid(turn, shift):
        whole = np.eye(4)
        whole[:3, :3], whole[:3, 3] = turn, shift
        return whole

    grasp = rigid(matrix["grasp"], pose.grasp)
    tool = rigid(matrix["tool"], row.tip + np.array([0, 0, pose.height_error[0]]))
    # The peg fits where the tool is at its place: the socket is the place times the grasp.
    return np.linalg.inv(rigid(matrix["place"], pose.place) @ grasp) @ tool @ grasp


@pytest.mark.parametrize(
    ("name", "peg", "hole"), [("paper", 0, 1), ("paper", 2, 2), ("nonconvex", 0, 3), ("nonconvex", 2, 1)]
)
def test_gaps_are_those_of_the_faces_outside_of_the_hole(name, peg, hole):
    scene, rng = SCENES[name], np.random.default_rng(peg)
    shapes = scene.shapes
    face, opening = peg_outline(shapes[peg], scene), hole_outline(shapes[hole], scene)
    for _ in range(25):
        row, pose, matrix = raised(*drawn(rng))
        t = peg_in_socket(row, pose, matrix)
        over = affine_transform(face, [t[0, 0], t[0, 1], t[1, 0], t[1, 1], t[0, 3], t[1, 3]]).difference(
            opening
        )
        corners = shapely.get_coordinates(over)
        local = np.linalg.solve(t[:2, :2], (corners - t[:2, 3]).T).T
        exact = (t[2, 3] + local @ t[2, :2]).min()
        found = float(gap_at(pose, row, of_part(scene, peg), of_part(scene, hole), name))
        slope = float(np.linalg.norm(t[2, :2]))
        # Crossings lie between points 4 mm apart, by the distance to the nearest side of a piece.
        assert found == pytest.approx(exact, abs=2e-6 + slope * 0.4 * SPACING_M)


def test_chamfers_let_a_peg_sink_as_dense_points_do():
    """NIST's parts, with chamfers on their sockets: heights of both surfaces on a fine grid, by shapely."""
    shapes = [replace(one, socket=replace(one.socket, chamfer_m=0.0004)) for one in SCENES["nist"].shapes]
    scene, rng = replace(SCENES["nist"], shapes=tuple(shapes)), np.random.default_rng(3)
    shape = scene.shapes[5]
    outer = peg_outline(shape, scene)
    inner, opening = inset(outer, shape.chamfer_m), hole_outline(shape, scene)
    mouth = grown(opening, shape.socket.chamfer_m)
    for _ in range(4):
        row, pose, matrix = drawn(rng)
        row = replace(row, tip=pose.place + rng.uniform(-0.002, 0.002, 3) + np.array([0, 0, 0.004]))
        t = peg_in_socket(row, pose, matrix)
        half = shape.half_width_m
        u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-half, half, 201)] * 2))
        points = np.asarray(shapely.points(u, v))
        keep = shapely.contains(outer, points)
        u, v, points = u[keep], v[keep], points[keep]
        rise = np.clip(shape.chamfer_m - shapely.distance(points, outer.boundary), 0, None)
        rise[shapely.contains(inner, points)] = 0
        x, y = (t[i, 3] + t[i, 0] * u + t[i, 1] * v for i in range(2))
        there = np.asarray(shapely.points(x, y))
        falls = np.where(shapely.contains(mouth, there), shapely.distance(there, mouth.boundary), 0)
        falls[shapely.contains(opening, there)] = 1
        exact = (t[2, 3] + t[2, 0] * u + t[2, 1] * v + rise + falls).min()
        found = float(gap_at(pose, row, of_part(scene, 5), of_part(scene, 5), "nist"))
        assert found == pytest.approx(exact, abs=3.5e-4)


@pytest.mark.parametrize("yaw", [0.0, 0.02])
def test_below_the_plate_the_way_to_the_wall_counts(yaw):
    """An upright square peg, deep in its hole or in the plate beside it: distances by shapely."""
    scene, rng = SCENES["paper"], np.random.default_rng(5)
    kind = next(i for i, shape in enumerate(scene.shapes) if shape.name == "square")
    shape, part = scene.shapes[kind], of_part(scene, kind)
    peg, opening = peg_outline(shape, scene), hole_outline(shape, scene)
    turn, level = Rotation.from_rotvec([0, 0, yaw]).as_matrix(), np.eye(3)
    pose = Pose(np.zeros(3), level, np.zeros(3), level, np.zeros(1), np.array(1.0))
    inside = 0
    for size in 30 * [0.001] + 10 * [0.004]:
        at = size * rng.uniform(-1, 1, 2)
        row = Rows(
            np.append(at, -0.005), turn, np.array(5.0), np.zeros(2), np.array(1.0), np.array(0.0), np.array(0)
        )
        corners = shapely.points(shapely.get_coordinates(peg) @ turn[:2, :2].T + at)
        wall = shapely.distance(corners, opening.boundary)
        free = shapely.contains(opening, corners)
        inside += free.all()
        # Beside the hole by more than it is deep in the plate, up is the shorter way out.
        exact = wall.min() if free.all() else max(-wall[~free].max(), -0.005)
        found = float(gap_at(pose, row, part, part, "paper"))
        # Beyond two sides at once, the distance to the further one counts, not to the corner.
        assert found == pytest.approx(exact, abs=1e-6 if free.all() else 0.3 * abs(exact) + 1e-6)
        assert (found > 0) == free.all()
    assert inside > 3
    far = Rows(
        np.array([0.03, 0.0, -0.005]),
        turn,
        np.array(5.0),
        np.zeros(2),
        np.array(1.0),
        np.array(0.0),
        np.array(0),
    )
    assert float(gap_at(pose, far, part, part, "paper")) == pytest.approx(-0.005, abs=1e-5)


def test_a_row_is_most_probable_where_the_peg_just_touches():
    scene, config = SCENES["paper"], ParticlesConfig()
    peg = hole = of_part(scene, 1)
    level = Pose(jnp.zeros(3), jnp.eye(3), jnp.zeros(3), jnp.eye(3), jnp.zeros(1), jnp.ones(()))

    def logp(height, press, pressure=(0.0, 0.0)):
        place, force = jnp.array([0.05, 0.0, height]), jnp.asarray(press)
        row = Rows(place, jnp.eye(3), force, jnp.array(pressure), jnp.ones(()), *THIS)
        return float(row_logp(level, row, peg, hole, config))

    touching = logp(0.0, 5.0)
    assert touching > logp(0.001, 5.0) + 2
    assert touching > logp(-0.001, 5.0) + 2
    assert logp(0.003, 0.0) > logp(-0.003, 0.0) + 2
    assert touching > logp(0.0, 5.0, (0.035, 0.0)) + 0.5
    assert logp(0.0, 1.0) == 0


def test_a_row_has_the_height_error_of_its_attempt():
    rng, peg = np.random.default_rng(2), of_part(SCENES["paper"], 1)
    row, pose, _ = drawn(rng)
    errors = np.array([0.0002, -0.0007, 0.0011])
    pose = pose._replace(height_error=errors)
    for k, error in enumerate(errors):
        moved = replace(row, tip=row.tip + np.array([0, 0, error]))
        exact = gap_at(pose._replace(height_error=np.zeros(1)), moved, peg, peg, "paper")
        got = gap_at(pose, replace(row, attempt=np.array(k)), peg, peg, "paper")
        assert float(got) == pytest.approx(float(exact), abs=1e-7)


def test_the_pressure_is_at_the_corner_that_touches_in_the_axes_of_the_tool():
    """A peg that is held off the axis, and tilted so that its corner at (u, v) is the lowest."""
    scene, config = SCENES["paper"], ParticlesConfig(pressure_std_m=0.001)
    peg = hole = of_part(scene, 2)
    corner, shift = np.array([0.015, 0.015]), np.array([0.006, -0.004, 0.0])
    grasp = Rotation.from_rotvec([0, 0, 0.3]).as_matrix()
    pose = Pose(
        jnp.array([0.1, 0.0, 0.0]),
        jnp.eye(3),
        jnp.asarray(shift),
        jnp.asarray(grasp),
        jnp.zeros(1),
        jnp.ones(()),
    )
    turn = jnp.asarray(Rotation.from_rotvec([-0.1, 0.1, 0]).as_matrix())

    @jax.jit
    def logp(pressure):
        row = Rows(
            jnp.array([0.0, 0.0, 0.003]),
            turn,
            jnp.asarray(5.0),
            pressure,
            jnp.ones(()),
            jnp.zeros(()),
            jnp.array(0),
        )
        return row_logp(pose, row, peg, hole, config)

    axis = np.linspace(-0.03, 0.03, 61)
    places = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    best = places[np.argmax(jax.vmap(logp)(jnp.asarray(places)))]
    np.testing.assert_allclose(best, grasp[:2, :2] @ corner + shift[:2], atol=0.0021)
