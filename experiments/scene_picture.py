"""Draws the five-hole scene: the picture of the README.

    MUJOCO_GL=egl python experiments/scene_picture.py docs/scene.png

Needs an offscreen OpenGL: EGL, or OSMesa with ``MUJOCO_GL=osmesa`` (Debian: libosmesa6).
"""

# pyright: reportAttributeAccessIssue=false
import sys

import jax.numpy as jnp
import matplotlib.image
import mujoco
import numpy as np

from mjx_fit.config import Config
from mjx_fit.kinematics import chain_of, inverse
from mjx_fit.scene import picture_scene, place_holes
from mjx_fit.shapes import plate_top_m

HOLE_TYPES = (0, 1, 2, 0, 1)
SIZE_PX = (640, 1280)
HEIGHT_M = 0.03


def main(path: str) -> None:
    """Renders the arm over its first hole."""
    config = Config()
    holes = place_holes(np.random.default_rng(4), len(HOLE_TYPES), config.scene)
    model = picture_scene(config.scene, HOLE_TYPES[0], HOLE_TYPES, holes)
    data = mujoco.MjData(model)
    tip = jnp.asarray([*holes[0], plate_top_m(config.scene) + HEIGHT_M], jnp.float32)
    data.qpos[:] = inverse(chain_of(model), tip)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = [0.4, 0.02, 0.21]
    camera.distance, camera.azimuth, camera.elevation = 1.3, 130, -27
    with mujoco.Renderer(model, *SIZE_PX) as renderer:
        renderer.update_scene(data, camera)
        matplotlib.image.imsave(path, renderer.render())


if __name__ == "__main__":
    main(sys.argv[1])
