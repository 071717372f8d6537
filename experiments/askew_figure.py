"""Draw a socket and a peg that stand askew, with the frames that a belief about poses is about.

    python experiments/askew_figure.py docs/askew.png

Requires offscreen OpenGL, like ``mjx-fit render``.
"""

import sys
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
from frames_figure import SIZE, Frame, _draw_frame, _image

from mjx_fit.viz import gl

VIEW = {"lookat": (0.5, 0.0, 0.13), "distance": 0.42, "azimuth": 125.0, "elevation": -14.0}
SOCKET = {"socket_yaw_rad": 0.35, "socket_roll_rad": 0.1, "socket_pitch_rad": -0.1}
GRASP = {
    "grasp_x_m": 0.01,
    "grasp_y_m": -0.01,
    "grasp_yaw_rad": -0.2,
    "grasp_roll_rad": 0.14,
    "grasp_pitch_rad": 0.08,
}
ABOVE_M, LENGTH_M = 0.06, 0.04


def main(path: str) -> None:
    """Draw the tool above the socket, and where it has to be for the peg to be in its hole."""
    gl.choose()
    import matplotlib.pyplot as plt

    from mjx_fit.config.files import read_config
    from mjx_fit.evaluation.recording import Recording
    from mjx_fit.filters.frame import frame_of
    from mjx_fit.filters.updates import detected_belief
    from mjx_fit.scene.parts import plate_top_m
    from mjx_fit.scene.placement import place_for_tool, setting_of
    from mjx_fit.types.physics import AS_CONFIGURED
    from mjx_fit.viz.scene_model import Puppet
    from mjx_fit.viz.timeline import Moment

    sets = [f"placement.{name}={value}" for name, value in (SOCKET | GRASP).items()]
    config = read_config(None, [*sets, "filter.coordinates=[x, y, z, yaw, roll, pitch]"])
    hole, top = jnp.array([[0.5, 0.0]]), plate_top_m(config.scene)
    setting = setting_of(hole, AS_CONFIGURED, config)
    place = np.asarray(place_for_tool(hole, AS_CONFIGURED, config))[0]
    here, socket, tip = frame_of(place, config.filter.coordinates), setting.socket_world, setting.peg_tip
    assert socket is not None
    assert tip is not None
    kinds = np.zeros(1, int)
    puppet = Puppet(Recording("", 0, config, kinds, np.asarray(hole), kinds, ()))
    puppet.model.vis.global_.offwidth, puppet.model.vis.global_.offheight = SIZE
    belief = detected_belief(hole, config)

    def shown(above_m: float) -> tuple[Any, Any, dict[str, Frame]]:
        at = np.asarray(here.world(jnp.array([*place[:2], top + above_m]), top))
        turn = np.asarray(here.rotation_world.log())
        moment = Moment(0, "attempt", 0.0, at, turn, belief, np.full(1, -1), holding=True)
        step: Any = SimpleNamespace(peg=0)
        puppet.pose(moment, step, puppet.postures(moment.tip_world[None])[0])
        tool = puppet.data.site("tip")
        axes = tool.xmat.reshape(3, 3).copy()
        held = axes @ np.asarray(tip.rotation().as_matrix())[0]
        peg = tool.xpos + axes @ np.asarray(tip.translation())[0]
        stands = np.asarray(socket.rotation().as_matrix())[0]
        frames = {
            "tool": (tool.xpos.copy(), axes),
            "peg": (peg, held),
            "hole": (np.asarray(socket.translation())[0], stands),
        }
        return *_image(puppet.model, puppet.data, VIEW), frames

    figure, (above, inside) = plt.subplots(1, 2, figsize=(12, 6.5))
    figure.set_layout_engine("constrained", h_pad=0.12)
    image, on_image, frames = shown(ABOVE_M)
    above.imshow(image)
    told = {
        "tool": ("tool centre point:\nall that the robot measures", (0.03, 0.62)),
        "peg": ("lower face of the peg,\nas it is held", (0.66, 0.6)),
        "hole": ("hole, as the socket stands", (0.03, 0.12)),
    }
    for name, (words, at) in told.items():
        _draw_frame(above, on_image, frames[name], words, at, LENGTH_M)
    image, on_image, frames = shown(0.0)
    inside.imshow(image)
    told = {
        "tool": ("where the tool has to be:\nwhat a belief is about", (0.03, 0.62)),
        "hole": ("hole: the peg is in it,\nand the tool beside it", (0.62, 0.16)),
    }
    for name, (words, at) in told.items():
        _draw_frame(inside, on_image, frames[name], words, at, LENGTH_M)
    for ax, title in ((above, "Before an attempt"), (inside, "The peg at its hole")):
        ax.set(xticks=[], yticks=[], title=title, xlim=(0, SIZE[0]), ylim=(SIZE[1], 0))
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main(sys.argv[1])
