"""Compilation of models/*.xml and parts to MuJoCo models whose elements are addressed by name.

The simulation scene contains one arm and one socket on a mocap body, so that the hole's position is part of
the state. All peg-hole pairs compile to models of the same layout that differ only in their geoms, so a batch
may mix them. Spare boxes of simpler parts are buried in their own material, where nothing can touch them.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np
from jaxtyping import Float

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.config.sections.shape import Shape
from mjx_fit.scene.contact_options import HOLE_BIT, PEG_BIT, add_pairs, contact_options, touching
from mjx_fit.scene.part_rules import require_possible
from mjx_fit.scene.parts import HANGING, plate_top_m
from mjx_fit.scene.pieces import Piece, Ring, padded, peg_pieces, socket_pieces
from mjx_fit.scene.robot import ROBOTS, Robot
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.rates import STEP_S

_PLACED_ABOVE_FLOOR_M = 0.002


@dataclass(frozen=True)
class Scene:
    """Compiled models of the simulation scene.

    Attributes:
        models: One model per peg-hole pair, n_types² in total, in the order of ``pair_index``.
        config: Configuration of the scene.
        robot: Robot in the models.
    """

    models: tuple[mujoco.MjModel, ...]
    config: SceneConfig
    robot: Robot

    @property
    def n_types(self) -> int:
        """Number of shapes, C."""
        return self.config.n_types

    @property
    def plate_top_m(self) -> float:
        return plate_top_m(self.config)


def pair_index(peg_type, hole_type, n_types: int):
    """Compute the index of a pair's model in ``Scene.models``, for ints or arrays."""
    return peg_type * n_types + hole_type


def simulation_scene(config: SceneConfig) -> Scene:
    """Compile the simulation scene, one arm, one peg and one socket, for all pairs."""
    for shape in config.shapes:
        require_possible(shape, config)
    pegs, holes = (padded(make, config) for make in (peg_pieces, socket_pieces))
    sides = (list(zip(config.shapes, pieces, strict=True)) for pieces in (pegs, holes))
    specs = [
        _pair_spec(touching(config, (peg_shape, hole_shape)), peg, hole)
        for (peg_shape, peg), (hole_shape, hole) in product(*sides)
    ]
    return Scene(_alike(specs), config, ROBOTS[config.robot])


def _pair_spec(config: SceneConfig, peg: list[Piece], hole: list[Piece]) -> mujoco.MjSpec:
    spec = _arm_on_table(config)
    spec.option.timestep = STEP_S / config.physics_steps
    _add_peg(spec, config, peg)
    _add_hole(spec, config, hole, "hole", (0.5, 0.0), mocap=True)
    _strip_visuals(spec)
    if config.slip_time_s is not None:
        add_pairs(spec, config, len(peg), len(hole))
    return spec


