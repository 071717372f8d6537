"""Contact of extruded outlines against C MuJoCo's contact of their convex pieces."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjx_fit.config.sections.cross_section import Circle, CrossSection, Polygon, Rectangle, Star
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import SHAPES, Shape
from mjx_fit.config.sections.shape import Socket as SocketConfig
from mjx_fit.engines.mjx import outlines
from mjx_fit.engines.mjx.outline_contact import touching_points
from mjx_fit.engines.mjx.prisms import MOST_OF_A_KIND
from mjx_fit.scene.build import add_piece
from mjx_fit.scene.outline import hole_outline, peg_outline
from mjx_fit.scene.pieces import peg_pieces, socket_pieces

SCENE = SceneConfig()
N, COUNT = 200, 64
CROSS, _, SQUARE = SHAPES
HEXAGON = Shape("hexagon", section=CrossSection(polygon=Polygon(6, 0.02)), clearance_m=0.0005)
ROUND = Shape("round", section=CrossSection(circle=Circle(0.008)), clearance_m=0.0001)
NOSE = Shape(
    "nose", section=CrossSection(rectangle=Rectangle((0.012, 0.0045))), clearance_m=0.0001, chamfer_m=0.0005
)
PIN = Shape("pin", section=CrossSection(circle=Circle(0.008)), clearance_m=0.0001, chamfer_m=0.0005)
BLOCK = Shape(
    "block", section=CrossSection(rectangle=Rectangle((0.012, 0.008))), clearance_m=0.0001, chamfer_m=0.0005
)
MOUTH = Shape(
    "mouth",
    section=CrossSection(polygon=Polygon(6, 0.02)),
    clearance_m=0.0005,
    socket=SocketConfig(chamfer_m=0.001),
)
BOTH = Shape(
    "both",
    section=CrossSection(rectangle=Rectangle((0.012, 0.0045))),
    clearance_m=0.0002,
    chamfer_m=0.0005,
    socket=SocketConfig(chamfer_m=0.001),
)
STAR = Shape("star", section=CrossSection(star=Star(5, 0.03, 0.016)), clearance_m=0.0002, chamfer_m=0.001)
TURNED = Shape("turned", section=CrossSection(rectangle=Rectangle((0.02, 0.012)), turn_deg=25.0))


def in_c(shape, tips, turns, hole=None):
    """Contacts of the convex pieces of a peg and its own or another hole: distances and positions."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="peg").add_freejoint()
    spec.worldbody.add_body(name="hole")
    for body, pieces, bits in (("peg", peg_pieces, (1, 2)), ("hole", socket_pieces, (2, 1))):
        for i, piece in enumerate(pieces(shape if body == "peg" else hole or shape, SCENE)):
            add_piece(
                spec, body, f"{body}_{i}", piece, dict(zip(("contype", "conaffinity"), bits, strict=True))
            )
    model = spec.compile()
    data, found = mujoco.MjData(model), []
    for tip, turn in zip(tips, turns, strict=True):
        frame = framed(turn)
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, frame.ravel())
        data.qpos[:] = [*(tip - frame[:, 2] * SCENE.peg_length_m), *quat]
        mujoco.mj_forward(model, data)
        touching = data.contact.dist < 0
        found.append((data.contact.dist[touching].copy(), data.contact.pos[touching].copy()))
    return found


def framed(turn):
    """Straight down, as the tool is, and then turned by a rotation vector: a rotation matrix."""
    quat, angle = np.zeros(4), np.linalg.norm(turn)
    mujoco.mju_axisAngle2Quat(quat, turn / max(angle, 1e-12), angle)
    mujoco.mju_mulQuat(quat, quat, np.array([0.0, 1, 0, 0]))
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, quat)
    return frame.reshape(3, 3)


def ours(shape, tips, turns, count=COUNT, hole=None):
    """Contacts of the outlines: distances (n, count), positions and normals (n, count, 3)."""
    hole = hole or shape
    n, frames = len(tips), np.stack([framed(turn) for turn in turns])

    def everywhere(x):
        return jnp.broadcast_to(jnp.asarray(x, jnp.float32)[..., None], (*np.shape(x), n))

    peg = jax.tree.map(everywhere, outlines.peg_of(shape, SCENE))
    socket = jax.tree.map(everywhere, outlines.socket_of(hole, SCENE))
    if not shape.chamfer_m:
        peg = peg._replace(tip=None)
    if not hole.socket.chamfer_m:
        socket = socket._replace(mouth=None)
    pos = jnp.asarray((tips - frames[..., 2] * SCENE.peg_length_m).T, jnp.float32)
    found = jax.jit(lambda at, frame: touching_points(peg, socket, at, frame, count))(
        pos, jnp.asarray(np.moveaxis(frames, 0, -1), jnp.float32)
    )
    return (
        np.asarray(found.dist).T,
        np.moveaxis(np.asarray(found.pos_plate), -1, 0),
        np.moveaxis(np.asarray(found.frame)[:, 0], -1, 0),
    )


