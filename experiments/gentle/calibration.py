"""Judge the belief inside attempts of `seek`: error, coverage and the probability of a match, after 1 to 8 s.

    python experiments/gentle/calibration.py OUT.json [--run RUN] [--trials N] [--seed K]

Half of the holes match the peg. A trial counts as long as its attempt lasts, with the seconds since the first
contact. `matched` and `mismatched` count those holes alone: a matching hole that is still searched for after
8 s is a hard one, and the belief about all holes need not be calibrated for the hard ones.
"""

import argparse
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mjx_fit.config.schema import Config
from mjx_fit.config.worlds import preset
from mjx_fit.data.schedule import draw_places, pair_of
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.statistics import wilson
from mjx_fit.report import script
from mjx_fit.sensors.force_torque import touched
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.task.seek import seek_with
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.types import Belief, Felt, Rollout
from mjx_fit.utils import resources

AFTER_S = (1, 2, 4, 8)
INSIDE = 4.605
"""Quantile of 90 % of the squared distance in two dimensions."""


def main(out: Path, run: Path, trials: int, seed: int) -> None:
    found = {world: judged(world, run, trials, seed) for world in ("home", "forge")}
    script.save(out, {"trials": trials, "seed": seed, "worlds": found})


def judged(world: str, run: Path, trials: int, seed: int) -> dict[str, Any]:
    config = preset("gentle", world)
    config, policy = seek_with(load_trained_sensor(run), config)
    ids = np.arange(trials)
    places = draw_places(jax.random.key(seed), jnp.asarray(ids), config)
    pegs, holes = pair_of(ids, config.scene.n_types)
    where = places.hole_pos_world, places.estimate_world
    done = make_engine("native", config, policy).run(
        spirals_at(pegs, holes, *where, places.key, places.physics)
    )
    begins = first_contact(done.felt, config)
    kinds = {"all": np.ones(trials, bool), "matched": pegs == holes, "mismatched": pegs != holes}
    return {
        f"{after} s": {name: described(done, begins + 10 * after, kind) for name, kind in kinds.items()}
        for after in AFTER_S
    }


def first_contact(felt: Felt, config: Config) -> np.ndarray:
    """Return the first action in contact; attempts without one never last long enough."""
    touches = touched(felt, config.wrist)
    return np.where(touches.any(1), touches.argmax(1), touches.shape[1])


def described(done: Rollout, at: np.ndarray, among: np.ndarray) -> dict[str, Any]:
    """Return error, coverage and match classification of the attempts that last that long."""
    rows = np.flatnonzero(among & (at < done.felt.length) & done.truth.valid)
    if not len(rows):
        return {"n": 0}
    belief: Belief = jax.tree.map(lambda leaf: np.asarray(leaf)[rows, at[rows]], done.report)
    off = belief.pos_mean_world - np.asarray(done.truth.hole_pos_world)[rows]
    squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(np.asarray(belief.pos_cov, float)), off)
    peg = np.asarray(done.felt.peg_type)[rows]
    match = np.exp(np.asarray(belief.type_logp))[np.arange(len(rows)), peg]
    true = np.asarray(done.truth.hole_type)[rows] == peg
    return {
        "n": len(rows),
        "error_mm": float(1000 * np.linalg.norm(off, axis=1).mean()),
        "coverage_90": [*wilson(int((squared <= INSIDE).sum()), len(rows))],
        "match_probability": float(match.mean()),
        "match_share": float(true.mean()),
        "brier": float(np.square(match - true).mean()),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT.json")
    parser.add_argument("--run", type=Path, default=resources.run_folder("gentle"), metavar="RUN")
    parser.add_argument("--trials", type=int, default=1000, metavar="N")
    parser.add_argument("--seed", type=int, default=43, metavar="K")
    asked = parser.parse_args()
    main(asked.out, asked.run, asked.trials, asked.seed)
