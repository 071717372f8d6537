"""Screen in MuJoCo's own viewer."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable

import mujoco
import mujoco.viewer
import numpy as np

from mjx_fit.viz import belief_marks
from mjx_fit.viz.camera import set_camera
from mjx_fit.viz.scene_model import Puppet
from mjx_fit.viz.timeline import Moment


class Window:
    """Window on the display, with the type probabilities as text in a corner."""

    def __init__(self, puppet: Puppet):
        self._puppet = puppet
        self._viewer = mujoco.viewer.launch_passive(
            puppet.model, puppet.data, show_left_ui=False, show_right_ui=False
        )
        set_camera(self._viewer.cam)

    def show(
        self, pose: Callable[[], None], moment: Moment, words: list[tuple[str, str]], panel: np.ndarray
    ) -> None:
        """Implement ``mjx_fit.viz.viewer.Screen``, without the panel: images flicker in this viewer."""
        with self._viewer.lock():
            pose()
            scene = self._viewer.user_scn
            assert scene is not None  # not None while the window is open
            scene.ngeom = 0
            belief_marks.add(scene, self._puppet.marks(moment))
        left, right = ("\n".join(column) for column in zip(*words, strict=True))
        font, place = mujoco.mjtFontScale.mjFONTSCALE_150, mujoco.mjtGridPos.mjGRID_TOPRIGHT
        self._viewer.set_texts((font, place, left, right))
        self._viewer.sync()

    def is_open(self) -> bool:
        """Implement ``mjx_fit.viz.viewer.Screen``."""
        return self._viewer.is_running()
