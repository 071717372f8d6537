"""Robot, pegs and sockets in the pose of a moment, with the belief as marks above the holes."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import re
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

from mjx_fit.control.kinematics import chain_of, inverse
from mjx_fit.evaluation.recording import Recording, Step
from mjx_fit.filters.kalman import scale_tril
from mjx_fit.scene.build import picture_scene
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.robot import ROBOTS
from mjx_fit.task.assembly_snapshot import EMPTY
from mjx_fit.utils.type_colours import TYPE_RGB
from mjx_fit.viz.timeline import Moment

UNSURE_RGB = (0.93, 0.93, 0.90)
RADIUS_90 = float(np.sqrt(4.605))
"""Radius of the 90 % region of a planar Gaussian, in standard deviations."""

_OVER_PLATE_M, _THICK_M, _DOT_M = 0.0015, 0.0006, 0.0018
_ALPHA = 0.62


@dataclass(frozen=True)
class Mark:
    """Geometry to add to the scene.

    Attributes:
        kind: Member of ``mujoco.mjtGeom``.
        size: MuJoCo size parameters of the kind, m.
        centre_world: Position of the centre, m.
        frame_world: Orientation, as a rotation matrix.
        rgba: Colour.
    """

    kind: Any
    size: Float[np.ndarray, "3"]
    centre_world: Float[np.ndarray, "3"]
    frame_world: Float[np.ndarray, "3 3"]
    rgba: tuple[float, float, float, float]


class Puppet:
    """Scene of one recording.

    Attributes:
        model: MuJoCo model without collisions.
        data: Its state.
    """

    def __init__(self, recording: Recording):
        self._recording = recording
        config = recording.config.scene
        self.model = picture_scene(config, recording.hole_type.tolist(), recording.hole_pos_world)
        self.data = mujoco.MjData(self.model)
        chain = chain_of(self.model, ROBOTS[config.robot])
        self._inverse = jax.jit(jax.vmap(lambda tip: inverse(chain, tip)))
        self._top = plate_top_m(config)
        holes = range(len(recording.hole_type))
        self._hand = self._pegs("hand")
        self._placed = [self._pegs(f"placed_{hole}") for hole in holes]
        for pegs in (self._hand, *self._placed):
            for kind, geoms in enumerate(pegs):
                self.model.geom_rgba[geoms, :3] = TYPE_RGB[kind]

    def postures(self, tips: Float[np.ndarray, "f 3"]) -> Float[np.ndarray, "f joints"]:
        """Return the joint angles (rad) that place the end effector at each position."""
        return np.asarray(self._inverse(jnp.asarray(tips, jnp.float32)))

    def pose(self, moment: Moment, step: Step, qpos: Float[np.ndarray, "joints"]) -> None:
        """Set the posture of the arm, and show the pegs that are present.

        Args:
            moment: Moment to show.
            step: Step that it belongs to.
            qpos: Joint angles, rad.
        """
        peg_type = self._recording.peg_type[step.peg]
        self.data.qpos[: len(qpos)] = qpos
        self._show(self._hand, peg_type if moment.holding else EMPTY)
        for kind, pegs in zip(moment.content, self._placed, strict=True):
            self._show(pegs, kind)
        mujoco.mj_forward(self.model, self.data)

    def marks(self, moment: Moment) -> list[Mark]:
        """Return a thin disc, the 90 % region of its position, and the mean position of each empty hole."""
        marks: list[Mark] = []
        for hole in np.flatnonzero(~moment.filled):
            belief = jax.tree.map(lambda leaf, hole=hole: np.asarray(leaf)[hole], moment.belief)
            axes, stretch, _ = np.linalg.svd(np.asarray(scale_tril(jnp.asarray(belief.pos_cov))))
            frame = np.eye(3)
            frame[:2, :2] = axes * [1, np.sign(np.linalg.det(axes))]
            centre = np.array([*belief.pos_mean_world, self._top + _OVER_PLATE_M])
            size = np.maximum([*(RADIUS_90 * stretch), _THICK_M], _THICK_M)
            colour = mixed(np.exp(belief.type_logp))
            ellipsoid, cylinder = mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_CYLINDER
            marks.append(Mark(ellipsoid, size, centre, frame, (*colour, _ALPHA)))
            dot = np.array([_DOT_M, 2 * _THICK_M, 0])
            marks.append(Mark(cylinder, dot, centre, np.eye(3), (0.1, 0.1, 0.1, 1.0)))
        return marks

    def _show(self, pegs: list[list[int]], kind: int) -> None:
        """Show the peg of one type only."""
        for i, geoms in enumerate(pegs):
            self.model.geom_rgba[geoms, 3] = float(i == kind)

    def _pegs(self, place: str) -> list[list[int]]:
        """Return the geoms of the peg of each type at a place."""
        return [self._geoms(f"{place}_{name}_") for name in self._recording.config.scene.names]

    def _geoms(self, prefix: str) -> list[int]:
        mine = re.compile(re.escape(prefix) + r"\d+")  # a name may be a prefix of another
        return [i for i in range(self.model.ngeom) if mine.fullmatch(self.model.geom(i).name)]


def add(scene: mujoco.MjvScene, marks: list[Mark]) -> None:
    """Add marks to a MuJoCo scene."""
    for mark in marks:
        geom = scene.geoms[scene.ngeom]
        rgba = np.array(mark.rgba, np.float32)
        mujoco.mjv_initGeom(geom, mark.kind, mark.size, mark.centre_world, mark.frame_world.ravel(), rgba)
        scene.ngeom += 1


def mixed(chance: Float[np.ndarray, "C"]) -> tuple[float, float, float]:
    """Return the colour of a type belief: pale if uniform, the colour of the type if certain."""
    likely, even = int(np.argmax(chance)), 1 / len(chance)
    sure = (chance[likely] / chance.sum() - even) / (1 - even) if len(chance) > 1 else 1.0
    r, g, b = (1 - sure) * np.array(UNSURE_RGB) + sure * np.array(TYPE_RGB[likely])
    return float(r), float(g), float(b)
