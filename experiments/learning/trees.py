"""Measure the accuracy of tree ensembles on hand-made features of the same traces.

    python experiments/learning/trees.py TRAINING TEST     requires scikit-learn: pip install -e '.[bench]'

Both data sets hold spirals; only failed first attempts are used. One forest per peg predicts the hole
position, another the match.
"""

import sys
import time
from pathlib import Path

import numpy as np
import shared
from jaxtyping import Float
from sklearn.ensemble import ExtraTreesClassifier, ExtraTreesRegressor  # pyright: ignore[reportMissingImports]

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.evaluation.scores import auroc
from mjx_fit.report import script
from mjx_fit.types import Reading
from mjx_fit.utils import process_setup

NAMES = SceneConfig().names
N_TYPES = len(NAMES)

BINS = 10
TREES = {"min_samples_leaf": 2, "max_features": 0.3, "n_jobs": 2, "random_state": 0}


def main(training: Path, test: Path) -> None:
    train, held_out = (shared.shown(shared.first_attempts(folder)) for folder in (training, test))
    x, x_test = features(train.reading), features(held_out.reading)
    error, score = np.zeros(len(x_test)), np.zeros(len(x_test))
    began = time.perf_counter()
    for peg in range(N_TYPES):
        own, own_test = train.peg == peg, held_out.peg == peg
        where = ExtraTreesRegressor(200, **TREES).fit(x[own], train.offset_cm[own])
        error[own_test] = np.linalg.norm(
            where.predict(x_test[own_test]) - held_out.offset_cm[own_test], axis=1
        )
        which = ExtraTreesClassifier(300, **TREES).fit(x[own], train.hole[own] == peg)
        score[own_test] = which.predict_proba(x_test[own_test])[:, 1]
    matched = held_out.peg == held_out.hole
    pairs = {}
    for peg, hole in ((p, h) for p in range(N_TYPES) for h in range(N_TYPES) if p != h):
        chosen = (held_out.peg == peg) & (matched | (held_out.hole == hole))
        pairs[f"{NAMES[peg]}:{NAMES[hole]}"] = auroc(score[chosen], matched[chosen])
    script.save(
        Path(__file__).parent / "trees.json",
        {
            "n_training": len(x),
            "n": len(x_test),
            "features": x.shape[1],
            "position_error_cm": shared.mean_of(error),
            "position_error_cm_mismatched": shared.mean_of(error[~matched]),
            "match_auroc": auroc(score, matched),
            "match_auroc_pairs": pairs,
            "seconds": time.perf_counter() - began,
        },
    )


def features(reading: Reading) -> Float[np.ndarray, "n k"]:
    """Compute means and extremes over tenths of an attempt, and positions at the overall extremes."""
    wrench = reading.wrench_sensor
    mean = wrench.mean(2)
    place = reading.tip_pos_estimate
    pressed = place[..., :2] + reading.pressure_tip
    channels = np.concatenate(
        [
            mean,
            wrench.std(2),
            wrench.max(2),
            wrench.min(2),
            place,
            reading.tip_quat_world[..., 1:],
            reading.tip_linvel_world,
            reading.pressure_tip,
            pressed,
        ],
        axis=-1,
    )
    n, actions, k = channels.shape
    binned = channels.reshape(n, BINS, actions // BINS, k)
    columns = [part.reshape(n, -1) for part in (binned.mean(2), binned.max(2), binned.min(2))]
    extremes = np.concatenate([mean, reading.pressure_tip, place[..., 2:]], axis=-1)
    for when in (extremes.argmax(1), extremes.argmin(1)):
        rows = np.arange(n)[:, None]
        columns += [place[rows, when].reshape(n, -1), pressed[rows, when].reshape(n, -1)]
        columns += [np.take_along_axis(extremes, when[:, None], axis=1)[:, 0]]
    return np.concatenate(columns, axis=1)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(f"usage: python {sys.argv[0]} TRAINING TEST")
    process_setup.configure()
    main(Path(sys.argv[1]), Path(sys.argv[2]))