def pressed(reach, seed=0):
    """Tips pressed on the plate and its rim by up to 0.1 mm, tilted by hundredths of a degree."""
    rng = np.random.default_rng(seed)
    tips = np.column_stack([rng.uniform(-2 * reach, 2 * reach, (N, 2)), -rng.uniform(1e-5, 1e-4, N)])
    return tips, rng.normal(0, 3e-4, (N, 3))


def inserted(gap, seed=1):
    """Tips in the hole that lean against its walls, some of them on the floor."""
    rng = np.random.default_rng(seed)
    angle, off, height = (
        rng.uniform(0, 2 * np.pi, N),
        gap * rng.uniform(0.8, 1.15, N),
        -rng.uniform(0.003, 0.02, N),
    )
    height[::5] = -SCENE.hole_depth_m - rng.uniform(0, 5e-5, len(height[::5]))
    turns = rng.normal(0, min(2 * gap, 2e-3), (N, 3)) * [1, 1, 0.3]
    return np.column_stack([off * np.cos(angle), off * np.sin(angle), height]), turns


def entering(gap, chamfer, seed=3):
    """Tips within a chamfer of the rim, off to a side by as much as it lets them in."""
    rng = np.random.default_rng(seed)
    angle, height = rng.uniform(0, 2 * np.pi, N), rng.uniform(0, 1.2 * chamfer, N)
    off = np.maximum(gap + chamfer - height, gap) + rng.uniform(-1, 1, N) * 5e-5
    return np.column_stack([off * np.cos(angle), off * np.sin(angle), -height]), rng.normal(0, 3e-4, (N, 3))


def deepest(found):
    return np.array([-dist.min() if len(dist) else 0.0 for dist, _ in found])


@pytest.mark.parametrize(
    ("shape", "tolerance"), [(SQUARE, 1e-7), (CROSS, 1e-7), (TURNED, 2e-6), (HEXAGON, 5e-6), (ROUND, 2e-6)]
)
def test_a_pressed_peg_is_as_deep_as_in_c(shape, tolerance):
    tips, turns = pressed(shape.half_width_m)
    dist, *_ = ours(shape, tips, turns)
    depth, there = np.maximum(-dist.min(1), 0), deepest(in_c(shape, tips, turns))
    assert (there > 0).mean() > 0.5
    assert abs(depth - there).max() < tolerance


@pytest.mark.parametrize(
    ("shape", "gap", "tolerance"),
    [(SQUARE, 1e-3, 2e-7), (CROSS, 1e-3, 2e-7), (HEXAGON, 5e-4, 2e-5), (ROUND, 1e-4, 5e-6)],
)
def test_a_peg_in_its_hole_is_as_deep_as_in_c(shape, gap, tolerance):
    tips, turns = inserted(gap)
    dist, *_ = ours(shape, tips, turns)
    depth, there = np.maximum(-dist.min(1), 0), deepest(in_c(shape, tips, turns))
    assert 0.2 < (there > 0).mean() < 0.95
    assert abs(depth - there).max() < tolerance
    assert np.quantile(abs(depth - there), 0.9) < 1e-6


@pytest.mark.parametrize(
    ("shape", "gap", "chamfer", "tolerance"),
    [
        (NOSE, 1e-4, 5e-4, 5e-7),
        (PIN, 1e-4, 5e-4, 5e-6),
        (MOUTH, 5e-4, 1e-3, 1e-8),
        (BOTH, 2e-4, 1.5e-3, 1e-6),
        (STAR, 2e-4, 1e-3, 1e-6),
    ],
)
def test_a_chamfer_slides_as_deep_as_in_c(shape, gap, chamfer, tolerance):
    tips, turns = entering(gap, chamfer)
    dist, _, normal = ours(shape, tips, turns)
    depth, there = np.maximum(-dist.min(1), 0), deepest(in_c(shape, tips, turns))
    assert 0.1 < (there > 0).mean() < 0.9
    assert abs(depth - there).max() < tolerance
    deepest_normal = normal[np.arange(N), dist.argmin(1), 2][depth > 1e-6]
    assert (abs(deepest_normal + 0.5**0.5) < 0.01).mean() > 0.5


