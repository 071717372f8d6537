"""Measure penetration depth, peak force and mismatched insertions.

    python experiments/physics/contact.py

The script runs spiral attempts of all nine pairs in the C engine and reads the deepest contact from MuJoCo at
every step (500 Hz). The commanded force is the task-space force of the impedance, |Λp kp e|, with e from the
TCP to the goal: the push that the controller would exert on a fixed peg.
"""

# pyright: reportAttributeAccessIssue=false
import jax
import mujoco
import numpy as np
import shared
from matplotlib.figure import Figure

from benchmarks.python_loop import task_space
from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import mismatched_pairs
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.report.figures import style
from mjx_fit.types import Rollout
from mjx_fit.utils.rates import SUBSTEPS

MATCHED, OTHERS = 102, 600
ALLOWED_SHARE = 0.1
"""Allowed penetration as a share of the clearance."""
ALLOWED_FACTOR = 3
"""Allowed peak force, as a multiple of the largest commanded force of the same attempt. A peg that lands or
runs into an edge is stopped within a few milliseconds, so an impact may exceed the push."""


def main() -> None:
    """Run the attempts and compute the statistics."""
    config = shared.config()
    n_types = config.scene.n_types
    matched, others = np.arange(MATCHED) % n_types, mismatched_pairs(n_types)[np.arange(OTHERS) % 6]
    peg, hole = (np.concatenate([matched, others[:, side]]) for side in range(2))
    attempts = shared.spiral_attempts(config, "contact", peg, hole)
    n, actions = len(peg), config.task.attempt_actions
    depth = np.full((n, actions * SUBSTEPS), np.nan, np.float32)
    iterations = np.zeros((n, actions * SUBSTEPS), np.int16)
    step = np.zeros(n, int)

    def look(ids: np.ndarray, batch) -> None:
        data = mujoco.MjData(engine.scene.models[0])
        for i, world in enumerate(ids):
            batch.get_data(i, data)
            if data.ncon:
                depth[world, step[world]] = -data.contact.dist.min()
            iterations[world, step[world]] = data.solver_niter[0]
        step[ids] += 1

    engine = NativeEngine(config, 2, on_step=look)
    done = engine.run(attempts, actions)
    felt = shared.force(done)
    real = np.isfinite(felt)
    depth[~real] = np.nan
    depth[depth <= 0] = np.nan
    pushed = commanded(config, engine, done)
    peak = np.nanmax(felt, 1)
    levels = (0.5, 0.9, 0.99, 0.999, 1)
    deepest = shared.quantiles(depth, levels)
    results = {
        "attempts": n,
        "contact_samples": int(np.isfinite(depth).sum()),
        "clearance_m": config.scene.clearance_m,
        "penetration_m": deepest,
        "penetration_allowed_m": ALLOWED_SHARE * config.scene.clearance_m,
        "force_n": shared.quantiles(felt, levels),
        "peak_force_of_an_attempt_n": shared.quantiles(peak, (0.5, 0.9, 0.99, 1)),
        "commanded_force_n": shared.quantiles(pushed, (0.5, 0.99, 1)),
        "peak_over_largest_command": float(peak.max() / np.nanmax(pushed)),
        "peak_over_command_in_the_same_attempt": shared.quantiles(peak / np.nanmax(pushed, 1), (0.5, 0.9, 1)),
        "allowed_factor": ALLOWED_FACTOR,
        "solver_iterations": shared.quantiles(iterations[real].astype(float), levels),
        "mismatched_attempts": OTHERS,
        "mismatched_inserted": int(done.truth.inserted[MATCHED:].sum()),
        "broken": int((~done.truth.valid).sum()),
        "holds": {
            "penetration": deepest["q99.9"] < ALLOWED_SHARE * config.scene.clearance_m,
            "force": bool((peak < ALLOWED_FACTOR * np.nanmax(pushed, 1)).all()),
            "no_mismatched_insertion": not done.truth.inserted[MATCHED:].any(),
        },
    }
    shared.save("contact", results)
    shared.draw("contact", lambda: _figure(depth, peak, np.nanmax(pushed, 1), config))


def commanded(config: Config, engine: NativeEngine, done: Rollout) -> np.ndarray:
    """Compute |Λp kp e| at the start of each action (n, J), N, with Λp at the final posture."""
    model = engine.scene.models[0]
    data = mujoco.MjData(model)
    actions, length = done.felt.trace.action_world, done.felt.length
    forces = np.full(actions.shape[:2], np.nan)
    for i, qpos in enumerate(done.truth.end_qpos):
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        inertia = task_space(model, data)[3][:3, :3]
        goal = config.control.kp_position * actions[i, : length[i]]
        forces[i, : length[i]] = np.linalg.norm(goal @ inertia, axis=1)
    return forces


def _figure(depth: np.ndarray, peak: np.ndarray, pushed: np.ndarray, config: Config) -> Figure:
    figure = Figure(figsize=(9, 3.6))
    left, right = figure.subplots(1, 2)
    microns = np.sort(1e6 * depth[np.isfinite(depth)])
    left.plot(microns, 1 - np.arange(len(microns)) / len(microns), color=style.MATCHED_COLOUR)
    left.axvline(1e6 * ALLOWED_SHARE * config.scene.clearance_m, color=style.PAPER_COLOUR, linestyle="--")
    left.axhline(1e-3, color=style.PAPER_COLOUR, linewidth=0.8, linestyle=":")
    left.set(
        xlabel="Penetration [µm]", ylabel="Share of deeper contact samples", yscale="log", xlim=(0, None)
    )
    left.text(1e6 * ALLOWED_SHARE * config.scene.clearance_m + 3, 0.3, "10 % of the\nclearance")
    left.text(microns.max(), 1.15e-3, "0.1 %", ha="right")
    bins = np.linspace(0, 1.05 * peak.max(), 40)
    right.hist(peak, bins, color=style.MISMATCHED_COLOUR, alpha=0.8, label="measured peak force per attempt")
    right.hist(pushed, bins, color=style.MATCHED_COLOUR, alpha=0.8, label="peak commanded force per attempt")
    right.set(xlabel="Force [N]", ylabel="Attempts")
    right.legend(loc="upper right")
    right.set_ylim(0, 1.35 * right.get_ylim()[1])
    left.yaxis.set_major_formatter(lambda share, _: f"{100 * share:g} %")
    return figure


if __name__ == "__main__":
    shared.begin()
    jax.block_until_ready(jax.numpy.zeros(1))
    main()
