"""When should a visit end? Limits of its time, compared on attempts of their own.

    python experiments/gentle/visits.py OUT.json [--seed K] [--repeats N]

Runs visits of 10 s of `seek` at 150 matching holes, N of each. A trial with a limit is then a chain of drawn
visits of its hole, each cut off there, until one is in: visits start from the detection, so that they do not
depend on each other. `misled` tells of the visits that fail: how far off the belief is at their end, and the
distance of the detection.
"""

import argparse
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.config.worlds import preset
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.insertion import draw_holes
from mjx_fit.report import script
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.task.seek import seek_with
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.types import Rollout
from mjx_fit.utils import resources
from mjx_fit.utils.rates import ACTION_S

DRAWS, LIMITS_S, CHAINS, MOST_VISITS = 150, (3, 4, 5, 6, 8, 10), 40, 30


def main(out: Path, seed: int, repeats: int) -> None:
    found = {}
    for world in ("home", "forge"):
        done = visits(world, seed, repeats)
        taken = np.asarray(done.felt.length).reshape(DRAWS, repeats) * ACTION_S
        inserted = np.asarray(done.truth.inserted).reshape(DRAWS, repeats)
        limits = {f"{limit} s": chained(taken, inserted, limit) for limit in LIMITS_S}
        found[world] = {"inserted": float(inserted.mean()), "limits": limits, "misled": misled(done)}
    script.save(out, {"seed": seed, "repeats": repeats, "worlds": found})


def visits(world: str, seed: int, repeats: int) -> Rollout:
    """Simulate one visit for each repetition of each draw."""
    config = preset("gentle", world)
    config, policy = seek_with(load_trained_sensor(resources.run_folder("gentle")), config)
    drawn = draw_holes(config, np.arange(DRAWS), 1, seed)
    places = drawn.hole_pos_world, drawn.estimate_world
    both = (drawn.peg_type, drawn.hole_type), places, drawn.physics
    repeated = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf), repeats, 0), both)
    (peg, kind), (at, estimate), physics = repeated
    keys = jax.random.split(jax.random.key(seed), DRAWS * repeats)
    return make_engine("native", config, policy).run(spirals_at(peg, kind, at, estimate, keys, physics))


def chained(
    taken_s: Float[np.ndarray, "draws n"], inserted: Bool[np.ndarray, "draws n"], limit_s: float
) -> dict[str, float]:
    """Return median and mean seconds, and shares in time, of chains of visits with a limit."""
    rng, draws = np.random.default_rng(0), np.arange(len(taken_s))
    inserted = inserted & (taken_s <= limit_s + 1e-6)
    taken_s = np.minimum(taken_s, limit_s)
    total, done = np.zeros((CHAINS * taken_s.shape[1], len(draws))), False
    for _ in range(MOST_VISITS):
        one = draws, rng.integers(0, taken_s.shape[1], total.shape)
        total, done = total + ~np.asarray(done) * taken_s[one], done | inserted[one]
    total = np.where(done, total, np.inf)
    shares = {f"in_by_{within}s": float((total <= within + 1e-6).mean()) for within in (5, 10, 30)}
    return {"median_s": float(np.median(total)), **shares}


def misled(done: Rollout) -> dict[str, Any]:
    """Describe the failed visits, and how many fail by the distance of the detection."""
    hole, failed = np.asarray(done.truth.hole_pos_world), ~np.asarray(done.truth.inserted)
    last = np.arange(len(hole)), np.asarray(done.felt.length) - 1
    off = 1000 * np.linalg.norm(np.asarray(done.report.pos_mean_world)[last] - hole, axis=1)
    detected = 1000 * np.linalg.norm(np.asarray(done.felt.estimate_world) - hole, axis=1)
    bins = [(0, 8), (8, 14), (14, 20), (20, 29)]
    within = [(detected >= low) & (detected < high) for low, high in bins]
    return {
        "failed": int(failed.sum()),
        "belief_off_mm": [float(x) for x in np.quantile(off[failed], (0.25, 0.5, 0.75))],
        "failed_by_detection": {
            f"{low} to {high} mm": [int(failed[own].sum()), int(own.sum())]
            for (low, high), own in zip(bins, within, strict=True)
        },
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT.json")
    parser.add_argument("--seed", type=int, default=2, metavar="K")
    parser.add_argument("--repeats", type=int, default=6, metavar="N")
    asked = parser.parse_args()
    main(asked.out, asked.seed, asked.repeats)
