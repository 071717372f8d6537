"""Measure how often a sliding peg loses contact, why, and which coefficient of friction results.

    python experiments/physics/sliding.py

A loss of contact is a simulation step without contact points after one with some; MJX does not list them, so
there it is a sample of less than ``NO_CONTACT_N``, also counted in the C engine. MuJoCo's friction cone is
convex: at sliding speed v friction adds D μ b v to the normal force of a contact, where b is 2 over the deep
impedance and the slip time. A peg that slides faster than F / (D μ b) under a push F is thrown off. Each
variant changes one cause alone. A peg is also dragged over the plate at constant speed, which measures the
coefficient of friction.
"""

# pyright: reportAttributeAccessIssue=false
import sys
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import shared
from matplotlib.figure import Figure

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import world_file
from mjx_fit.control.policies import PolicyInput, stateless
from mjx_fit.data.schedule import mismatched_pairs
from mjx_fit.engines.mjx.engine import MjxEngine
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.report.figures import style
from mjx_fit.types import Attempt, Rollout
from mjx_fit.utils.rates import SUBSTEPS

ATTEMPTS, ACTIONS = 48, 100
NO_CONTACT_N = 1.0
"""More than the inertial force of a peg in the air, 0.5 N after a push of 15 N."""
TOUCHING_S = 0.2
"""Time after the first contact that does not count: the landing."""
STEP_S = 0.002
DITHER_OFF = "spiral.wiggle_m=0"
VARIANTS: dict[str, tuple[str, list[str]]] = {
    "as-2026-11": ("as-2026-11", []),
    "friction 0": ("as-2026-11", ["scene.friction=0"]),
    "without dither": ("as-2026-11", [DITHER_OFF]),
    "goal moves evenly": ("as-2026-11", ["control.goal=ramp"]),
    "softer impedance": ("as-2026-11", ["scene.contact_impedance=0.3", "scene.contact_width_m=0.0001"]),
    "slower friction": ("as-2026-11", ["scene.slip_time_s=0.05"]),
    "paper": ("paper", []),
    "paper, goal jumps": ("paper", ["control.goal=step"]),
    "paper, without dither": ("paper", [DITHER_OFF]),
}
FRICTIONS, SPEEDS_MPS = (0.15, 0.3, 0.6), (0.003, 0.01, 0.03)
DIRECTIONS = np.array([[1, 0], [1, 0], [0, 1], [0, 1], [-1, 0], [-1, 0], [0, -1], [0, -1]], float)
SIDES, BESIDE_M = np.array([1, -1] * 4, float), 0.055
DRAGGED_M, STEADY = 0.02, 0.4
"""Length of the drag, and the share of its end that is evaluated."""


def main() -> None:
    """Run the variants and the drags, and write the table and the figure."""
    slides, samples = {}, {}
    for name, (world, changes) in VARIANTS.items():
        slides[name], samples[name] = slide(read_config(world_file(world), changes))
        print(name, slides[name], flush=True)
    in_mjx = {
        name: slide(read_config(world_file(VARIANTS[name][0]), VARIANTS[name][1]), mjx=True)[0]
        for name in ("as-2026-11", "paper", "paper, without dither")
    }
    drags = [row for world in ("as-2026-11", "paper") for row in dragged(world)]
    worst = max(row["worst"] for row in drags if row["world"] == "paper")
    holds = {
        "without_dither": _worst("paper, without dither", slides, in_mjx) < 1,
        "with_dither": _worst("paper", slides, in_mjx) < 5,
        "friction_within_3_percent": worst < 0.03,
    }
    results = {"native": slides, "mjx": in_mjx, "drags": drags, "worst_drag": worst, "holds": holds}
    shared.save("sliding", results)
    shared.draw("sliding", lambda: _figure(slides, samples))


def _worst(name: str, *engines: dict[str, dict[str, float]]) -> float:
    return max(one[name]["losses_per_s"] for one in engines)


def slide(config: Config, *, mjx: bool = False) -> tuple[dict[str, float], np.ndarray]:
    """Run mismatched spirals in one world; return figures, and the forces along the tool (n, samples)."""
    pairs = mismatched_pairs(config.scene.n_types)[np.arange(ATTEMPTS) % 6]
    attempts = shared.spiral_attempts(config, "sliding", pairs[:, 0], pairs[:, 1])
    touching = np.zeros((ATTEMPTS, ACTIONS * SUBSTEPS), bool)
    step = np.zeros(ATTEMPTS, int)

    def look(ids: np.ndarray, batch) -> None:
        data = mujoco.MjData(engine.scene.models[0])
        for i, world in enumerate(ids):
            batch.get_data(i, data)
            touching[world, step[world]] = data.ncon > 0
        step[ids] += 1

    engine = MjxEngine(config, 2) if mjx else NativeEngine(config, 2, on_step=look)
    done = engine.run(attempts, ACTIONS)
    force = vertical(done)
    figures = {
        **_losses(force > NO_CONTACT_N, done),
        "force_n": float(np.nanmean(force)),
        "peak_force_n": float(np.nanmedian(np.nanmax(force, 1))),
        "power_above_50_hz": _fast_power(force),
        "inserted": int(done.truth.inserted.sum()),
        "invalid": int((~done.truth.valid).sum()),
    }
    if not mjx:
        by_force = {f"{name}_by_force": figures[name] for name in ("losses_per_s", "airborne")}
        figures |= _losses(touching, done) | by_force
    return figures, force


