"""From models/*.xml and shapes to compiled MuJoCo models with everything addressed by name.

The simulation scene holds one arm and one hole box on a mocap body, so that the hole's position is state. All
peg-hole pairs compile to models of the same layout, which differ in the places and sizes of boxes only:
a batch may mix them. A shape that needs fewer boxes than the layout has keeps the spare ones buried in its
own material, where nothing can touch them.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
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

_PEG_BIT, _HOLE_BIT = 1, 2
_SPARE_HALF_M = 0.001
_PLACED_ABOVE_FLOOR_M = 0.002


@dataclass(frozen=True)
class Scene:
    """The compiled models of the simulation scene.

    Attributes:
        models: One model for each pair; n_types² of them, in the order of ``pair_index``.
        config: What they were made from.
        robot: The arm in them.
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
    """Index of a pair's model in ``Scene.models``; works on ints and on arrays."""
    return peg_type * n_types + hole_type


def simulation_scene(config: SceneConfig) -> Scene:
    """The scene that is simulated: one arm, one peg, one hole box, all pairs."""
    n_peg = max(len(peg_boxes(shape, config).centre) for shape in config.shapes)
    n_hole = max(len(hole_boxes(shape, config).centre) for shape in config.shapes)
    models = []
    for peg, hole in product(config.shapes, config.shapes):
        spec = _arm_on_table(config)
        _add_peg(spec, config, _padded(peg_boxes(peg, config), n_peg))
        boxes = _padded(hole_boxes(hole, config), n_hole)
        _add_hole(spec, config, boxes, "hole", (0.5, 0.0), mocap=True)
        _strip_visual_geoms(spec)
        models.append(spec.compile())
    return Scene(tuple(models), config, ROBOTS[config.robot])


def picture_scene(
    config: SceneConfig, hole_types: Sequence[int], hole_pos_world: Float[np.ndarray, "n 2"]
) -> mujoco.MjModel:
    """The scene of a whole assembly, for pictures: nothing in it can touch.

    One arm and n hole boxes. In the hand is a peg of every shape, geoms ``hand_<shape>_<i>``, and in every
    hole another, geoms ``placed_<hole>_<shape>_<i>``; a picture colours and hides them.
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
    """Random places for hole boxes in the workspace, no two of which overlap.

    The workspace is the robot's, 10 cm wider on both sides in y for more than six boxes.

    Args:
        rng: Source of the draws.
        n_holes: Number of boxes, up to 8.
        config: Gives the size of a box.

    Returns:
        Centres, m.

    Raises:
        RequestError: So many boxes of this size do not fit.
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
        f"config: task.n_holes: {n_holes} cannot be used: boxes of scene.plate_half_width_m = "
        f"{config.plate_half_width_m} do not fit side by side in the workspace"
    )


def _arm_on_table(config: SceneConfig) -> mujoco.MjSpec:
    robot = ROBOTS[config.robot]
    spec = mujoco.MjSpec.from_file(str(resources.folder("models") / robot.mjcf))
    spec.body("peg").add_site(name=robot.tool_site, pos=[0, 0, config.peg_length_m], group=4)
    # MJX sizes its contact arrays by this and looks for it among the numerics.
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
    """A peg that stands in its hole, in the frame of the plate's upper face."""
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


def _strip_visual_geoms(spec: mujoco.MjSpec) -> None:
    """Takes away what is only to be looked at: an engine computes the place of every geom in every step."""
    seen = [geom for geom in spec.geoms if not geom.contype and not geom.conaffinity]
    for element in (*seen, *spec.lights, *spec.cameras):
        spec.delete(element)


def _contact(config: SceneConfig, contype: int, conaffinity: int) -> dict:
    return {
        "type": mujoco.mjtGeom.mjGEOM_BOX,
        "contype": contype,
        "conaffinity": conaffinity,
        "condim": 3,
        "density": 0,
        "friction": [config.friction, 0.005, 0.0001],
        "solref": [config.contact_time_s, 1.0],
        "solimp": [0.95, 0.99, config.contact_width_m, 0.5, 2.0],
    }


def _padded(boxes: Boxes, n: int) -> Boxes:
    """Fills up to n boxes with tiny ones inside the last real box."""
    spare = n - len(boxes.centre)
    centre = np.vstack([boxes.centre, np.repeat(boxes.centre[-1:], spare, 0)])
    half = np.vstack([boxes.half, np.repeat(np.minimum(boxes.half[-1:], _SPARE_HALF_M), spare, 0)])
    return Boxes(centre, half)
