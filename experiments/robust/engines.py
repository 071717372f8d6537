"""Compare what the weights that ship read in both engines: single spirals in the world ``home``.

    python experiments/robust/engines.py

The same attempts run in C, and in MJX with several numbers of contact slots. Errors and the share of holes in
the 90 % ellipse are those of failed attempts; ``torque_nm`` is the mean torque across the tool's axis.
"""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from mjx_fit.config.schema import Config
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.scores import inside, squared_mahalanobis
from mjx_fit.report import script
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.task.estimator import readings
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.types import Attempt, Rollout
from mjx_fit.utils import process_setup, resources

ATTEMPTS, SEEDS, SLOTS = 256, (3, 4), (8, 24)
MM_PER_M = 1000.0


def main() -> None:
    config, network = Config(), load_trained_sensor(resources.folder("weights")).network
    engines = {"native": make_engine("native", config)}
    for slots in SLOTS:
        few = replace(config, scene=replace(config.scene, max_contacts=slots))
        engines[f"mjx, {slots} slots"] = make_engine("mjx", few)
    results: dict[str, object] = {"attempts": ATTEMPTS}
    for seed in SEEDS:
        attempts = draw_attempts(jax.random.key(seed), np.arange(ATTEMPTS), policy="spiral", config=config)
        for name, engine in engines.items():
            results[f"{name}, seed {seed}"] = _scores(network, engine.run(attempts), attempts, config)
    script.save(Path(__file__).with_suffix(".json"), results)


def _scores(network: ContactSensor, done: Rollout, attempts: Attempt, config: Config) -> dict[str, float]:
    keys = jax.random.split(jax.random.key(1), ATTEMPTS)
    seen = jax.jit(lambda felt, keys: network(readings(felt, keys, config)))(done.felt, keys)
    failed = np.asarray(done.truth.failed)
    placed = np.asarray(attempts.estimate_world) + np.asarray(seen.innovation)
    wrong = (placed - np.asarray(attempts.hole_pos_world))[failed]
    squared = squared_mahalanobis(wrong, np.asarray(seen.pos_noise_cov)[failed])
    torque = (np.asarray(done.felt.trace.wrench_sensor) - np.asarray(done.felt.tare_sensor)[:, None, None])[
        failed, ..., 3:5
    ]
    return {
        "failed": int(failed.sum()),
        "error_mm": round(MM_PER_M * float(np.linalg.norm(wrong, axis=1).mean()), 2),
        "coverage_90": round(float(inside(squared, 0.9).mean()), 3),
        "nees": round(float(squared.mean() / 2), 2),
        "torque_nm": round(float(np.nanmean(np.linalg.norm(torque, axis=-1))), 4),
    }


if __name__ == "__main__":
    process_setup.configure()
    main()
