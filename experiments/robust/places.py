"""Measure single readings of the weights that ship by place: where are they wrong, and sure of it?

    python experiments/robust/places.py

Spirals in the world ``home`` start at chosen distances from the hole along x and y, to either side. A reading
is *wrong and sure* if its squared Mahalanobis distance exceeds 20; it points *away* if it puts the hole at
least 3 mm further from where it is than the start was.
"""

from itertools import permutations, product
from pathlib import Path

import jax
import numpy as np

from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import draw_places
from mjx_fit.engines.interface import Engine
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.scores import squared_mahalanobis
from mjx_fit.report import script
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.task.attempt_loop import spirals_at
from mjx_fit.task.estimator import readings
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.utils import process_setup, resources
from mjx_fit.utils.randomness import root_key

PLACES_MM = ((10, 20), (20, 10), (0, 22), (22, 0), (16, 16))
ATTEMPTS, SURE, AWAY_MM, MM_PER_M = 128, 20.0, 3.0, 1000.0


def main() -> None:
    config = Config()
    network = load_trained_sensor(resources.folder("weights")).network
    engine = make_engine("native", config)
    names = [shape.name for shape in config.scene.shapes]
    results: dict[str, object] = {"attempts": ATTEMPTS}
    for (peg, hole), place in product(permutations(range(len(names)), 2), PLACES_MM):
        key = f"{names[peg]} in {names[hole]}, {place[0]} and {place[1]} mm"
        results[key] = _scores(network, engine, config, (peg, hole), np.array(place) / MM_PER_M)
    script.save(Path(__file__).with_suffix(".json"), results)


def _scores(
    network: ContactSensor, engine: Engine, config: Config, pair: tuple[int, int], place_m: np.ndarray
) -> dict[str, float]:
    ids, root = np.arange(ATTEMPTS), root_key(0, "places")
    drawn = draw_places(root, ids, config)
    off = place_m * np.random.default_rng(0).choice([-1, 1], (ATTEMPTS, 2))
    peg, hole = (np.full(ATTEMPTS, kind) for kind in pair)
    start = np.asarray(drawn.hole_pos_world) + off
    attempts = spirals_at(peg, hole, drawn.hole_pos_world, start, drawn.key, drawn.physics)
    felt = engine.run(attempts).felt
    seen = jax.jit(lambda felt, keys: network(readings(felt, keys, config)))(
        felt, jax.random.split(root, ATTEMPTS)
    )
    wrong = np.asarray(seen.innovation) + off
    squared = np.asarray(squared_mahalanobis(wrong, seen.pos_noise_cov))
    error_mm = MM_PER_M * np.linalg.norm(wrong, axis=1)
    return {
        "error_mm": round(float(error_mm.mean()), 2),
        "wrong_and_sure": round(float(np.mean(squared > SURE)), 3),
        "away": round(float(np.mean(error_mm > MM_PER_M * np.linalg.norm(place_m) + AWAY_MM)), 3),
    }


if __name__ == "__main__":
    process_setup.configure()
    main()
