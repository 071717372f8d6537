"""Measure the cost of a world after its attempt has ended.

    python experiments/data/finished.py

Half of a batch starts directly above its hole and inserts within a second; the other half never inserts. The
comparison is the other half alone: if finished worlds were free, both would run at the same steps per second.
"""

import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import draw_places, mismatched_pairs
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.report import script
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.utils import process_setup
from mjx_fit.utils.randomness import root_key
from mjx_fit.utils.rates import SUBSTEPS

HALF, ACTIONS, TIMES = 128, 100, 3


def main() -> None:
    config = Config()
    ids = np.arange(2 * HALF)
    easy = ids % 2 == 0
    peg, hole = np.where(easy, ids // 2 % 3, mismatched_pairs(3)[ids // 2 % 6].T)
    places = draw_places(root_key(0, "finished"), jnp.asarray(ids), config)
    estimate = jnp.where(easy[:, None], places.hole_pos_world, places.estimate_world)
    both = spirals_at(peg, hole, places.hole_pos_world, estimate, places.key)
    engine = NativeEngine(config, 2)
    seconds: dict[str, list[float]] = {"both": [], "alone": []}
    steps = {}
    for _ in range(TIMES + 1):  # the first compiles
        for name, active in (("both", None), ("alone", ~easy)):
            began = time.perf_counter()
            done = engine.run(both, ACTIONS, active)
            seconds[name].append(time.perf_counter() - began)
            steps[name] = int(done.felt.length.sum()) * SUBSTEPS
    median = {name: float(np.median(values[1:])) for name, values in seconds.items()}
    speed = {name: steps[name] / median[name] for name in median}
    results = {"seconds": median, "steps": steps, "steps_per_s": speed}
    results |= {"speed_of_both_over_alone": speed["both"] / speed["alone"]}
    script.save(Path(__file__).parent / "finished.json", results)


if __name__ == "__main__":
    process_setup.configure()
    main()
