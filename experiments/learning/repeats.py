"""Check whether repeated measurements at the same hole have independent errors.

    python experiments/learning/repeats.py SEQUENCES RUN

SEQUENCES was collected with ``--run RUN --sequence 5``. The Kalman filter assumes that the errors of the
observations are independent with covariance R. Whitened by R they must have variance 1 at every attempt
(``nees``: mean over both axes) and no correlation between consecutive attempts at a hole.
"""

import sys
from pathlib import Path

import numpy as np
import shared
from jaxtyping import Float
from scipy.stats import bootstrap, rankdata

from mjx_fit.data import reader
from mjx_fit.evaluation import held_out
from mjx_fit.report import script
from mjx_fit.training.checkpoint import load_sensor
from mjx_fit.utils import process_setup


def main(sequences: Path, run: Path) -> None:
    sensor, config = load_sensor(run)
    data = reader.load(sequences)
    ids = held_out.failed_attempts(data, shared.ACTIONS)
    seen = held_out.observe(sensor, data, ids, shared.ACTIONS, config, seed=0)
    rollout = data.rollout
    truth = np.asarray(rollout.truth.hole_pos_world - rollout.felt.estimate_world, float)[ids]
    factor = np.linalg.cholesky(np.asarray(seen.pos_noise_cov, float))
    error = np.linalg.solve(factor, (truth - np.asarray(seen.innovation, float))[..., None])[..., 0]
    number, sequence = np.asarray(data.number)[ids], np.asarray(data.sequence)[ids]
    attempts = [dict(zip(sequence[number == k], error[number == k], strict=True)) for k in range(5)]
    script.save(
        Path(__file__).parent / "repeats.json",
        {
            "nees": {str(k + 1): _nees(np.array([*of.values()])) for k, of in enumerate(attempts)},
            "correlation": {
                f"{k}, {k + 1}": _correlation(*_both(attempts[k - 1], attempts[k])) for k in range(1, 5)
            },
        },
    )


def _both(first: dict, second: dict) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Return the errors at holes where both attempts failed, with one row per hole."""
    holes = [hole for hole in first if hole in second]
    return np.array([first[hole] for hole in holes]), np.array([second[hole] for hole in holes])


def _nees(error: Float[np.ndarray, "n 2"]) -> dict[str, float]:
    """Compute mean, interval and, since outliers dominate these, the median ratio to χ²'s 1.386."""
    squared = np.sum(error**2, axis=1)
    return shared.mean_of(squared / 2) | {"median_ratio": float(np.median(squared) / (2 * np.log(2)))}


def _correlation(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> dict[str, float]:
    """Compute the rank correlation of the errors, averaged over both axes, with bootstrap over holes."""

    def both_axes(ax, ay, bx, by) -> float:
        return (_ranked(ax, bx) + _ranked(ay, by)) / 2

    columns = (*a.T, *b.T)
    interval = bootstrap(
        columns, both_axes, paired=True, vectorized=False, n_resamples=1000, method="percentile", rng=0
    ).confidence_interval
    return {"value": both_axes(*columns), "low": interval.low, "high": interval.high, "n": len(a)}


def _ranked(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> float:
    return float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(f"usage: python {sys.argv[0]} SEQUENCES RUN")
    process_setup.configure()
    main(*map(Path, sys.argv[1:]))
