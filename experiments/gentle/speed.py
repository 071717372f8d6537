"""Speed of `seek` with its sensor in the loop, beside the open-loop spiral: simulated seconds per second.

    python experiments/gentle/speed.py OUT.json [--run RUN] [--worlds N] [--repeats K]

The engines take turns in one process, after a run of each that compiles. Holes do not match, so that every
attempt lasts 10 s. `search` is the same search without a sensor: the rest of the difference is the sensor's.
"""

import argparse
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from mjx_fit.config.worlds import preset
from mjx_fit.data.schedule import draw_places
from mjx_fit.engines.select import make_engine
from mjx_fit.report import script
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.task.seek import seek, seek_with
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.utils import resources
from mjx_fit.utils.rates import ACTION_S


def main(out: Path, run: Path, worlds: int, repeats: int) -> None:
    config = preset("gentle")
    adapted, with_sensor = seek_with(load_trained_sensor(run), config)
    engines = {
        "spiral": make_engine("native", config),
        "search": make_engine("native", config, seek(config)),
        "seek": make_engine("native", adapted, with_sensor),
    }
    places = draw_places(jax.random.key(1), jnp.arange(worlds), config)
    peg = np.arange(worlds) % 3
    where = places.hole_pos_world, places.estimate_world
    attempts = spirals_at(peg, (peg + 1) % 3, *where, places.key, places.physics)
    for engine in engines.values():
        engine.run(attempts, 2, horizon=config.task.attempt_actions)
    rates: dict[str, list[float]] = {name: [] for name in engines}
    for _ in range(repeats):
        for name, engine in engines.items():
            began = time.perf_counter()
            done = engine.run(attempts)
            seconds = float(np.sum(done.felt.length)) * ACTION_S
            rates[name].append(seconds / (time.perf_counter() - began))
    ratio = {name: np.divide(own, rates["spiral"]) for name, own in rates.items()}
    script.save(
        out,
        {
            "worlds": worlds,
            "simulated_s_per_s": rates,
            "median_ratio_to_spiral": {name: float(np.median(own)) for name, own in ratio.items()},
            "ratios": ratio,
        },
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT.json")
    parser.add_argument("--run", type=Path, default=resources.run_folder("gentle"), metavar="RUN")
    parser.add_argument("--worlds", type=int, default=128, metavar="N")
    parser.add_argument("--repeats", type=int, default=3, metavar="K")
    asked = parser.parse_args()
    main(asked.out, asked.run, asked.worlds, asked.repeats)
