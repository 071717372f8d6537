"""Measure the response to a step of 2 cm in free space across the workspace.

python experiments/physics/step_response.py
"""

import jax
import jax.numpy as jnp
import numpy as np
import shared
from matplotlib.figure import Figure

from mjx_fit.config.schema import Config
from mjx_fit.control import operational_space
from mjx_fit.control.kinematics import chain_of, inverse
from mjx_fit.control.policies import SPIRAL
from mjx_fit.engines.native.block import Block, Layout
from mjx_fit.engines.native.models import Models
from mjx_fit.report.figures import style
from mjx_fit.scene.build import simulation_scene
from mjx_fit.scene.placement import setting_of
from mjx_fit.scene.robot import PANDA
from mjx_fit.types import Attempt
from mjx_fit.utils.rates import SUBSTEPS

STEP_M = 0.02
DIRECTIONS = {
    "+x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "+y": (0, 1, 0),
    "-y": (0, -1, 0),
    "+z": (0, 0, 1),
    "-z": (0, 0, -1),
}
GRID = 7
HEIGHT_M = 0.08
SECONDS = 1.5
DT_S = 0.002


def main() -> None:
    """Step in all directions from a grid of positions."""
    config = shared.config()
    axes = [np.linspace(low, high, GRID) for low, high in PANDA.workspace_m]
    place = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    start = np.column_stack([place, np.full(len(place), HEIGHT_M)]).astype(np.float32)
    start = np.repeat(start, len(DIRECTIONS), 0)
    unit = np.tile(np.array(list(DIRECTIONS.values()), np.float32), (len(place), 1))
    tip, frame, torque = follow(config, start, start + STEP_M * unit)

    along = np.einsum("tni,ni->nt", tip - start, unit) / STEP_M
    overshoot = along.max(1) - 1
    steady = np.linalg.norm(tip[-1] - start - STEP_M * unit, axis=1)
    # Angle between the tool's axis and straight down: the largest during the step.
    tilt = np.degrees(np.arccos(np.clip(-frame[..., 2, 2].max(0), -1, 1)))
    used = np.abs(torque).max(0) / np.array(PANDA.torque_limit_nm)
    results = {
        "steps": len(start),
        "overshoot": shared.quantiles(overshoot, (0.5, 1)),
        "steady_error_m": shared.quantiles(steady, (0.5, 1)),
        "tilt_deg": shared.quantiles(tilt, (0.5, 1)),
        "rise_time_s_to_90_percent": shared.quantiles((along >= 0.9).argmax(1) * DT_S, (0, 0.5, 1)),
        "largest_share_of_the_torque_limit": {f"joint{i + 1}": float(used[:, i].max()) for i in range(7)},
        "holds": {
            "overshoot_under_5_percent": bool(overshoot.max() < 0.05),
            "steady_error_under_half_a_mm": bool(steady.max() < 5e-4),
            "tilt_under_1_degree": bool(tilt.max() < 1),
            "torques_within_limits": bool(used.max() <= 1),
        },
    }
    shared.save("step_response", results)
    shared.draw("step_response", lambda: _figure(along, unit))


def follow(config: Config, start: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return TCP positions (T, n, 3), frames (T, n, 3, 3) and torques (T, n, 7) after the goal's step."""
    scene = simulation_scene(config.scene)
    layout, n = Layout(scene), len(start)
    far = np.tile(np.array([0, 5], np.float32), (n, 1))  # the socket is out of the way
    kind = np.zeros(n, int)
    attempts = Attempt(kind, kind, far, far, np.full(n, SPIRAL), jax.random.split(jax.random.key(0), n))
    qpos = np.asarray(jax.vmap(inverse, (None, 0))(chain_of(scene.models[0]), jnp.asarray(start)))
    setting = setting_of(far, attempts.physics, config)
    block = Block(Models(scene), layout, attempts, setting, qpos, n)
    gains = operational_space.gains_of(config)
    command = jax.jit(jax.vmap(lambda row, to: operational_space.torque(layout.unpack(row), to, gains)))
    tips, frames, torques = [], [], []
    for step in range(round(SECONDS / DT_S)):
        torques.append(np.asarray(command(block.packed(), goal)))
        block.step(torques[-1], step % SUBSTEPS)
        tips.append(block.tip_pos_world.copy())
        frames.append(block.packed()[:, layout.slices["site_xmat"]].reshape(n, 3, 3).copy())
    return np.array(tips), np.array(frames), np.array(torques)


def _figure(along: np.ndarray, unit: np.ndarray) -> Figure:
    figure = Figure(figsize=(9, 3.4))
    time = DT_S * np.arange(1, along.shape[1] + 1)
    for ax, (name, axis) in zip(
        figure.subplots(1, 3, sharey=True), (("x", 0), ("y", 1), ("z", 2)), strict=True
    ):
        own = 100 * STEP_M * along[unit[:, axis] != 0]
        ax.plot(time, own.T, color=style.MATCHED_COLOUR, linewidth=0.4, alpha=0.4)
        ax.axhline(100 * STEP_M, color=style.PAPER_COLOUR, linewidth=0.8, linestyle="--")
        ax.set(xlabel="Time [s]", title=f"along ±{name}, {len(own)} steps", xlim=(0, 1))
    figure.axes[0].set_ylabel("Displacement along the step [cm]")
    return figure


if __name__ == "__main__":
    shared.begin()
    main()