def test_the_corner_of_a_chamfer_on_the_rim_of_another_hole_is_as_deep_as_in_c():
    """A chamfered rectangle whose corner is inside of a round hole at its tip, and outside above it."""
    rng = np.random.default_rng(5)
    hole = Shape("round", section=CrossSection(circle=Circle(0.016)), clearance_m=0.0001)
    tip_corner = np.array([0.006, 0.004]) - BLOCK.chamfer_m
    angle = np.arctan2(*tip_corner[::-1]) + rng.uniform(-0.2, 0.2, N)
    # The corner's edge leads out by √2 of its height; it is in the rim by up to 50 µm.
    deep = rng.uniform(6e-5, 3e-4, N)
    out = 0.0081 - np.sqrt(2) * deep + rng.uniform(0, 5e-5, N)
    tips = np.column_stack([out * np.cos(angle), out * np.sin(angle)]) - tip_corner
    tips = np.column_stack([tips, -deep])
    turns = rng.normal(0, 3e-4, (N, 3))
    c = deepest(in_c(BLOCK, tips, turns, hole))
    dist, _, normal = ours(BLOCK, tips, turns, hole=hole)
    alone = (c > 5e-6) & (c < 5e-5)
    assert alone.sum() > 100
    np.testing.assert_allclose(-dist.min(1, initial=0.0)[alone], c[alone], atol=1e-6)
    # Edges between two faces at 45° rise along (1, ±1, 1), but for the tilt; a few states rest on the other.
    held = normal[np.arange(N), dist.argmin(1)][alone]
    assert abs(held @ np.array([[1, 1], [1, -1], [1, 1]])).min(1).max() < 2e-3


def test_a_pressed_peg_stands_on_the_points_that_c_finds():
    """Every extreme point of C's contact is there: the peg does not tip where it stands in C.

    C has fewer in places: two boxes that overlap by 22 by 5 mm can touch with a pair of edges alone.
    """
    tips, turns = pressed(0.02, seed=2)
    dist, pos, _ = ours(CROSS, tips, turns)
    for mine, places, (theirs, points) in zip(dist, pos, in_c(CROSS, tips, turns), strict=True):
        for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False) if len(theirs) else ():
            way = np.array([np.cos(angle), np.sin(angle)])
            surely = (points[theirs < -1e-6, :2] @ way).max(initial=-1)
            assert surely - 2e-5 < (places[mine < 0, :2] @ way).max()


def test_normals_are_unit_vectors_and_frames_right_handed():
    for tips, turns in (pressed(0.004), inserted(1e-4)):
        dist, _, normal = ours(ROUND, tips, turns)
        assert np.linalg.norm(normal[dist < 0], axis=-1) == pytest.approx(1, abs=1e-5)


def test_many_corners_are_thinned_and_slots_stay_enough():
    """A round face on the plate: at most as many points of a kind as are kept, all around its edge."""
    tips, turns = np.array([[0.03, 0.0, -5e-5]]), np.zeros((1, 3))
    dist, pos, _ = ours(ROUND, tips, turns)
    points = pos[0, dist[0] < 0, :2] - tips[0, :2]
    assert 8 <= len(points) <= MOST_OF_A_KIND
    angle = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    assert np.diff(np.append(angle, angle[0] + 2 * np.pi)).max() < 0.6
    few, *_ = ours(ROUND, tips, turns, count=4)
    assert (few < 0).sum() == 4


def test_a_peg_beside_the_hole_rests_on_the_plate_however_close_the_wall_is():
    """Its lower side is 4 µm from the hole's rim and 0.1 mm deep: only the way up frees the peg."""
    beside = Shape("beside", section=CrossSection(rectangle=Rectangle((0.02, 0.012))), clearance_m=0.0002)
    tips = np.array([[0.0202 + 4e-6, 0.0, -5e-5]])
    dist, _, normal = ours(beside, tips, np.array([[0.0, -0.005, 0.0]]))
    np.testing.assert_allclose(normal[0, dist[0] < 0][:, 2], -1, atol=1e-3)
    assert -dist.min() == pytest.approx(1e-4, rel=0.1)


ACUTE = Shape("acute", section=CrossSection(polygon=Polygon(3, 0.014)), clearance_m=0.0002)
PLUG = Shape(
    "plug", section=CrossSection(rectangle=Rectangle((0.012, 0.0045))), clearance_m=0.0001, chamfer_m=0.0005
)
PRONGS = Shape(
    "prongs",
    section=CrossSection(
        union=(
            CrossSection(rectangle=Rectangle((0.006, 0.014)), at_m=(-0.008, 0.0)),
            CrossSection(rectangle=Rectangle((0.006, 0.014)), at_m=(0.008, 0.0)),
        )
    ),
    clearance_m=0.0002,
)


