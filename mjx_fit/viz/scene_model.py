"""Robot, pegs and sockets in the pose of a moment: sockets as they stand, the peg as it is held."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import re

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

from mjx_fit.control.kinematics import chain_of, inverse
from mjx_fit.evaluation.recording import Recording, Step
from mjx_fit.scene.build import picture_scene
from mjx_fit.scene.placement import setting_of
from mjx_fit.scene.robot import ROBOTS
from mjx_fit.task.assembly_snapshot import EMPTY
from mjx_fit.utils.type_colours import TYPE_RGB
from mjx_fit.viz.belief_marks import Mark, marks_of
from mjx_fit.viz.timeline import Moment


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
        self._inverse = jax.jit(jax.vmap(lambda tip: inverse(chain, tip[:3], turn_world=tip[3:])))
        holes = range(len(recording.hole_type))
        setting = setting_of(jnp.asarray(recording.hole_pos_world), recording.physics, recording.config)
        self._held = None if setting.peg_hand is None else np.asarray(setting.peg_hand.wxyz_xyz, float)
        self._straight = self.model.geom_pos.copy(), self.model.geom_quat.copy()
        if setting.socket_world is not None:
            for hole in holes:
                socket = self.model.body(f"hole{hole}")
                socket.pos = np.asarray(setting.socket_world.translation())[hole]
                socket.quat = np.asarray(setting.socket_world.rotation().wxyz)[hole]
        self._hand = self._pegs("hand")
        self._placed = [self._pegs(f"placed_{hole}") for hole in holes]
        for pegs in (self._hand, *self._placed):
            for kind, geoms in enumerate(pegs):
                self.model.geom_rgba[geoms, :3] = TYPE_RGB[kind]

    def postures(self, tips: Float[np.ndarray, "f 6"]) -> Float[np.ndarray, "f joints"]:
        """Return the joint angles (rad) that place the end effector at each position (m) and turn (rad)."""
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
        if self._held is not None:
            self._hold(self._hand[peg_type], self._held[step.peg])
        for kind, pegs in zip(moment.content, self._placed, strict=True):
            self._show(pegs, kind)
        mujoco.mj_forward(self.model, self.data)

    def marks(self, moment: Moment) -> list[Mark]:
        """Return the marks of the belief."""
        return marks_of(moment.belief, ~moment.filled, self._recording.config)

    def _show(self, pegs: list[list[int]], kind: int) -> None:
        """Show the peg of one type only."""
        for i, geoms in enumerate(pegs):
            self.model.geom_rgba[geoms, 3] = float(i == kind)

    def _hold(self, geoms: list[int], pose: Float[np.ndarray, "7"]) -> None:
        """Hold a peg in a pose in the hand: a quaternion, and a displacement, m."""
        turn, shift = pose[:4], pose[4:]
        for geom in geoms:
            pos, quat = (own[geom] for own in self._straight)
            mujoco.mju_rotVecQuat(self.model.geom_pos[geom], pos, turn)
            self.model.geom_pos[geom] += shift
            mujoco.mju_mulQuat(self.model.geom_quat[geom], turn, quat)
            self.model.geom_sameframe[geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE

    def _pegs(self, place: str) -> list[list[int]]:
        """Return the geoms of the peg of each type at a place."""
        return [self._geoms(f"{place}_{name}_") for name in self._recording.config.scene.names]

    def _geoms(self, prefix: str) -> list[int]:
        mine = re.compile(re.escape(prefix) + r"\d+")  # a name may be a prefix of another
        return [i for i in range(self.model.ngeom) if mine.fullmatch(self.model.geom(i).name)]
