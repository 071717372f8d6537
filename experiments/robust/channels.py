"""Exchange one channel of the measurements at a time among attempts: on which does the sensor rely?

    python experiments/robust/channels.py RUN DATA OUT.json [--orientation-noise-deg SIGMA]

DATA are spiral attempts that the run was not trained on. The readings have the errors of their world, but for
the white noise of the orientation if that is given.

Each failed first attempt gets one channel of another attempt, row by row, and keeps everything else; the
sensor's noise comes after that. ``gain_mm`` is the growth of the position error, paired by attempt: 0 for a
channel that the sensor does not use. A channel that contradicts the others can make it worse than none would.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from mjx_fit.config.schema import config_from_stored
from mjx_fit.data import reader
from mjx_fit.data.episode import Episode
from mjx_fit.data.manifest import read_manifest
from mjx_fit.evaluation import held_out
from mjx_fit.evaluation.scores import auroc
from mjx_fit.evaluation.statistics import bootstrap_mean
from mjx_fit.report import script
from mjx_fit.sensors.pose import from_down, rotation_from_down
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.types import Trace
from mjx_fit.utils import process_setup

MM_PER_M = 1000.0
Change = Callable[[Trace, Trace], Trace]
"""Function of the own traces and of those of other attempts, (n, J, ...)."""


def _columns(field: str, *columns: int) -> Change:
    def change(own: Trace, other: Trace) -> Trace:
        mixed = np.array(getattr(own, field))
        mixed[..., list(columns)] = np.asarray(getattr(other, field))[..., list(columns)]
        return replace(own, **{field: mixed})

    return change


def _rotation(*axes: int) -> Change:
    def change(own: Trace, other: Trace) -> Trace:
        mixed, there = (np.array(rotation_from_down(jnp.asarray(one.tip_quat_world))) for one in (own, other))
        mixed[..., list(axes)] = there[..., list(axes)]
        return replace(own, tip_quat_world=np.asarray(from_down(jnp.asarray(mixed))))

    return change


CHANNELS: dict[str, Change] = {
    "force_xy": _columns("wrench_sensor", 0, 1),
    "force_z": _columns("wrench_sensor", 2),
    "torque_xy": _columns("wrench_sensor", 3, 4),
    "torque_z": _columns("wrench_sensor", 5),
    "height": _columns("tip_pos_world", 2),
    "tilt": _rotation(0, 1),
    "yaw": _rotation(2),
    "linear_velocity_xy": _columns("tip_linvel_world", 0, 1),
    "linear_velocity_z": _columns("tip_linvel_world", 2),
    "angular_velocity": _columns("tip_angvel_world", 0, 1, 2),
    "command_z": _columns("action_world", 2),
}
"""Places and commands in the plane are left: they are the path, not a measurement of the hole."""


def main(run: Path, folder: Path, out: Path, orientation_noise_deg: float | None) -> None:
    sensor = load_trained_sensor(run)
    stored = config_from_stored(read_manifest(folder).request["config"])
    config = replace(stored, sensor=sensor.config.sensor)
    if orientation_noise_deg is not None:
        pose = replace(config.pose, orientation_noise_rad=float(np.deg2rad(orientation_noise_deg)))
        config = replace(config, pose=pose)
    data = reader.load(folder)
    actions = config.task.attempt_actions
    ids = held_out.failed_attempts(data, actions)
    ids = ids[np.asarray(data.number)[ids] == 0]
    felt, truth = data.rollout.felt, data.rollout.truth
    matches = np.asarray(felt.peg_type == truth.hole_type)[ids]

    def scored(episodes: Episode) -> tuple[Float[np.ndarray, " n"], float]:
        seen = held_out.observe(sensor.network, episodes, ids, actions, config, seed=0)
        after = held_out.posterior(seen, episodes, ids, config, with_prior=True)
        miss = np.asarray(truth.hole_pos_world)[ids] - after.belief.pos_mean_world
        return MM_PER_M * np.linalg.norm(miss, axis=1), auroc(np.asarray(after.match_probability), matches)

    error, area = scored(data)
    results = {
        "n": len(ids),
        "orientation_noise_deg": float(np.rad2deg(config.pose.orientation_noise_rad)),
        "std_in_an_attempt": _spread(felt.trace, ids),
        "as_it_was": {"error_mm": _mean(error), "auroc": area},
    }
    for name, change in CHANNELS.items():
        changed, its_area = scored(_exchanged(data, ids, change))
        results[name] = {"error_mm": _mean(changed), "gain_mm": _mean(changed - error), "auroc": its_area}
        print(name, results[name], flush=True)
    script.save(out, results)


def _exchanged(data: Episode, ids: Int[np.ndarray, "n"], change: Change) -> Episode:
    """Change the attempts with these ids, each with its predecessor in a random order."""
    order = np.random.default_rng(7).permutation(len(ids))
    other = np.empty(len(ids), int)
    other[order] = np.roll(order, 1)
    felt = data.rollout.felt
    own, there = (
        jax.tree.map(lambda leaf, rows=rows: np.asarray(leaf)[rows], felt.trace) for rows in (ids, ids[other])
    )
    # Wrenches are tared, and the tare belongs to the attempt that they come from.
    tare = np.asarray(felt.tare_sensor)
    shift = (tare[ids] - tare[ids[other]])[:, None, None]
    there = replace(there, wrench_sensor=there.wrench_sensor + shift)
    mixed = change(own, there)
    trace = jax.tree.map(lambda whole, part: _with_rows(whole, ids, part), felt.trace, mixed)
    return replace(data, rollout=replace(data.rollout, felt=replace(felt, trace=trace)))


def _with_rows(whole: np.ndarray, rows: np.ndarray, part: np.ndarray) -> np.ndarray:
    changed = np.array(whole)
    changed[rows] = part
    return changed


def _spread(trace: Trace, ids: Int[np.ndarray, "n"]) -> dict[str, float]:
    """Compute the standard deviation within an attempt of what is measured, median over attempts."""
    rotation = np.rad2deg(np.asarray(rotation_from_down(jnp.asarray(np.asarray(trace.tip_quat_world)[ids]))))
    spread = np.median(rotation.std(1), axis=0)
    height = MM_PER_M * np.asarray(trace.tip_pos_world)[ids, :, 2].std(1)
    return {
        "tilt_deg": float(spread[:2].mean()),
        "yaw_deg": float(spread[2]),
        "height_mm": float(np.median(height)),
    }


def _mean(values: Float[np.ndarray, " n"]) -> dict[str, float]:
    value, low, high = bootstrap_mean(values, np.arange(len(values)).tolist())
    return {"value": value, "low": low, "high": high}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("run", "data", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--orientation-noise-deg", type=float)
    args = parser.parse_args()
    process_setup.configure()
    main(args.run, args.data, args.out, args.orientation_noise_deg)
