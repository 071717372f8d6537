"""Show what is believed about a place after each visit: errors, calibration and insertions.

    python experiments/bench/places.py FILE.json ...

Files are results of ``mjx-fit evaluate position`` whose belief has six coordinates; their holes are taken
together. Visits to holes that the peg is in no longer count.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from mjx_fit.evaluation import results
from mjx_fit.evaluation.robustness import run_away
from mjx_fit.evaluation.scores import inside
from mjx_fit.filters.kalman import CM_PER_M

HEAD = (
    "visits", "open", "place, mm: median (90 % below)", "yaw, °: median (90 % below)",
    "all rotations, °", "in the 50 % region", "in the 90 % region", "NEES", "largest squared distance",
    "matching pegs in",
)  # fmt: skip
MM_PER_CM = 1000 / CM_PER_M


def main(files: list[Path]) -> None:
    together = [trial for file in files for trial in results.read(file).trials]
    for method, trials in results.by_method(together).items():
        astray = runaways(trials)
        print(f"{method}: {len(trials)} holes, {astray} beliefs run away\n")
        print("| " + " | ".join(HEAD) + " |\n" + "|---" * len(HEAD) + "|")
        for row in described(trials):
            print("| " + " | ".join(row) + " |")


def runaways(trials: list[dict[str, Any]]) -> int:
    error = np.array([trial["error_cm"] for trial in trials])
    squared = np.array([trial["squared_mahalanobis"] for trial in trials])
    return int(run_away(error[:, 1:], squared[:, 1:]).sum())


def described(trials: list[dict[str, Any]]) -> list[list[str]]:
    """Return the cells of each number of visits."""
    error = MM_PER_CM * np.array([trial["error_cm"] for trial in trials])
    turn = np.array([trial["turn_deg"] for trial in trials])
    yaw = np.array([trial.get("yaw_deg", [np.nan] * error.shape[1]) for trial in trials])
    squared = np.array([trial["squared_mahalanobis"] for trial in trials])
    degrees = np.array([trial.get("degrees", 2) for trial in trials])
    matched = np.array([trial["pair"][0] == trial["pair"][1] for trial in trials])
    inserted = np.array([trial["inserted_at"] or np.inf for trial in trials])
    rows = []
    for k in range(error.shape[1]):
        left = inserted > k
        held = [inside(squared[left, k], level, degrees[left]).mean() for level in (0.5, 0.9)]
        rows.append([
            f"{k}", f"{left.sum()}", _spread(error[left, k]), _spread(yaw[left, k]),
            f"{np.median(turn[left, k]):.1f}", *[f"{100 * share:.0f} %" for share in held],
            f"{(squared[left, k] / degrees[left]).mean():.2f}", f"{squared[left, k].max():.0f}",
            f"{100 * (inserted[matched] <= k).mean():.0f} %",
        ])  # fmt: skip
    return rows


def _spread(values: np.ndarray) -> str:
    return f"{np.nanmedian(values):.1f} ({np.nanquantile(values, 0.9):.1f})"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE.json")
    main(parser.parse_args().files)
