"""Compilation of models/*.xml and shapes to MuJoCo models whose elements are addressed by name.

The simulation scene contains one arm and one socket on a mocap body, so that the hole's position is part of
the state. All peg-hole pairs compile to models of the same layout that differ only in positions and sizes of
boxes, so a batch may mix them. Spare boxes of simpler shapes are buried in their own material, where nothing
can touch them.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np
from jaxtyping import Float

from mjx_fit.config.sections.shape import Shape
from mjx_fit.config.sections.world import SceneConfig
from mjx_fit.scene.parts import HANGING, Boxes, hole_boxes, peg_boxes, plate_top_m
from mjx_fit.scene.robot import ROBOTS, Robot
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError

MakeBoxes = Callable[[Shape, SceneConfig, float], Boxes]
_PEG_BIT, _HOLE_BIT = 1, 2
_SPARE_HALF_M = 0.001
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
    models = []
    for peg, hole in product(padded_boxes(peg_boxes, config), padded_boxes(hole_boxes, config)):
        spec = _arm_on_table(config)
        _add_peg(spec, config, peg)
        _add_hole(spec, config, hole, "hole", (0.5, 0.0), mocap=True)
        _strip_visuals(spec)
        if config.slip_time_s is not None:
            _add_pairs(spec, config, len(peg.centre), len(hole.centre))
        models.append(spec.compile())
    return Scene(tuple(models), config, ROBOTS[config.robot])


def picture_scene(
    config: SceneConfig, hole_types: Sequence[int], hole_pos_world: Float[np.ndarray, "n 2"]
) -> mujoco.MjModel:
    """Compile the scene of a complete assembly for rendering, without any contacts.

    The scene has one arm and n sockets. A peg of every shape is in the hand, geoms ``hand_<shape>_<i>``, and
    in every hole, geoms ``placed_<hole>_<shape>_<i>``; the renderer colours and hides them.
    """
    spec = _arm_on_table(config)
    for shape in config.shapes:
        _add_picture_peg(spec.body("peg"), peg_boxes(shape, config), f"hand_{shape.name}")
    for i, (kind, position) in enumerate(zip(hole_types, hole_pos_world, strict=True)):
        _add_hole(spec, config, hole_boxes(config.shapes[kind], config), f"hole{i}", position, mocap=False)
        for shape in config.shapes:
            _add_picture_peg(spec.body(f"hole{i}"), _placed(shape, config), f"placed_{i}_{shape.name}")
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


def _add_peg(spec: mujoco.MjSpec, config: SceneConfig, boxes: Boxes) -> None:
    for i, (centre, half) in enumerate(zip(boxes.centre, boxes.half, strict=True)):
        spec.body("peg").add_geom(
            name=f"peg_box{i}", pos=centre, size=half, material="peg", **_contact(config, _PEG_BIT, _HOLE_BIT)
        )


def _add_picture_peg(body: mujoco.MjsBody, boxes: Boxes, name: str) -> None:
    for i, (centre, half) in enumerate(zip(boxes.centre, boxes.half, strict=True)):
        body.add_geom(
            name=f"{name}_{i}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=centre,
            size=half,
            contype=0,
            conaffinity=0,
        )


def _placed(shape: Shape, config: SceneConfig) -> Boxes:
    """Return the boxes of a peg inserted in its hole, in the frame of the socket's upper face."""
    boxes = peg_boxes(shape, config)
    face_m = config.peg_length_m + _PLACED_ABOVE_FLOOR_M - config.hole_depth_m
    return Boxes(boxes.centre * HANGING + [0, 0, face_m], boxes.half)


def _add_hole(
    spec: mujoco.MjSpec, config: SceneConfig, boxes: Boxes, name: str, position, mocap: bool
) -> None:
    body = spec.worldbody.add_body(name=name, pos=[*position, plate_top_m(config)], mocap=mocap)
    for i, (centre, half) in enumerate(zip(boxes.centre, boxes.half, strict=True)):
        material = "floor" if i == 0 else "plate"
        body.add_geom(
            name=f"{name}_box{i}",
            pos=centre,
            size=half,
            material=material,
            **_contact(config, _HOLE_BIT, _PEG_BIT),
        )


def _strip_visuals(spec: mujoco.MjSpec) -> None:
    """Remove visual elements: engines compute the pose of every geom, and copy the model for each world."""
    seen = [geom for geom in spec.geoms if not geom.contype and not geom.conaffinity]
    for element in (*seen, *spec.lights, *spec.cameras, *spec.textures):
        spec.delete(element)


def _contact(config: SceneConfig, contype: int, conaffinity: int) -> dict:
    return {
        "type": mujoco.mjtGeom.mjGEOM_BOX,
        "contype": contype,
        "conaffinity": conaffinity,
        "condim": 3,
        "density": 0,
        "friction": [config.friction, 0.005, 0.0001],
        "solref": [config.contact_time_s, config.contact_damping],
        "solimp": [
            config.contact_impedance,
            config.deep_impedance,
            config.contact_width_m,
            0.5,
            2.0,
        ],
    }


def _add_pairs(spec: mujoco.MjSpec, config: SceneConfig, n_peg: int, n_hole: int) -> None:
    """Add all pairs of boxes explicitly: MuJoCo stores the time constant of friction with a pair only."""
    of_box = _contact(config, _PEG_BIT, _HOLE_BIT)
    slide, spin, roll = of_box["friction"]
    for i, j in product(range(n_peg), range(n_hole)):
        spec.add_pair(
            geomname1=f"peg_box{i}",
            geomname2=f"hole_box{j}",
            condim=of_box["condim"],
            friction=[slide, slide, spin, roll, roll],
            solref=of_box["solref"],
            solimp=of_box["solimp"],
            solreffriction=[config.slip_time_s, 1.0],
        )


def padded_boxes(make: MakeBoxes, config: SceneConfig, scale: float = 1.0) -> list[Boxes]:
    """Create the boxes of all pegs, or of all sockets, padded to the same number.

    Args:
        make: ``peg_boxes`` or ``hole_boxes``.
        config: Configuration of the scene.
        scale: Factor of the cross-sections.
    """
    boxes = [make(shape, config, scale) for shape in config.shapes]
    n = max(len(one.centre) for one in boxes)
    return [_padded(one, n) for one in boxes]


def _padded(boxes: Boxes, n: int) -> Boxes:
    """Pad to n boxes with tiny ones inside the last real box."""
    spare = n - len(boxes.centre)
    centre = np.vstack([boxes.centre, np.repeat(boxes.centre[-1:], spare, 0)])
    half = np.vstack([boxes.half, np.repeat(np.minimum(boxes.half[-1:], _SPARE_HALF_M), spare, 0)])
    return Boxes(centre, half)
