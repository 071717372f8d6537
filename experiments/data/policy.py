"""Compare random policies for data collection.

    python experiments/data/policy.py

The paper describes its policy in one line: random actions, like the exploration noise of the spiral. Taken
literally, this is a random walk with steps of sigma. The script compares possible interpretations, other
policies and the spiral of an attempt by criteria that matter for learning.
"""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.control import open_loop, policies
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.evaluation.statistics import wilson
from mjx_fit.report import script
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.sensors.force_torque import touched
from mjx_fit.types import Array, Rollout
from mjx_fit.utils import process_setup
from mjx_fit.utils.randomness import root_key

EPISODES, ACTIONS = 252, 200
AROUND_M, CELL_M = 0.025, 0.0025
"""Half width of the square around the hole that should be covered, and its cell size."""
WALL_RATIO = 0.6
"""Ratio of lateral force to push that implies wall contact: friction (0.3) explains half of it."""
PUSH_M = Config().random.push_m


def walk(sigma_m: float) -> policies.Policy:
    """Make a policy of N(0, σ²) steps in the plane from the current TCP position, pressed on the socket."""

    def command(seen):
        return jnp.append(sigma_m * jax.random.normal(seen.key, (2,)), -PUSH_M)

    return policies.stateless(command)


def jumps(seen):
    """Draw a new goal within reach of the estimate in every action."""
    goal = jax.random.uniform(seen.key, (2,), minval=-AROUND_M, maxval=AROUND_M)
    return jnp.append(goal + seen.start.estimate_world - seen.tip_pos_world[:2], -PUSH_M)


def sweeps(actions: int, reach_m: float) -> policies.Policy:
    """Make the library's random policy: straight sweeps between waypoints."""
    return open_loop.random(replace(Config().random, actions_per_sweep=actions, reach_m=reach_m))


def spirals() -> policies.Policy:
    """Make a policy that repeats the spiral of an attempt, as at test time."""
    one, length = open_loop.spiral(Config().spiral), Config().task.attempt_actions

    def act(state, seen):
        return one.act(state, replace(seen, step=seen.step % length, horizon=length))

    return policies.Policy(one.init, act)


CANDIDATES: dict[str, policies.Policy] = {
    "spirals, as in attempts": spirals(),
    "walk, sigma 1.25 mm": walk(0.00125),
    "walk, sigma 25 mm": walk(0.025),
    "jumps within ±25 mm": policies.stateless(jumps),
    "sweeps of 0.6 s, ±25 mm": sweeps(6, 0.025),
    "sweeps of 1.2 s, ±25 mm": sweeps(12, 0.025),
    "sweeps of 2.4 s, ±25 mm": sweeps(24, 0.025),
    "sweeps of 1.2 s, ±35 mm": sweeps(12, 0.035),
}
HERE = Path(__file__).parent


def main() -> None:
    """Run every candidate from the same starts at the same holes."""
    config = Config()
    attempts = draw_attempts(root_key(0, "policy"), jnp.arange(EPISODES), "random", config)
    done: dict[str, Rollout] = {}
    for name, policy in CANDIDATES.items():
        done[name] = NativeEngine(config, 2, policy).run(attempts, ACTIONS)
    facts = {name: _facts(each) for name, each in done.items()}
    script.save(HERE / "policy.json", {"episodes": EPISODES, "policies": facts})
    script.draw(HERE / "policy.png", lambda: _figure(done))


def _facts(done: Rollout) -> dict:
    real = np.arange(ACTIONS) < done.felt.length[:, None]
    matched = done.felt.peg_type == done.truth.hole_type
    offset = done.felt.trace.tip_pos_world[..., :2] - done.truth.hole_pos_world[:, None]
    near = real & (np.abs(offset) < AROUND_M).all(-1)
    cells = _cells(offset)
    visited = [len(np.unique(cells[i][near[i]])) for i in range(len(real))]
    share = np.bincount(cells[near], minlength=_CELLS**2) / near.sum()
    walls = _walls(done, real)
    return {
        "cells_visited_in_one_interaction": float(np.mean(visited)) / _CELLS**2,
        "evenness_of_all_visits": float(
            -(share[share > 0] * np.log(share[share > 0])).sum() / np.log(_CELLS**2)
        ),
        "actions_near_the_hole": float(near.sum() / real.sum()),
        "actions_in_contact": float(touched(done.felt, Config().wrist).sum() / real.sum()),
        "actions_with_a_wall_met": float(sum(walls) / real.sum()),
        "walls_met_by_direction": (np.array(walls) / sum(walls)).round(4),
        "steady_sideways_over_push": _steady(done, real),
        "matched_inserted": _rate(done.truth.inserted[matched]),
        **{
            f"{name}_inserted": _rate(done.truth.inserted[matched & (done.felt.peg_type == i)])
            for i, name in enumerate(SceneConfig().names)
        },
        "length_matched_quartiles": np.quantile(done.felt.length[matched], [0.25, 0.5, 0.75]),
        "beside_the_plate": int((~done.truth.inserted & _left_plate(done, real)).sum()),
        "speed_quartiles_m_per_s": np.quantile(_speed(done)[real], [0.25, 0.5, 0.75]),
        "force_median_n": float(np.median(_force(done)[real])),
        "force_99_percent_n": float(np.quantile(_force(done)[real], 0.99)),
        "mismatched_inserted": int(done.truth.inserted[~matched].sum()),
    }