def cornered(shape, seed=4):
    """Tips in the hole, in corners of the hole: both walls are touched by 0.1 to 2 µm."""
    rng = np.random.default_rng(seed)
    hole = hole_outline(shape, SCENE)
    corners = np.concatenate([np.asarray(polygon.exterior.coords)[:-1] for polygon in hole.geoms])
    pegs = np.concatenate(
        [np.asarray(polygon.exterior.coords)[:-1] for polygon in peg_outline(shape, SCENE).geoms]
    )
    which = rng.integers(len(corners), size=N)
    nearest = np.linalg.norm(corners[which][:, None] - pegs, axis=-1).argmin(1)
    way = corners[which] - pegs[nearest]
    off = way * (1 + rng.uniform(1e-7, 2e-6, (N, 1)) / np.linalg.norm(way, axis=1, keepdims=True))
    return np.column_stack([off, -rng.uniform(0.0008, 0.02, N)]), np.zeros((N, 3))


@pytest.mark.parametrize("shape", [ACUTE, HEXAGON, SQUARE, TURNED, PRONGS, PLUG, BOTH])
def test_a_peg_in_a_corner_of_its_hole_touches_both_walls_and_nothing_else(shape):
    """The corner of the rim is then inside the peg, whose tip may be far below."""
    tips, turns = cornered(shape)
    dist, _, normal = ours(shape, tips, turns)
    assert (dist < 0).any(1).mean() > 0.9
    assert -dist.min() < 5e-6
    assert abs(normal[dist < 0][:, 2]).max() < 1e-3


def test_a_side_that_crosses_two_walls_is_held_by_the_wall_that_it_is_in():
    """The peg lies on one wall, and its corner is 1 µm in another, 20 µm below the rim."""
    tips, turns = np.array([[0.002038, -0.000201, -1.07e-5]]), np.array([[0.0, 6.5e-4, 0.0]])
    dist, *_ = ours(ACUTE, tips, turns)
    in_c_too = in_c(ACUTE, tips, turns)
    assert -dist.min() == pytest.approx(deepest(in_c_too)[0], abs=1e-6)


TOUCHING = jax.jit(touching_points, static_argnums=4)
CORNERS, STATES = 7, 64


@st.composite
def jagged(draw):
    """Star-shaped paths of seven corners, in m."""
    turns = np.cumsum(draw(st.lists(st.floats(0.5, 1.0), min_size=CORNERS, max_size=CORNERS)))
    radii = np.array(draw(st.lists(st.floats(0.005, 0.011), min_size=CORNERS, max_size=CORNERS)))
    angle = 2 * np.pi * turns / turns[-1]
    return np.column_stack([radii * np.cos(angle), radii * np.sin(angle)])


def pushes(corners, turn_deg, tips, turns):
    """Sum of depths, of forces (depth times normal), and of torques about the world's origin, by state."""
    path = tuple(map(tuple, corners.tolist()))
    shape = Shape("one", section=CrossSection(path=path, turn_deg=turn_deg), clearance_m=0.0003)
    frames = np.stack([framed(turn) for turn in turns])
    parts = [
        jax.tree.map(
            lambda x: jnp.broadcast_to(jnp.asarray(x, jnp.float32)[..., None], (*np.shape(x), STATES)),
            make(shape, SCENE)._replace(**{which: None}),
        )
        for make, which in ((outlines.peg_of, "tip"), (outlines.socket_of, "mouth"))
    ]
    pos = jnp.asarray((tips - frames[..., 2] * SCENE.peg_length_m).T, jnp.float32)
    found = TOUCHING(*parts, pos, jnp.asarray(np.moveaxis(frames, 0, -1), jnp.float32), 96)
    depth = np.maximum(-np.asarray(found.dist, float), 0)[:, None]
    force = depth * np.asarray(found.frame, float)[:, 0]
    torque = np.cross(np.asarray(found.pos_plate, float), force, axis=1)
    return depth.sum(0)[0], force.sum(0).T, torque.sum(0).T


def agree(one, other):
    """All but few states: where two ways out are equally far, rounding decides."""
    limits = (2e-6, 2e-6, 1e-7)
    close = [
        abs(a - b).reshape(STATES, -1).max(1) < most for a, b, most in zip(one, other, limits, strict=True)
    ]
    assert np.all(close, axis=0).mean() > 0.95


@settings(deadline=None, max_examples=15)
@given(jagged(), st.floats(-180, 180), st.booleans())
def test_turning_a_part_turns_its_contacts_and_mirroring_it_mirrors_them(corners, degrees, deep):
    """A mirror reverses rotation vectors and torques, but for their parts across it."""
    tips, turns = inserted(3e-4) if deep else pressed(0.01)
    tips, turns = tips[:STATES], turns[:STATES]
    depth, force, torque = pushes(corners, 0.0, tips, turns)
    assert (depth > 0).any()
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    agree(
        pushes(corners, degrees, tips @ turned.T, turns @ turned.T),
        (depth, force @ turned.T, torque @ turned.T),
    )
    mirror = np.array([1.0, -1.0, 1.0])
    agree(
        pushes(corners[::-1] * mirror[:2], 0.0, tips * mirror, -turns * mirror),
        (depth, force * mirror, -torque * mirror),
    )