def vertical(done: Rollout) -> np.ndarray:
    """Return the tared force along the tool (n, samples), N; NaN after an attempt's end."""
    felt = done.felt
    force = felt.trace.wrench_sensor[..., 2] - felt.tare_sensor[:, None, None, 2]
    real = np.arange(force.shape[1]) < felt.length[:, None]
    return np.where(real[..., None], force, np.nan).reshape(len(force), -1)


def _losses(touching: np.ndarray, done: Rollout) -> dict[str, float]:
    """Count losses of contact after the landing."""
    losses = samples = airborne = 0
    for whole, length in zip(touching, done.felt.length * SUBSTEPS, strict=True):
        row = whole[int(whole.argmax()) + int(TOUCHING_S / STEP_S) : length]
        losses += int((row[:-1] & ~row[1:]).sum())
        samples, airborne = samples + len(row), airborne + int((~row).sum())
    seconds = samples * STEP_S
    return {"losses_per_s": losses / seconds, "airborne": airborne / samples, "seconds": seconds}


def _fast_power(force: np.ndarray) -> float:
    """Return the share of the force's variance above 50 Hz, over whole attempts."""
    whole = force[np.isfinite(force).all(1)][:, SUBSTEPS * 10 :]
    power = np.abs(np.fft.rfft(whole - whole.mean(1, keepdims=True), axis=1)) ** 2
    fast = np.fft.rfftfreq(whole.shape[1], STEP_S) > 50
    return float(power[:, fast].sum() / power.sum())


def dragged(world: str) -> Iterator[dict[str, Any]]:
    """Drag pegs over the plate in eight directions, and yield measured over set friction."""
    for friction in FRICTIONS:
        config = read_config(world_file(world), [f"scene.friction={friction}"])
        for speed in SPEEDS_MPS:
            actions = int(DRAGGED_M / speed * 10)
            for name, make in (("native", NativeEngine), ("mjx", MjxEngine)):
                if name == "mjx" and speed != SPEEDS_MPS[1]:  # a compilation each
                    continue
                engine = make(config, 2, _drag(speed))
                yield {"world": world, "engine": name, "friction": friction, "speed_mps": speed} | _friction(
                    engine.run(_on_the_plate(), actions), friction
                )


def _drag(speed_mps: float):
    """Create a policy that moves its goal from the start at constant speed, in the attempt's direction."""

    def command(seen: PolicyInput):
        goal = speed_mps * (seen.step + 1) / 10 * jnp.asarray(DIRECTIONS)[seen.start.policy]
        planar = goal - (seen.tip_pos_world[:2] - seen.start.estimate_world)
        return jnp.append(planar, -0.004)

    return stateless(command)


def _on_the_plate() -> Attempt:
    """Return attempts 5.5 cm beside their hole, where a peg dragged past it meets nothing but the plate."""
    n = len(DIRECTIONS)
    hole = jnp.tile(jnp.array([[0.5, 0.0]]), (n, 1))
    estimate = hole + jnp.asarray(BESIDE_M * np.roll(np.abs(DIRECTIONS), 1, axis=1) * SIDES[:, None])
    kind, keys = jnp.zeros(n, int), jax.random.split(jax.random.key(1), n)
    return Attempt(kind, kind, hole, estimate, jnp.arange(n), keys)


def _friction(done: Rollout, friction: float) -> dict[str, float]:
    """Compare friction over normal force at the end of a drag with the coefficient that was set."""
    wrench = done.felt.trace.wrench_sensor - done.felt.tare_sensor[:, None, None]
    last = wrench[:, int((1 - STEADY) * wrench.shape[1]) :].reshape(len(wrench), -1, 6)
    tangent = np.linalg.norm(last[..., :2].mean(1), axis=-1)
    ripple = np.linalg.norm(last[..., :2], axis=-1).std(1) / tangent
    ratio = tangent / last[..., 2].mean(1) / friction
    worst = np.abs(ratio - 1).max()
    return {"ratio": float(ratio.mean()), "worst": float(worst), "ripple": float(ripple.mean())}


def _figure(slides: dict[str, dict[str, float]], samples: dict[str, np.ndarray]) -> Figure:
    figure = Figure(figsize=(10, 3.8))
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.3, 1.2, 1))
    names = list(slides)[::-1]
    left.barh(names, [slides[name]["losses_per_s"] for name in names], color=style.MATCHED_COLOUR)
    left.set(xlabel="Losses of contact [1/s]")
    for name, colour in (("as-2026-11", style.PAPER_COLOUR), ("paper", style.MATCHED_COLOUR)):
        force = samples[name][0]
        middle.plot(STEP_S * np.arange(250), force[1000:1250], color=colour, linewidth=0.8, label=name)
        whole = samples[name][np.isfinite(samples[name]).all(1)][:, 500:]
        power = (np.abs(np.fft.rfft(whole - whole.mean(1, keepdims=True), axis=1)) ** 2).mean(0)
        power = power[1 : 1 + 50 * (len(power[1:]) // 50)].reshape(-1, 50).mean(1)
        right.loglog(np.linspace(0, 250, len(power) + 1)[1:], power / whole.shape[1], color=colour)
    middle.set(xlabel="Time [s]", ylabel="Force along the tool [N]")
    middle.legend(loc="upper right")
    middle.set_ylim(0, 32)
    right.set(xlabel="Frequency [Hz]", ylabel="Power of the force [N²]")
    style.log_axis(right.xaxis)
    style.log_axis(right.yaxis)
    figure.tight_layout()
    return figure


if __name__ == "__main__":
    if len(sys.argv) > 1:
        raise SystemExit(__doc__)
    shared.begin()
    main()
