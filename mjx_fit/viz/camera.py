"""Rendering of the robot and the sockets as an image."""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

from mjx_fit.viz import belief_marks
from mjx_fit.viz.scene_model import Puppet
from mjx_fit.viz.timeline import Moment

_LOOK_AT, _DISTANCE_M, _AZIMUTH_DEG, _ELEVATION_DEG = (0.40, 0.0, 0.18), 1.5, 140.0, -33.0
_SHADOW_PX = 2048


class Stage:
    """Camera that renders a puppet; close it when done."""

    def __init__(self, acting: Puppet, width: int, height: int):
        """Open an OpenGL context.

        Args:
            acting: Puppet to render.
            width: Image width, px.
            height: Image height, px.
        """
        self._puppet, self._size = acting, (width, height)
        acting.model.vis.quality.shadowsize = _SHADOW_PX
        acting.model.vis.global_.offwidth, acting.model.vis.global_.offheight = width, height
        self._camera = mujoco.MjvCamera()
        set_camera(self._camera)
        self._renderer = mujoco.Renderer(acting.model, height, width)

    def close(self) -> None:
        """Free the context."""
        self._renderer.close()

    def draw(self, moment: Moment) -> UInt8[np.ndarray, "h w 3"]:
        """Render a moment; the puppet must already be in its pose."""
        self._renderer.update_scene(self._puppet.data, self._camera)
        belief_marks.add(self._renderer.scene, self._puppet.marks(moment))
        return self._renderer.render()

    def on_image(self, point_world: Float[np.ndarray, "3"]) -> tuple[float, float]:
        """Project a point of the world onto the last rendered image, px from the upper left."""
        eye = self._renderer.scene.camera[0]
        forward, up = np.array(eye.forward), np.array(eye.up)
        # MuJoCo has a stereo pair of cameras and renders from the midpoint.
        ray = point_world - np.mean([camera.pos for camera in self._renderer.scene.camera], axis=0)
        half = ray @ forward * eye.frustum_top / eye.frustum_near
        x, y = ray @ np.cross(forward, up) / half, ray @ up / half
        width, height = self._size
        return (width + x * height) / 2, (1 - y) * height / 2


def set_camera(camera: mujoco.MjvCamera) -> None:
    """Place a camera so that the robot and all holes are visible."""
    camera.lookat[:], camera.distance = _LOOK_AT, _DISTANCE_M
    camera.azimuth, camera.elevation = _AZIMUTH_DEG, _ELEVATION_DEG
