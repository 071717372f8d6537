"""What is known about a second hole before its first touch, with the grasp shared and without.

    python experiments/bench/shared_grasp.py OUT.json [--trials N] [--seed K] [--config FILE.yaml]

A peg visits one hole for at most 10 s with `seek`, which the geometry of contact leads. Then the peg, in the
same grasp, is to go to another hole, of which there is a detection. With the grasp shared
(`mjx_fit.task.shared_grasp`) what was felt at the first hole, which does not match, corrects it.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mjx_fit.config.files import read_config
from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import world_file
from mjx_fit.data.schedule import draw_places, mismatched_pairs
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.place_scores import PlaceScores, score_places
from mjx_fit.evaluation.scores import inside
from mjx_fit.evaluation.statistics import bootstrap_mean
from mjx_fit.filters.updates import detected_belief
from mjx_fit.report import script
from mjx_fit.scene.placement import GRASP, place_for_tool
from mjx_fit.task.after_attempts import last_report
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.task.seek import seek_by_geometry
from mjx_fit.task.shared_grasp import SharedGrasp
from mjx_fit.types import Belief
from mjx_fit.utils import resources
from mjx_fit.utils.randomness import root_key

GRASP_STD_M, GRASP_STD_RAD = 0.0017, 0.03
PART = 50


def main(out: Path, trials: int, seed: int, files: list[Path]) -> None:
    gentle = resources.folder("configs") / "gentle.yaml"
    config = read_config([*world_file("bench"), gentle, *files])
    config = replace(
        config, filter=replace(config.filter, grasp_std_m=GRASP_STD_M, grasp_std_rad=GRASP_STD_RAD)
    )
    engine = make_engine("native", config, seek_by_geometry(config))
    rows = []
    for first in range(0, trials, PART):
        rows += part(np.arange(first, min(first + PART, trials)), seed, config, engine)
        print(f"{len(rows)} of {trials}", flush=True)
    told = {name: described(rows, name) for name in rows[0] if name.startswith("less_")}
    held = {name: float(np.mean([row[name] for row in rows])) for name in rows[0] if name.startswith("in_90")}
    script.save(out, {"seed": seed, "trials": trials, "paired": told, "inside": held, "rows": rows})


def part(ids: np.ndarray, seed: int, config: Config, engine: Any) -> list[dict[str, Any]]:
    """Return a row for each pair of holes."""
    peg, first, second = kinds(ids, config)
    places = [draw_places(root_key(seed, name), jnp.asarray(ids), config) for name in ("first", "second")]
    here, there = (jax.tree.map(np.asarray, replace(place, key=None, later_key=None)) for place in places)
    there = replace(
        there, physics=replace(there.physics, **{name: getattr(here.physics, name) for name in GRASP})
    )
    attempts = spirals_at(
        peg, first, here.hole_pos_world, start_of(here, config), places[0].key, here.physics
    )
    done = engine.run(attempts)
    estimates = np.stack([here.estimate_world, there.estimate_world], 1)
    alone = jax.tree.map(np.asarray, detected_belief(jnp.asarray(estimates), config))
    shared = SharedGrasp(estimates, config)
    everyone = np.arange(len(ids))
    shared.learn(everyone, np.zeros(len(ids), int), last_report(done))
    told = shared.beliefs(alone, np.ones(len(ids), bool))
    true = np.asarray(place_for_tool(there.hole_pos_world, there.physics, config))
    scores = [scored(belief, true, second, config) for belief in (alone, told)]
    z = config.filter.coordinates.index("z")
    heights = [1000 * np.abs(np.asarray(one.mean_world)[:, 1, z] - true[:, z]) for one in (alone, told)]
    return [row_of(scores, heights, i) for i in range(len(ids))]


def kinds(ids: np.ndarray, config: Config) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return peg, first and second hole: the first one does not match, the second one does."""
    pair = mismatched_pairs(config.scene.n_types)[ids % len(mismatched_pairs(config.scene.n_types))]
    return pair[:, 0], pair[:, 1], pair[:, 0]


def start_of(places: Any, config: Config) -> np.ndarray:
    return np.asarray(detected_belief(jnp.asarray(places.estimate_world), config).mean_world)


def scored(belief: Belief, true: np.ndarray, kind: np.ndarray, config: Config) -> PlaceScores:
    mean, cov = np.asarray(belief.mean_world)[:, 1:], np.asarray(belief.cov)[:, 1:]
    return score_places(mean, cov, true[:, None], kind, config)


def row_of(scores: list[PlaceScores], heights_mm: list[np.ndarray], i: int) -> dict[str, float]:
    """Return the errors without and with the grasp shared, and by how much they are smaller."""
    row = {}
    names = ("distance_cm", "turn_deg", "yaw_deg")
    errors = {name: [float(getattr(score, name)[i, 0]) for score in scores] for name in names}
    errors["height_mm"] = [float(height[i]) for height in heights_mm]
    for name, (alone, told) in errors.items():
        row |= {name: alone, f"{name}_shared": told, f"less_{name}": alone - told}
    for name, score in zip(("in_90", "in_90_shared"), scores, strict=True):
        row[name] = float(inside(score.squared[i], 0.9, score.degrees[i : i + 1])[0])
    return row


def described(rows: list[dict[str, float]], name: str) -> dict[str, float]:
    """Return the mean of paired differences, its 95 % interval, and the means of both."""
    interval = bootstrap_mean(np.array([row[name] for row in rows]), range(len(rows)))
    own = name.removeprefix("less_")
    means = {key: float(np.mean([row[key] for row in rows])) for key in (own, f"{own}_shared")}
    return means | {"less": interval.value, "low": interval.low, "high": interval.high}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT.json")
    parser.add_argument("--trials", type=int, default=300, metavar="N")
    parser.add_argument("--seed", type=int, default=1, metavar="K")
    parser.add_argument("--config", type=Path, action="append", default=[], metavar="FILE.yaml")
    asked = parser.parse_args()
    main(asked.out, asked.trials, asked.seed, asked.config)
