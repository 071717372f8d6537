"""Show where the largest forces of NIST's pegs come from: when they occur, and what lowers them.

    python experiments/gentle/peaks.py OUT.json [--worlds N]

Attempts without a sensor at home, from within 1.5 mm of the hole per axis; the same draws under each variant.
"""

import argparse
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mjx_fit.config.files import read_config
from mjx_fit.config.part_sets import parts_file
from mjx_fit.data.schedule import draw_places
from mjx_fit.engines.select import make_engine
from mjx_fit.report import script
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.task.seek import seek

HERE = Path(__file__).parent
FILES = [
    *parts_file("nist"),
    HERE / "../../configs/gentle.yaml",
    HERE / "../parts/nist.yaml",
    HERE / "nist.yaml",
]
SLOW_TOUCH, SLOW_SEARCH = "seek.approach_push_m=0.001", "seek.speed_mps=0.005"
VARIANTS = {
    "nist.yaml": [],
    "softer contact": ["scene.contact_time_per_gap=40"],
    "slower touch-down": [SLOW_TOUCH],
    "slower touch-down and search": [SLOW_TOUCH, SLOW_SEARCH],
}
SAMPLE_MS, TOUCH_N, HIGH_N, WITHIN_M = 2, 2.0, 20.0, 0.0015


def forces(worlds: int, settings: list[str]) -> dict[str, Any]:
    """Return medians and shares of one variant."""
    config = read_config(FILES, settings)
    places = draw_places(jax.random.key(5), jnp.arange(worlds), config)
    hole = np.asarray(places.hole_pos_world)
    estimate = hole + np.random.default_rng(0).uniform(-WITHIN_M, WITHIN_M, hole.shape)
    peg = np.arange(worlds) % len(config.scene.shapes)
    attempts = spirals_at(peg, peg, hole, estimate, places.key, places.physics)
    done = make_engine("native", config, seek(config)).run(attempts)
    felt, inserted = done.felt, np.asarray(done.truth.inserted)
    wrench = np.asarray(felt.trace.wrench_sensor) - np.asarray(felt.tare_sensor)[:, None, None]
    norm = np.linalg.norm(wrench[..., :3], axis=-1)
    by_action = norm.max(-1)
    largest, first = by_action.max(1), (by_action > TOUCH_N).argmax(1)
    at_touch = by_action.argmax(1) <= first
    return {
        "n": worlds,
        "inserted": inserted.mean(),
        "median_actions_of_inserted": float(np.median(np.asarray(felt.length)[inserted])),
        "largest_n": {"median": np.median(largest), "max": largest.max()},
        "at_touch_down": {"share": at_touch.mean(), "median_n": np.median(largest[at_touch])},
        "later": {"share": 1 - at_touch.mean(), "median_n": np.median(largest[~at_touch])},
        "ms_over_20n": {"median": SAMPLE_MS * np.median((norm > HIGH_N).sum((1, 2)))},
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT.json")
    parser.add_argument("--worlds", type=int, default=132, metavar="N")
    asked = parser.parse_args()
    script.save(asked.out, {name: forces(asked.worlds, own) for name, own in VARIANTS.items()})
