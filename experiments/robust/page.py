"""Compare robustness results: print the tables of this page and draw ``robustness.png``.

    python experiments/robust/page.py

Reads those of ``robustness.json``, ``robustness_unrandomised.json`` and ``robustness_before.json`` that
exist, and ``robustness_2000.json``; ``robustness_other_engine.json`` replaces a row of the first. Values by
attempt, by distance and of single holes come from the trials.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from mjx_fit.evaluation import results
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.robustness import SHOWN, run_away
from mjx_fit.evaluation.scores import inside
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report import script
from mjx_fit.report.figures import robustness
from mjx_fit.report.figures.robustness import Series

HERE = Path(__file__).parent
SENSORS = {
    "robustness": ("trained on random physics", "#0072B2", "o"),
    "robustness_unrandomised": ("trained without randomisation", "#E69F00", "s"),
    "robustness_before": ("until November 2026", "#D55E00", "D"),
}
"""Label, colour and marker by result file."""
DISTANCES_CM = (0.0, 0.8, 1.2, 1.6, 2.0, 2.4, 2.9)
"""Bounds of the classes of starts, by distance from the hole."""


def main() -> None:
    series = []
    for name, (label, colour, marker) in SENSORS.items():
        if (path := HERE / f"{name}.json").exists():
            result = results.read(path)
            if name == "robustness":
                result = _with_rows_of(result, results.read(HERE / "robustness_other_engine.json"))
            summary = result.summary
            _print(label, summary)
            _print_trials(result)
            error = robustness.of_metric(summary, "position_error_mm", SHOWN[0])
            coverage = robustness.of_metric(summary, "coverage_90", SHOWN[-1])
            series.append(Series(label, colour, marker, error, coverage))
    _print_trials(results.read(HERE / "robustness_2000.json"))
    labels = "Position error after one attempt (mm)", "Coverage of the 90 % ellipse after five"
    script.draw(HERE / "robustness.png", lambda: robustness.compared(series, *labels))


def _with_rows_of(result: Result, newer: Result) -> Result:
    """Replace the perturbations of a result that another one has measured again."""
    again = {trial["perturbation"] for trial in newer.trials}
    rows = [row for row in result.summary if row.group.partition(":")[0] not in again]
    trials = [trial for trial in result.trials if trial["perturbation"] not in again]
    return replace(result, summary=rows + newer.summary, trials=trials + newer.trials)


def _print(label: str, summary: list[Row]) -> None:
    """Print a row for each perturbation: scores after 1, 2 and 5 attempts, and the holes that run away."""
    print(f"\n{label}: error, mm | of home after 1 | 90 % ellipse | NEES | AUROC after 1 | run away")
    rows = {(row.metric, row.group): row for row in summary}
    home = rows["position_error_mm", "home:1"].value
    for name in robustness.of_metric(summary, "nees", SHOWN[0]):
        away, auroc = rows["runaway", name], rows.get(("match_auroc", f"{name}:1"))
        cells = (
            _shown(rows, "position_error_mm", name),
            f"{rows['position_error_mm', f'{name}:1'].value / home:.2f}",
            _shown(rows, "coverage_90", name),
            _shown(rows, "nees", name),
            "-" if auroc is None else f"{auroc.value:.3f}",
            f"{round(away.value * away.n)} of {away.n}",
        )
        print(f"| `{name}` | {' | '.join(cells)} |")


def _print_trials(result: Result) -> None:
    """Print coverage by attempt, error by distance of the start, and holes that run away."""
    mismatched = [trial for trial in result.trials if trial["pair"][0] != trial["pair"][1]]
    for name in dict.fromkeys(trial["perturbation"] for trial in mismatched):
        own = [trial for trial in mismatched if trial["perturbation"] == name]
        error = np.array([trial["error_cm"] for trial in own])
        squared = np.array([trial["squared_mahalanobis"] for trial in own])
        covered = " / ".join(f"{share:.3f}" for share in inside(squared[:, 1:], 0.9).mean(0))
        place = np.digitize(error[:, 0], DISTANCES_CM)
        far = ", ".join(
            f"{DISTANCES_CM[i - 1]} to {DISTANCES_CM[i]} cm {10 * error[place == i, 1].mean():.1f} mm"
            for i in np.unique(place)
        )
        print(f"{name}: 90 % ellipse by attempt {covered}; error after one attempt by start: {far}")
        for i in np.flatnonzero(run_away(error[:, 1:], squared[:, 1:])):
            pair = " in ".join(own[i]["pair"])
            print(f"  runs away: trial {own[i]['trial']}, {pair}, errors in cm {error[i].tolist()}")
            print(f"    squared Mahalanobis distances {squared[i].tolist()}")


def _shown(rows: dict[tuple[str, str], Row], metric: str, name: str) -> str:
    return " / ".join(f"{rows[metric, f'{name}:{k}'].value:.2f}" for k in SHOWN)


if __name__ == "__main__":
    main()