_CELLS = round(2 * AROUND_M / CELL_M)


def _cells(offset: Array) -> np.ndarray:
    """Return the cell number of each offset from the hole; valid within the square only."""
    x, y = np.clip((offset + AROUND_M) // CELL_M, 0, _CELLS - 1).astype(int).transpose(2, 0, 1)
    return _CELLS * y + x


def _walls(done: Rollout, real: np.ndarray) -> list[int]:
    """Count actions with wall contact, by the octant of the wall's force."""
    force = done.felt.trace.wrench_sensor[..., :3] - done.felt.tare_sensor[:, None, None, :3]
    strongest = np.hypot(force[..., 0], force[..., 1]).argmax(-1)
    force = np.take_along_axis(force, strongest[..., None, None], 2)[:, :, 0]
    # The steady push is not vertical: the arm's inertia couples the axes of the controller's command.
    steady = np.nanmedian(np.where(real[..., None], force, np.nan), 1, keepdims=True)
    force = force - np.array([1, 1, 0]) * steady
    sideways = np.hypot(force[..., 0], force[..., 1])
    met = real & (sideways > WALL_RATIO * np.abs(force[..., 2])) & (sideways > 2)
    eighth = np.floor((np.arctan2(force[..., 1], force[..., 0]) + np.pi) / (np.pi / 4)).astype(int) % 8
    return np.bincount(eighth[met], minlength=8).tolist()


def _steady(done: Rollout, real: np.ndarray) -> float:
    """Compute the ratio of steady lateral to vertical push, median over the interactions."""
    force = done.felt.trace.wrench_sensor[..., :3] - done.felt.tare_sensor[:, None, None, :3]
    force = np.nanmedian(np.where(real[..., None, None], force, np.nan), (1, 2))
    return float(np.median(np.hypot(force[:, 0], force[:, 1]) / np.abs(force[:, 2])))


def _left_plate(done: Rollout, real: np.ndarray) -> Array:
    low = (
        np.asarray(done.felt.trace.tip_pos_world)[..., 2]
        < plate_top_m(Config().scene) - Config().task.insertion_depth_m
    )
    return (low & real).sum(1) > 0


def _speed(done: Rollout) -> np.ndarray:
    """Compute the mean planar TCP speed in each action, m/s."""
    way = np.diff(done.felt.trace.tip_pos_world[..., :2], axis=1, prepend=done.felt.estimate_world[:, None])
    return np.linalg.norm(way, axis=-1) / 0.1


def _force(done: Rollout) -> np.ndarray:
    """Compute the peak force in each action, N."""
    force = done.felt.trace.wrench_sensor[..., :3] - done.felt.tare_sensor[:, None, None, :3]
    return np.linalg.norm(force, axis=-1).max(-1)


def _rate(inserted: Array) -> list[float]:
    row = wilson(int(inserted.sum()), len(inserted))
    return [round(x, 3) for x in (row.value, row.low, row.high)]


def _figure(done: dict[str, Rollout]) -> Figure:
    figure = Figure(figsize=(11, 6))
    axes = figure.subplots(2, 4).ravel()
    edges = np.linspace(-5, 5, 81)
    mesh = None
    for ax, (name, each) in zip(axes, done.items(), strict=True):
        real = np.arange(ACTIONS) < each.felt.length[:, None]
        x, y = 100 * (each.felt.trace.tip_pos_world[..., :2] - each.truth.hole_pos_world[:, None])[real].T
        counts, *_ = np.histogram2d(x, y, bins=[edges, edges])
        mesh = ax.pcolormesh(edges, edges, np.ma.masked_equal(counts.T, 0), norm=LogNorm(1, 300))
        ax.plot(2.5 * np.array([-1, 1, 1, -1, -1]), 2.5 * np.array([-1, -1, 1, 1, -1]), color="#D55E00")
        ax.set(title=name, aspect="equal", xticks=[-4, -2, 0, 2, 4], yticks=[-4, -2, 0, 2, 4])
        ax.grid(visible=False)
    figure.supxlabel("x offset from the hole centre (cm)", fontsize=11)
    figure.supylabel("y offset from the hole centre (cm)", fontsize=11)
    assert mesh is not None
    figure.colorbar(mesh, ax=list(axes), label="Actions that end in the cell", format="%g", shrink=0.6)
    return figure


if __name__ == "__main__":
    process_setup.configure()
    main()
