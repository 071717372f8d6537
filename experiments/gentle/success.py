"""Tell insertions by what a robot measures, and compare with the truth: precision and recall.

    python experiments/gentle/success.py OUT.json [--run RUN] [--trials N]

A robot takes a peg for inserted when its measured depth below the plate reaches the insertion depth less
0.5 mm; an attempt starts 2 mm above the plate. Half of the holes match. With a sensor, the parts are the
paper's and the search is `seek`; NIST's parts are searched for without one, from estimates 1 mm off.
"""

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import world_file
from mjx_fit.data.schedule import draw_places, pair_of
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.statistics import wilson
from mjx_fit.report import script
from mjx_fit.scene.parts import START_HEIGHT_M
from mjx_fit.sensors.reading import Window, read_window
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.task.seek import seek, seek_with
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.types import Rollout
from mjx_fit.utils import resources

MARGIN_M = 0.0005
SEED = 41


def main(out: Path, run: Path | None, trials: int) -> None:
    found = {}
    for world in ("home", "forge"):
        if run is not None:
            found[f"paper, {world}"] = told(config_of(world, None), trials, run)
        found[f"nist, {world}"] = told(config_of(world, "nist"), trials, None)
    script.save(out, {"trials": trials, "worlds": found})


def config_of(world: str, parts: str | None) -> Config:
    return read_config(
        [*world_file(world), *parts_file(parts), resources.folder("configs") / "gentle.yaml"], []
    )


def told(config: Config, trials: int, run: Path | None) -> dict[str, Any]:
    """Simulate attempts and judge each by its measurements and by the truth."""
    if run is None:
        policy = seek(config)
    else:
        config, policy = seek_with(load_trained_sensor(run), config)
    ids = np.arange(trials)
    places = draw_places(jax.random.key(SEED), jnp.asarray(ids), config)
    start = places.estimate_world
    if run is None:
        start = places.hole_pos_world + 0.001 * jax.random.normal(jax.random.key(SEED), (trials, 2))
    pegs, holes = pair_of(ids, config.scene.n_types)
    attempts = spirals_at(pegs, holes, places.hole_pos_world, start, places.key, places.physics)
    done = make_engine("native", config, policy).run(attempts)
    taken = np.asarray(depths_m(done, config)) >= config.task.insertion_depth_m - MARGIN_M
    valid = np.asarray(done.truth.valid)
    return judged(taken[valid], np.asarray(done.truth.inserted)[valid])


@partial(jax.jit, static_argnames="config")
def depths_m(done: Rollout, config: Config) -> jax.Array:
    """Return the measured depth at the end of each attempt below where the plate is believed to be, m."""
    config = replace(config, sensor=replace(config.sensor, pose="start"))
    rows = done.felt.trace.action_world.shape[1]
    keys = jax.random.split(jax.random.key(SEED + 1), len(done.felt.length))
    reading = jax.vmap(lambda felt, key: read_window(felt, key, config, Window(rows)))(done.felt, keys)
    last = jnp.maximum(done.felt.length - 1, 0)[:, None]
    return -START_HEIGHT_M - jnp.take_along_axis(reading.tip_pos_estimate[..., 2], last, 1)[:, 0]


def judged(taken: np.ndarray, inserted: np.ndarray) -> dict[str, Any]:
    """Return precision and recall with their Wilson intervals."""
    both = int((taken & inserted).sum())
    rates = {"precision": (both, int(taken.sum())), "recall": (both, int(inserted.sum()))}
    counts = {name: int(leaf.sum()) for name, leaf in (("taken", taken), ("inserted", inserted))}
    return counts | {name: [*wilson(*pair)] for name, pair in rates.items()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT.json")
    parser.add_argument("--run", type=Path, default=resources.run_folder("gentle"), metavar="RUN")
    parser.add_argument("--trials", type=int, default=1000, metavar="N")
    asked = parser.parse_args()
    main(asked.out, asked.run, asked.trials)
