"""Figures of the robustness experiment."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from mjx_fit.evaluation.statistics import Row
from mjx_fit.report.figures import style

_ATTEMPTS = ((1, style.MATCHED_COLOUR, "o"), (5, style.MISMATCHED_COLOUR, "s"))
_SPREAD = 0.4
"""Height that the series of one perturbation share; perturbations are 1 apart."""


@dataclass(frozen=True)
class Series:
    """Position error and coverage by perturbation, drawn in one colour.

    Attributes:
        label: Label in the legend.
        colour, marker: Colour and marker.
        error_mm, coverage_90: Rows by perturbation.
    """

    label: str
    colour: str
    marker: str
    error_mm: Mapping[str, Row]
    coverage_90: Mapping[str, Row]


def by_perturbation(summary: list[Row]) -> Figure:
    """Draw position error and coverage of the 90 % ellipse by perturbation, after one and five attempts."""
    return compared(
        [
            Series(
                f"after {k} attempt{'s' * (k > 1)}",
                colour,
                marker,
                of_metric(summary, "position_error_mm", k),
                of_metric(summary, "coverage_90", k),
            )
            for k, colour, marker in _ATTEMPTS
        ]
    )


def of_metric(summary: list[Row], metric: str, k: int) -> dict[str, Row]:
    """Return the rows of a metric after k attempts, by perturbation."""
    groups = {row.group: row for row in summary if row.metric == metric}
    return {
        name: row for group, row in groups.items() for name, _, at in [group.partition(":")] if at == str(k)
    }


def compared(
    series: Sequence[Series],
    error_label: str = "Position error (mm)",
    coverage_label: str = "Coverage of the 90 % ellipse",
) -> Figure:
    """Draw the position error (left) and the coverage (right) of several series by perturbation."""
    names = list(dict.fromkeys(name for one in series for name in (*one.error_mm, *one.coverage_90)))
    figure = Figure(figsize=(8.5, 0.7 + 0.27 * len(names)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for number, one in enumerate(series):
        offset = _SPREAD * ((number + 0.5) / len(series) - 0.5)
        for ax, rows in ((left, one.error_mm), (right, one.coverage_90)):
            for name, row in rows.items():
                height = names.index(name) + offset
                if row.low is not None and row.high is not None:
                    ax.plot([row.low, row.high], [height, height], color=one.colour, linewidth=1)
                ax.plot(row.value, height, one.marker, color=one.colour, markersize=4)
    left.set(xlabel=error_label, xscale="log", yticks=range(len(names)), yticklabels=names)
    style.log_axis(left.xaxis)
    left.invert_yaxis()
    right.set(xlabel=coverage_label, xlim=(0, 1.02))
    right.xaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    right.axvline(0.9, color=style.PAPER_COLOUR, linestyle="--", linewidth=1)
    style.legend(
        figure, [Line2D([], [], color=one.colour, marker=one.marker, label=one.label) for one in series]
    )
    return figure
