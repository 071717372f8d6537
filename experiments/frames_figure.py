"""Draw the coordinate frames of the guide and measure the sign of F_z when the peg presses on the socket.

    python experiments/frames_figure.py docs/frames.png

Requires offscreen OpenGL, like ``mjx-fit render``.
"""

# MuJoCo's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mjx_fit.viz import gl

HOLE_M, ABOVE_M, LENGTH_M = (0.5, 0.0), 0.1, 0.042
ASIDE_M, DEPTH_M, STEPS = 0.02, 0.002, 1500
STIFFNESS, DAMPING = 2000.0, 60.0
AXES = {"x": "#d62728", "y": "#2ca02c", "z": "#1f4fd6"}
WIDE = {"lookat": (0.22, 0.0, 0.28), "distance": 1.45, "azimuth": 125.0, "elevation": -20.0}
CLOSE = {"lookat": (0.5, 0.0, 0.145), "distance": 0.56, "azimuth": 125.0, "elevation": -16.0}
SIZE = (900, 900)
Frame = tuple[np.ndarray, np.ndarray]
"""Origin, m, and axes as the columns of a matrix, both in the world frame."""


def push(model: Any, posture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Raise the plate, clear of its hole, against the lower face of a peg that a stiff arm holds still.

    Returns:
        Displacement of the plate past contact, mm (0: first contact); measured F_z, tared, N.
    """
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:7] = posture
    mujoco.mj_forward(model, data)
    tip = data.site("tip").xpos.copy()
    moved, force, tare = np.linspace(-DEPTH_M, DEPTH_M, STEPS), np.empty(STEPS), 0.0
    for i, height in enumerate(moved):
        data.mocap_pos[0] = tip + np.array([ASIDE_M, ASIDE_M, height])
        data.qfrc_applied[:] = data.qfrc_bias + STIFFNESS * (posture - data.qpos) - DAMPING * data.qvel
        mujoco.mj_step(model, data)
        force[i] = data.sensordata[2]
        tare = force[: i + 1].mean() if height < -DEPTH_M / 2 else tare
    return 1000 * moved, force - tare


def _frames(model: Any, data: Any, hole: np.ndarray) -> dict[str, Frame]:
    peg = data.body("peg")
    tip = data.site("tip")
    return {
        "world": (np.zeros(3), np.eye(3)),
        "sensor": (peg.xpos, peg.xmat.reshape(3, 3)),
        "end effector": (tip.xpos, tip.xmat.reshape(3, 3)),
        "hole": (hole, np.eye(3)),
    }


def _image(model: Any, data: Any, view: dict) -> tuple[np.ndarray, Any]:
    """Render an image; also return the map from world points to its pixels."""
    import mujoco

    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance = view["lookat"], view["distance"]
    camera.azimuth, camera.elevation = view["azimuth"], view["elevation"]
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        renderer.update_scene(data, camera)
        eyes = renderer.scene.camera
        eye = np.mean([one.pos for one in eyes], axis=0)
        forward, up = np.array(eyes[0].forward), np.array(eyes[0].up)
        slope = eyes[0].frustum_top / eyes[0].frustum_near
        image = renderer.render()

    def on_image(point: np.ndarray) -> np.ndarray:
        ray = point - eye
        half = ray @ forward * slope
        x, y = ray @ np.cross(forward, up) / half, ray @ up / half
        return np.array([(SIZE[0] + x * SIZE[1]) / 2, (1 - y) * SIZE[1] / 2])

    return image, on_image


def _draw_frame(ax: Any, on_image: Any, frame: Frame, name: str, place: tuple, length_m: float) -> None:
    origin, axes = frame
    start = on_image(origin)
    for letter, axis in zip(AXES, axes.T, strict=True):
        end = on_image(origin + length_m * axis)
        arrow = {"arrowstyle": "-|>", "color": AXES[letter], "lw": 2.6, "mutation_scale": 15}
        ax.annotate("", end, start, arrowprops={**arrow, "shrinkA": 0, "shrinkB": 0})
        text = start + (end - start) * (1 + 20 / max(np.linalg.norm(end - start), 20))
        if letter == "z":  # offset: the axes of two frames meet here
            text = end + np.array([44 if axis[2] < 0 else -26, 0])
        ax.text(*text, letter, color=AXES[letter], ha="center", va="center", weight="bold", size=12)
    ax.plot(*start, "o", color="black", ms=5)
    ax.annotate(
        name,
        start,
        place,
        textcoords="axes fraction",
        va="center",
        size=10.5,
        bbox={"boxstyle": "round,pad=0.35", "fc": "white", "ec": "#999999", "alpha": 0.93},
        arrowprops={"arrowstyle": "-", "color": "#555555", "lw": 1},
    )


def main(path: str) -> None:
    """Simulate the push and draw the three panels."""
    gl.choose()
    import matplotlib.pyplot as plt
    import mujoco

    from mjx_fit.config.schema import Config
    from mjx_fit.control.kinematics import chain_of, inverse
    from mjx_fit.scene.build import picture_scene, simulation_scene
    from mjx_fit.scene.parts import plate_top_m

    config = Config().scene
    hole = np.array([*HOLE_M, plate_top_m(config)])
    physics = simulation_scene(config).models[0]
    posture = np.asarray(
        jax.jit(lambda tip: inverse(chain_of(physics), tip))(jnp.asarray(hole + np.array([0, 0, ABOVE_M])))
    )
    moved, force = push(physics, posture)
    print(f"F_z free {force[moved < -DEPTH_M / 2].mean():+.2f} N, pressed by 2 mm {force[-1]:+.2f} N")

    model = picture_scene(config, [0], np.array([HOLE_M]))
    for i in range(model.ngeom):
        name = model.geom(i).name
        shown = not name.startswith(("hand_", "placed_")) or name.startswith("hand_cross_")
        model.geom_rgba[i, 3] = float(shown)
        if name.startswith("hand_cross_"):
            model.geom_rgba[i, :3] = (0.90, 0.38, 0.05)
    model.vis.global_.offwidth, model.vis.global_.offheight = SIZE
    data = mujoco.MjData(model)
    data.qpos[:7] = posture
    mujoco.mj_forward(model, data)
    frames = _frames(model, data, hole)

    figure, (wide, close, plot) = plt.subplots(
        1, 3, figsize=(15, 5), layout="constrained", width_ratios=(1, 1, 0.9)
    )
    image, on_image = _image(model, data, WIDE)
    wide.imshow(image)
    _draw_frame(wide, on_image, frames["world"], "world\nbelow the base; z up", (0.03, 0.1), 0.16)
    image, on_image = _image(model, data, CLOSE)
    close.imshow(image)
    told = {
        "sensor": ("F/T sensor\naligned with the hand;\nz along the tool, down", (0.03, 0.82)),
        "end effector": ("end effector (TCP)\ncentre of the peg's\nlower face", (0.64, 0.5)),
        "hole": ("hole\ncentre, at the plate's top;\naxes parallel to the world's", (0.03, 0.1)),
    }
    for name, (words, place) in told.items():
        _draw_frame(close, on_image, frames[name], words, place, LENGTH_M)
    for ax, title in ((wide, "World"), (close, "Sensor, end effector, hole")):
        ax.set(xticks=[], yticks=[], title=title, xlim=(0, SIZE[0]), ylim=(SIZE[1], 0))
    plot.axvspan(0, moved[-1], color="#f1ece2")
    plot.axhline(0, color="#777777", lw=1)
    plot.plot(moved, force, color=AXES["z"], lw=2.4)
    plot.set(xlabel="plate raised past contact, mm", ylabel="$F_z$, N (sensor's frame, tared)")
    plot.set_title("The peg presses on the plate: $F_z$ is positive")
    plot.text(0.04, 0.94, "free", transform=plot.transAxes, va="top")
    plot.text(0.54, 0.94, "pressed", transform=plot.transAxes, va="top")
    plot.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main(sys.argv[1])
