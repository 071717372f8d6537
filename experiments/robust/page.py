"""Compare robustness results: print the tables of this page and draw ``robustness.png``.

    python experiments/robust/page.py

Reads those of ``robustness.json``, ``robustness_unrandomised.json`` and ``robustness_before.json`` that
exist.
"""

from pathlib import Path

from mjx_fit.evaluation import results
from mjx_fit.evaluation.robustness import SHOWN
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report import script
from mjx_fit.report.figures import robustness
from mjx_fit.report.figures.robustness import Series

HERE = Path(__file__).parent
SENSORS = {
    "robustness": ("trained on random physics", "#0072B2", "o"),
    "robustness_unrandomised": ("not on random physics", "#E69F00", "s"),
    "robustness_before": ("until November 2026", "#D55E00", "D"),
}
"""Label, colour and marker by result file."""


def main() -> None:
    series = []
    for name, (label, colour, marker) in SENSORS.items():
        if (path := HERE / f"{name}.json").exists():
            summary = results.read(path).summary
            _print(label, summary)
            error = robustness.of_metric(summary, "position_error_mm", SHOWN[0])
            coverage = robustness.of_metric(summary, "coverage_90", SHOWN[-1])
            series.append(Series(label, colour, marker, error, coverage))
    labels = "Position error after one attempt (mm)", "Coverage of the 90 % ellipse after five"
    script.draw(HERE / "robustness.png", lambda: robustness.compared(series, *labels))


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


def _shown(rows: dict[tuple[str, str], Row], metric: str, name: str) -> str:
    return " / ".join(f"{rows[metric, f'{name}:{k}'].value:.2f}" for k in SHOWN)


if __name__ == "__main__":
    main()
