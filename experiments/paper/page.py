"""Draw the figures of this page and print its table rows, world by world.

    python experiments/paper/page.py [WORLD ...]

Each world has a folder of result files; the figures go there. Default: all of them.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mjx_fit.evaluation import results
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row, bootstrap_mean, bootstrap_ratio
from mjx_fit.report import script
from mjx_fit.report.figures import assembly, effort, single_hole

HERE = Path(__file__).parent
CAP = 30
ALONE = ("assembly_match", "assembly_hard", "assembly_humble", "assembly_full")
"""Results compared with assembly_covariance, or assembly where that was not run, trial by trial."""
GROUPS = {
    "attempt": ("matched", "mismatched"),
    "position": tuple("012345"),
    "insertion": ("1", "3", "10", "all", "no_update", "sample", "frame_by_frame"),
    "assembly": ("1", "all", "failure_only", "failure_position", "perfect_sensor", "oracle"),
}
"""Groups of a summary that are printed, by experiment."""


def main(folder: Path) -> None:
    print(f"\nWorld: {folder.name}")
    found = {path.stem: results.read(path) for path in sorted(folder.glob("*.json")) if _is_result(path)}
    for name, result in found.items():
        _print(name, result)
        if result.experiment == "position":
            _print_paired(result)
        for kind, draw in _figures(result).items():
            script.draw(folder / f"{name}_{kind}.png", draw)
    others = found.get("assembly_covariance", found.get("assembly"))
    for name in ALONE:
        if name in found and others is not None:
            _print_against(name, found[name], others)


def _print_against(name: str, alone: Result, others: Result) -> None:
    """Print the ratio of attempts of a separately run method to each other method in the same trials."""
    for mine, own in results.by_method(alone.trials).items():
        needed = {trial["trial"]: sum(trial["attempts"]) for trial in own}
        for other, rows in results.by_method(others.trials).items():
            theirs = {trial["trial"]: sum(trial["attempts"]) for trial in rows}
            both = sorted(needed.keys() & theirs.keys())
            above, below = (np.array([count[i] for i in both]) for count in (needed, theirs))
            value, low, high = bootstrap_ratio(above, below)
            print(f"| {name}: {mine} / {other} | attempts_ratio | {value:.3f} ({low:.3f} to {high:.3f}) |")


def _is_result(path: Path) -> bool:
    return path.stem.split("_")[0] in GROUPS


def _figures(result: Result) -> dict[str, Callable[[], Figure]]:
    trials, summary = result.trials, result.summary
    of_effort = {
        "seconds": lambda: effort.inserted_by_seconds(trials),
        "forces": lambda: effort.peak_forces(trials),
    }
    if result.experiment == "position":
        return {
            "error": lambda: single_hole.error_by_attempt(summary),
            "coverage": lambda: single_hole.coverage_by_attempt(summary),
        }
    if result.experiment == "insertion":
        return {
            "success": lambda: single_hole.success_by_attempts(summary),
            "saved": lambda: single_hole.attempts_saved(summary),
            **(of_effort if effort.has_effort(trials) else {}),
        }
    if result.experiment == "assembly" and len(result.request["methods"]) > 1:
        return {
            "attempts": lambda: assembly.attempts_histogram(trials),
            "success": lambda: assembly.success_curve(trials, CAP),
            "spent": lambda: assembly.where_attempts_went(trials),
            "ratio": lambda: assembly.attempts_ratio(summary),
            **(of_effort if effort.has_effort(trials) else {}),
        }
    return {}


def _print_paired(result: Result) -> None:
    """Print the error reduction of ``full`` over ``frame_by_frame``, paired by mismatched hole, cm."""
    errors = {
        method: {t["trial"]: t["error_cm"] for t in rows if t["pair"][0] != t["pair"][1]}
        for method, rows in results.by_method(result.trials).items()
    }
    holes = sorted(errors["full"])
    gain = np.array([np.subtract(errors["frame_by_frame"][i], errors["full"][i]) for i in holes])
    for attempt, values in enumerate(gain.T):
        mean, low, high = bootstrap_mean(values, holes)
        print(f"| frame_by_frame - full | error_cm | {attempt} | {mean:.3f} ({low:.3f} to {high:.3f}) |")


def _print(name: str, result: Result) -> None:
    print(f"\n{name}: seed {result.seed}, {result.engine}, {result.device}")
    for row in result.summary:
        if row.group in GROUPS[result.experiment] or row.group.startswith("matched:"):
            print(f"| {row.method} | {row.metric} | {row.group} | {_words(row)} | {row.n} |")


def _words(row: Row) -> str:
    ends = "" if row.low is None else f" ({row.low:.4g} to {row.high:.4g})"
    return f"{row.value:.4g}{ends}"


if __name__ == "__main__":
    for world in sys.argv[1:] or sorted(path.name for path in HERE.iterdir() if any(path.glob("*.json"))):
        main(HERE / world)
