"""Figure of a sweep: the main metrics of its experiment by setting, with their intervals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.evaluation.sweep import BETWEEN, MAIN, label
from mjx_fit.report.figures import style

_LABELS = {
    "attempts": "Attempts for all pegs",
    "coverage_90": "Coverage of the 90 % region",
    "intervention_rate": "Human intervention rate",
    "peak_force_n": "Peak force (N)",
    "position_error_cm": "Position error (cm), 1 attempt",
    "seconds": "Seconds",
    "success_rate": "Success rate",
}
_SHARES = {"success_rate", "intervention_rate", "coverage_90"}
_PANEL_IN, _LEAST_IN, _HEIGHT_IN = 2.6, 4.5, 5.2
_SPREAD = 0.3
"""Width that the methods of one setting share; settings are 1 apart."""


@dataclass(frozen=True)
class _Panel:
    """A column of the figure.

    Attributes:
        title: What its settings have in common.
        axis: What they differ in.
        ticks: Value of each.
        names: Name of each setting in the summary.
    """

    title: str
    axis: str
    ticks: tuple[str, ...]
    names: tuple[str, ...]


def of_sweep(result: Result) -> Figure:
    """Draw the metrics of a sweep, a column for each combination of all keys but the first."""
    metrics = MAIN[result.request["of"]]
    panels = _panels(result.request["cells"])
    methods = list(dict.fromkeys(row.method for row in result.summary))
    width = max(_LEAST_IN, 1 + _PANEL_IN * len(panels))
    figure = Figure(figsize=(width, _HEIGHT_IN), layout="constrained")
    axes = figure.subplots(len(metrics), len(panels), sharex="col", sharey="row", squeeze=False)
    for line, (metric, group) in enumerate(metrics):
        for ax, panel in zip(axes[line], panels, strict=True):
            _draw(ax, panel, [row for row in result.summary if row.metric == metric], group, methods)
            ax.set_xticks(range(len(panel.ticks)), panel.ticks)
            ax.set_xlim(-0.5, len(panel.ticks) - 0.5)
            if line == len(metrics) - 1:
                ax.set_xlabel(panel.axis)
            if line == 0:
                ax.set_title(panel.title)
        axes[line, 0].set_ylabel(_label(metric, group))
        axes[line, 0].set_ylim(0, 1.02 if metric in _SHARES else None)
        if metric in _SHARES:
            axes[line, 0].yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    style.legend(figure, style.method_handles(methods))
    return figure


def _label(metric: str, group: str) -> str:
    within = metric == "success_rate" and group.isdecimal()
    return f"Insertion rate, {group} attempts" if within else _LABELS[metric]


def _panels(cells: Sequence[dict[str, Any]]) -> list[_Panel]:
    """Return the columns; settings of other keys are one column, each with its whole name."""
    if len({tuple(cell) for cell in cells}) > 1 or not cells[0]:
        names = tuple(label(cell) for cell in cells)
        return [_Panel("", "", tuple(name.replace(", ", "\n") for name in names), names)]
    first, *others = cells[0]
    found: dict[str, list[dict[str, Any]]] = {}
    for cell in cells:
        found.setdefault(label({key: cell[key] for key in others}) if others else "", []).append(cell)
    return [
        _Panel(
            title,
            first.partition(".")[2],
            tuple(str(cell[first]) for cell in own),
            tuple(label(cell) for cell in own),
        )
        for title, own in found.items()
    ]


def _draw(ax: Axes, panel: _Panel, rows: list[Row], group: str, methods: list[str]) -> None:
    """Draw one metric of each method over the settings of a panel."""
    by_place = {(row.method, row.group): row for row in rows}
    colour, marker = style.colours(methods), style.markers(methods)
    for number, method in enumerate(methods):
        offset = _SPREAD * ((number + 0.5) / len(methods) - 0.5)
        found = [by_place.get((method, f"{name}{BETWEEN}{group}")) for name in panel.names]
        there = [(k + offset, row) for k, row in enumerate(found) if row is not None]
        if there:
            at, own = zip(*there, strict=True)
            style.points(ax, at, own, color=colour[method], marker=marker[method])
