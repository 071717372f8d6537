"""Figures of the robustness experiment."""

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from mjx_fit.evaluation.statistics import Row
from mjx_fit.report.figures import style

_ATTEMPTS = ((1, style.MATCHED_COLOUR, "o"), (5, style.MISMATCHED_COLOUR, "s"))


def by_perturbation(summary: list[Row]) -> Figure:
    """Draw position error and coverage of the 90 % ellipse by perturbation, after one and five attempts."""
    rows = {(row.metric, row.group): row for row in summary}
    names = list(dict.fromkeys(group.partition(":")[0] for metric, group in rows if metric == "nees"))
    figure = Figure(figsize=(8.5, 0.7 + 0.27 * len(names)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for ax, metric in ((left, "position_error_mm"), (right, "coverage_90")):
        for number, (k, colour, marker) in enumerate(_ATTEMPTS):
            for place, name in enumerate(names):
                row = rows.get((metric, f"{name}:{k}"))
                if row is None:
                    continue
                height = place + 0.2 * (number - 0.5)
                if row.low is not None and row.high is not None:
                    ax.plot([row.low, row.high], [height, height], color=colour, linewidth=1)
                ax.plot(row.value, height, marker, color=colour, markersize=4)
    left.set(xlabel="Position error (mm)", xscale="log", yticks=range(len(names)), yticklabels=names)
    style.log_axis(left.xaxis)
    left.invert_yaxis()
    right.set(xlabel="Coverage of the 90 % ellipse", xlim=(0, 1.02))
    right.xaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    right.axvline(0.9, color=style.PAPER_COLOUR, linestyle="--", linewidth=1)
    handles = [
        Line2D([], [], color=colour, marker=marker, label=f"after {k} attempt{'s' * (k > 1)}")
        for k, colour, marker in _ATTEMPTS
    ]
    style.legend(figure, handles)
    return figure
