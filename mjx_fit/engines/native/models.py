"""Models of worlds with physics of their own, for MuJoCo's C engine."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import copy
from functools import cached_property

import mujoco
import numpy as np
from jaxlie import SE3
from jaxtyping import Float, Int

from mjx_fit.scene.build import Scene
from mjx_fit.scene.variation import CONTACT, Slope, longest_contact_times, offsets, slopes
from mjx_fit.types.physics import Physics


class Models:
    """Models of any batch of worlds.

    Attributes:
        scene: Scene of the worlds.
    """

    def __init__(self, scene: Scene):
        self.scene = scene

    @cached_property
    def _slopes(self) -> dict[str, Slope]:
        return slopes(self.scene)

    @cached_property
    def _longest(self) -> Float[np.ndarray, "pairs"]:
        return longest_contact_times(self.scene.config)

    def of(
        self, pair: Int[np.ndarray, "n"], physics: Physics, peg_hand: SE3 | None = None
    ) -> list[mujoco.MjModel]:
        """Return one model per world; worlds without contact or geometry of their own share the scene's.

        Args:
            pair: Index of each world's pair of peg and hole.
            physics: Quantities of the worlds, (n,).
            peg_hand: Poses of the pegs in the frame of the hand, (n,); None: straight.
        """
        contact = {name: getattr(physics, name) for name in CONTACT}
        contact = {name: np.asarray(value, float) for name, value in contact.items() if value is not None}
        moved = {name: np.asarray(by, float) for name, by in offsets(self.scene, physics).items()}
        if not contact and not moved and peg_hand is None:
            return [self.scene.models[i] for i in pair]
        models = []
        for row, i in enumerate(pair):
            model = copy.copy(self.scene.models[i])
            own = {name: float(value[row]) for name, value in contact.items()}
            if "contact_time_s" in own:
                own["contact_time_s"] = min(own["contact_time_s"], float(self._longest[i]))
            _touch(model, own)
            for name, by in moved.items():
                slope = self._slopes[name]
                model.geom_pos[:] += by[row] * slope.pos[i]
                model.geom_size[:] += by[row] * slope.size[i]
            if moved:
                _bound(model)
            if peg_hand is not None:
                _hold(model, np.asarray(peg_hand.wxyz_xyz[row], float))
            models.append(model)
        return models


def _hold(model: mujoco.MjModel, peg_hand: Float[np.ndarray, "7"]) -> None:
    """Move the peg in the hand: a quaternion, and a displacement, m."""
    turn, shift = peg_hand[:4], peg_hand[4:]
    body, rotated = model.body("peg").id, np.empty(3)
    first = model.body_geomadr[body]
    for geom in range(first, first + model.body_geomnum[body]):
        mujoco.mju_rotVecQuat(rotated, model.geom_pos[geom], turn)
        model.geom_pos[geom] = rotated + shift
        mujoco.mju_mulQuat(model.geom_quat[geom], turn, model.geom_quat[geom].copy())
        model.geom_sameframe[geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE


def _touch(model: mujoco.MjModel, own: dict[str, float]) -> None:
    """Set friction and stiffness of all geoms and pairs."""
    if "friction" in own:
        model.geom_friction[:, 0] = own["friction"]
        model.pair_friction[:, :2] = max(own["friction"], mujoco.mjMINMU)
    for column, name in enumerate(("contact_time_s", "contact_damping")):
        if name in own:
            model.geom_solref[:, column] = own[name]
            model.pair_solref[:, column] = own[name]


def _bound(model: mujoco.MjModel) -> None:
    """Update the bounds of all boxes, and leave out the tree of bounds, which is not updated."""
    model.geom_rbound[:] = np.linalg.norm(model.geom_size, axis=1)
    model.geom_aabb[:, 3:] = model.geom_size
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