def _alike(specs: list[mujoco.MjSpec]) -> tuple[mujoco.MjModel, ...]:
    """Compile models whose simulations a batch may mix.

    Their state holds one flag for each node of all trees of bounding volumes, which have 2 n - 1 nodes for a
    mesh of n faces. Unused meshes add the nodes that a model lacks.
    """
    models = [spec.compile() for spec in specs]
    most = max(model.nbvh for model in models)
    for i, (spec, model) in enumerate(zip(specs, models, strict=True)):
        missing = most - model.nbvh
        if not missing:
            continue
        for number, nodes in enumerate((missing,) if missing % 2 else (1, missing - 1)):
            _add_unused_mesh(spec, f"unused_{number}", (nodes + 1) // 2)
        models[i] = spec.compile()
    return tuple(models)


def _add_unused_mesh(spec: mujoco.MjSpec, name: str, n_faces: int) -> None:
    faces = np.resize([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], (n_faces, 3))
    corners = np.vstack([np.zeros(3), np.eye(3)])
    mesh = spec.add_mesh(name=name, uservert=corners.ravel(), userface=faces.ravel())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL


def picture_scene(
    config: SceneConfig, hole_types: Sequence[int], hole_pos_world: Float[np.ndarray, "n 2"]
) -> mujoco.MjModel:
    """Compile the scene of a complete assembly for rendering, without any contacts.

    The scene has one arm and n sockets. A peg of every shape is in the hand, geoms ``hand_<shape>_<i>``, and
    in every hole, geoms ``placed_<hole>_<shape>_<i>``; the renderer colours and hides them.
    """
    spec = _arm_on_table(config)
    for shape in config.shapes:
        _add_picture_peg(spec, "peg", peg_pieces(shape, config), f"hand_{shape.name}")
    for i, (kind, position) in enumerate(zip(hole_types, hole_pos_world, strict=True)):
        _add_hole(spec, config, socket_pieces(config.shapes[kind], config), f"hole{i}", position, mocap=False)
        for shape in config.shapes:
            _add_picture_peg(spec, f"hole{i}", _placed(shape, config), f"placed_{i}_{shape.name}")
    return spec.compile()


def place_holes(rng: np.random.Generator, n_holes: int, config: SceneConfig) -> Float[np.ndarray, "n 2"]:
    """Draw random socket positions in the workspace without overlap.

    The workspace is the robot's, 10 cm wider on both sides in y for more than six sockets.

    Args:
        rng: Random generator.
        n_holes: Number of sockets, up to 8.
        config: Configuration with the robot and the size of a socket.

    Returns:
        Centres of the sockets, m.

    Raises:
        RequestError: The sockets do not fit into the workspace.
    """
    (x0, x1), (y0, y1) = ROBOTS[config.robot].workspace_m
    wider = 0.1 if n_holes > 6 else 0.0
    low, high = np.array([x0, y0 - wider]), np.array([x1, y1 + wider])
    side = 2 * config.plate_half_width_m
    for _ in range(1000):
        centres = np.empty((0, 2))
        for _ in range(100 * n_holes):
            candidate = rng.uniform(low, high)
            if np.all(np.abs(centres - candidate).max(1) >= side):
                centres = np.vstack([centres, candidate])
            if len(centres) == n_holes:
                return centres
    raise RequestError(
        f"config: task.n_holes: {n_holes} cannot be used: sockets of scene.plate_half_width_m = "
        f"{config.plate_half_width_m} do not fit side by side into the workspace"
    )


def _arm_on_table(config: SceneConfig) -> mujoco.MjSpec:
    robot = ROBOTS[config.robot]
    spec = mujoco.MjSpec.from_file(str(resources.folder("models") / robot.mjcf))
    spec.body("peg").add_site(name=robot.tool_site, pos=[0, 0, config.peg_length_m], group=4)
    # MJX reads the size of its contact arrays from this numeric.
    spec.add_numeric(name="max_contact_points", data=[config.max_contacts])
    return spec


def _add_peg(spec: mujoco.MjSpec, config: SceneConfig, pieces: list[Piece]) -> None:
    for i, piece in enumerate(pieces):
        look = {"material": "peg", **contact_options(config, PEG_BIT, HOLE_BIT)}
        add_piece(spec, "peg", f"peg_{i}", piece, look)


def _add_picture_peg(spec: mujoco.MjSpec, body: str, pieces: list[Piece], name: str) -> None:
    for i, piece in enumerate(pieces):
        add_piece(spec, body, f"{name}_{i}", piece, {"contype": 0, "conaffinity": 0})


def _placed(shape: Shape, config: SceneConfig) -> list[Piece]:
    """Return the pieces of a peg inserted in its hole, in the frame of the socket's upper face."""
    face_m = config.peg_length_m + _PLACED_ABOVE_FLOOR_M - config.hole_depth_m
    hanging = [
        [Ring(ring.corners[::-1] * HANGING[:2], face_m - ring.height_m) for ring in piece.rings[::-1]]
        for piece in peg_pieces(shape, config)
    ]
    return [Piece(tuple(rings)) for rings in hanging]


def _add_hole(
    spec: mujoco.MjSpec, config: SceneConfig, pieces: list[Piece], name: str, position, mocap: bool
) -> None:
    spec.worldbody.add_body(name=name, pos=[*position, plate_top_m(config)], mocap=mocap)
    for i, piece in enumerate(pieces):
        below = piece.rings[-1].height_m <= -config.hole_depth_m
        look = {"material": "floor" if below else "plate", **contact_options(config, HOLE_BIT, PEG_BIT)}
        add_piece(spec, name, f"{name}_{i}", piece, look)


def add_piece(spec: mujoco.MjSpec, body: str, name: str, piece: Piece, look: dict) -> None:
    """Add a piece to a body: as a box if it is one, or as the mesh of its convex hull."""
    if piece.box is not None:
        centre, half = piece.box
        spec.body(body).add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half, **look)
        return
    mesh = spec.add_mesh(name=name, uservert=piece.corners.ravel())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    spec.body(body).add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, **look)


def _strip_visuals(spec: mujoco.MjSpec) -> None:
    """Remove visual elements: engines compute the pose of every geom, and copy the model for each world."""
    seen = [geom for geom in spec.geoms if not geom.contype and not geom.conaffinity]
    for element in (*seen, *spec.lights, *spec.cameras, *spec.textures):
        spec.delete(element)
