"""Does the belief of `seek` follow what the wrist feels, or where the peg is? Swap the wrenches of attempts.

    python experiments/gentle/places.py DATA RUN...

DATA is a data set of `seek` at home; the first attempts at mismatched holes that touch for 2 s at least are
read. For each sensor, one line with the wrenches of the attempt itself and one with those of another attempt,
from its touch-down on: mean error of the belief and share of holes in the 90 % region, by seconds of contact.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from calibration import INSIDE, first_contact
from jaxtyping import Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import preset
from mjx_fit.data.episode import Episode
from mjx_fit.data.reader import load
from mjx_fit.data.windows import usable
from mjx_fit.filters.updates import initial_belief
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.sensors.trained_sensor import TrainedSensor
from mjx_fit.task.estimator import posterior
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.types import Belief, Felt

AFTER_S = (0.5, 1, 2)
MOST = 800


def main(data: Path, runs: list[Path]) -> None:
    chosen, touch = attempts(load(data))
    felt, hole = chosen.rollout.felt, np.asarray(chosen.rollout.truth.hole_pos_world)
    other = np.random.default_rng(0).permutation(len(touch))
    wrenches = {"own": felt, "another's": swapped(felt, touch, other)}
    detected = np.linalg.norm(hole - felt.estimate_world, axis=1).mean()
    print(f"{len(touch)} attempts, detections {1000 * detected:.1f} mm off")
    for run in runs:
        sensor = load_trained_sensor(run)
        config = sensor.adapt(preset("gentle"))
        for name, read in wrenches.items():
            beliefs = believed(sensor, read, config)
            print(f"{run.name}, wrenches {name}:", ", ".join(judged(beliefs, hole, touch)))


def attempts(data: Episode) -> tuple[Episode, Int[np.ndarray, "n"]]:
    """Return the attempts to read, and the action of their first contact."""
    felt, truth = data.rollout.felt, data.rollout.truth
    touch = first_contact(felt, preset("gentle"))
    long = np.asarray(felt.length) > touch + 10 * max(AFTER_S)
    mismatched = np.asarray(felt.peg_type) != np.asarray(truth.hole_type)
    rows = np.flatnonzero(usable(data) & (np.asarray(data.number) == 0) & mismatched & long)[:MOST]
    return jax.tree.map(lambda leaf: np.asarray(leaf)[rows], data), touch[rows]


def swapped(felt: Felt, touch: Int[np.ndarray, "n"], other: Int[np.ndarray, "n"]) -> Felt:
    """Return the attempts with the wrenches of others, both from their touch-down on."""
    action = np.arange(felt.trace.wrench_sensor.shape[1])
    source = action - touch[:, None] + touch[other][:, None]
    source = np.clip(source, 0, np.asarray(felt.length)[other][:, None] - 1)
    wrench = felt.trace.wrench_sensor[other[:, None], source]
    return replace(felt, trace=replace(felt.trace, wrench_sensor=wrench))


def believed(sensor: TrainedSensor, felt: Felt, config: Config) -> Belief:
    """Return the beliefs after each action, from the detection."""
    n, rows = felt.trace.wrench_sensor.shape[:2]

    @jax.jit
    def read(felt: Felt) -> Belief:
        keys = jax.random.split(jax.random.key(1), n)
        reading = jax.vmap(lambda one, key: read_window(one, key, config, Window(rows)))(felt, keys)
        prior = initial_belief(felt.estimate_world, config.detector.prior_std_m, config.scene.n_types)
        along = jax.tree.map(lambda leaf: jnp.repeat(leaf[:, None], rows, 1), prior)
        peg = jnp.repeat(jnp.asarray(felt.peg_type)[:, None], rows, 1)
        never = jnp.zeros((config.scene.n_types,) * 2)
        return posterior(along, sensor.network(reading, every_row=True), peg, never, config)

    return read(felt)


def judged(
    beliefs: Belief, hole_pos_world: Float[np.ndarray, "n 2"], touch: Int[np.ndarray, "n"]
) -> list[str]:
    """Describe error and coverage after each time."""
    words = []
    for after in AFTER_S:
        at = np.arange(len(touch)), touch + round(10 * after)
        off = np.asarray(beliefs.pos_mean_world)[at] - hole_pos_world
        inverse = np.linalg.inv(np.asarray(beliefs.pos_cov, float)[at])
        inside = np.einsum("ni,nij,nj->n", off, inverse, off) <= INSIDE
        words.append(
            f"{after} s {1000 * np.linalg.norm(off, axis=1).mean():.1f} mm {100 * inside.mean():.0f} %"
        )
    return words


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, metavar="DATA")
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    asked = parser.parse_args()
    main(asked.data, asked.runs)
