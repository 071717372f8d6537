"""Figures of the experiments at one hole, as in the paper, with the figures that it omits."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, PercentFormatter

from mjx_fit.evaluation.results import by_method, number_in
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report.figures import style

Trials = list[dict[str, Any]]


def error_by_attempt(summary: list[Row], kind: str = "") -> Figure:
    """Draw the mean position error before the first attempt and after each, without the oracle (zero).

    Args:
        summary: Rows of a position result.
        kind: Prefix of the groups: empty for mismatched pairs, ``matched:`` for matched ones.
    """
    figure, ax = style.axes()
    lines = {
        name: rows
        for name, rows in _by_number(summary, "position_error_cm", kind).items()
        if name != "oracle"
    }
    _lines(ax, lines)
    ax.set(xlabel="Attempts", ylabel="Position error (cm)", yscale="log")
    style.log_axis(ax.yaxis)
    style.legend(figure, style.method_handles(list(lines)))
    return figure


def errors_spread(trials: Trials) -> Figure:
    """Draw the quantiles of the position error after each attempt, for mismatched pairs.

    Args:
        trials: Rows of a position result.
    """
    figure, ax = style.axes()
    methods = [name for name in by_method(trials) if name != "oracle"]
    colour = style.colours(methods)
    for place, name in enumerate(methods):
        own = [t for t in trials if t["method"] == name and t["pair"][0] != t["pair"][1]]
        if not own:
            continue
        error = np.array([trial["error_cm"] for trial in own])
        at = np.arange(error.shape[1]) + 0.24 * (place - (len(methods) - 1) / 2)
        low, first, middle, third, high = np.quantile(error, [0.05, 0.25, 0.5, 0.75, 0.95], axis=0)
        ax.vlines(at, low, high, color=colour[name], linewidth=1.2)
        ax.vlines(at, first, third, color=colour[name], linewidth=6)
        ax.plot(at, middle, "o", color="white", markeredgecolor=colour[name], markersize=5)
    ax.set(xlabel="Attempts", ylabel="Position error (cm)", yscale="log")
    style.log_axis(ax.yaxis)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    style.legend(
        figure, [Line2D([], [], color=colour[n], linewidth=6, label=style.label(n)) for n in methods]
    )
    return figure


def coverage_by_attempt(summary: list[Row]) -> Figure:
    """Draw the coverage of the 90 % ellipse after each attempt.

    Args:
        summary: Rows of a position result.
    """
    figure = _shares(summary, "coverage_90", "Coverage of the 90 % ellipse")
    figure.axes[0].axhline(0.9, color=style.PAPER_COLOUR, linestyle="--", linewidth=1)
    return figure


def success_by_attempts(summary: list[Row]) -> Figure:
    """Draw the insertion rate within k attempts, as in the paper.

    Args:
        summary: Rows of an insertion result.
    """
    return _shares(summary, "success_rate", "Insertion rate")


def _shares(summary: list[Row], metric: str, ylabel: str) -> Figure:
    figure, ax = style.axes()
    lines = _by_number(summary, metric, "")
    _lines(ax, lines)
    ax.set(xlabel="Attempts", ylabel=ylabel, ylim=(-0.02, 1.04))
    ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    style.legend(figure, style.method_handles(list(lines)))
    return figure


def attempts_saved(summary: list[Row]) -> Figure:
    """Draw the attempts that ``full`` saves compared with each other method, over pairs of trials.

    Args:
        summary: Rows of an insertion result.
    """
    rows = [row for row in summary if row.metric == "attempts_saved"]
    p_values = {row.group: row.value for row in summary if row.metric == "p_value"}
    words = [f"vs. {style.label(row.group)},\np {_p(p_values.get(row.group))}" for row in rows]
    return style.against(rows, words, 0, "Attempts saved")


def _p(value: float | None) -> str:
    if value is None:
        return "unknown"
    return "< 0.001" if value < 0.001 else f"= {value:.2g}"


def _by_number(summary: list[Row], metric: str, kind: str) -> dict[str, dict[int, Row]]:
    """Return the rows of a metric whose groups are numbers after a prefix, by method and number."""
    found: dict[str, dict[int, Row]] = {}
    for row in summary:
        number = number_in(row.group, kind)
        if row.metric == metric and number is not None:
            found.setdefault(row.method, {})[number] = row
    return found


def _lines(ax, lines: dict[str, dict[int, Row]]) -> None:
    colour, marker = style.colours(list(lines)), style.markers(list(lines))
    for name, rows in lines.items():
        style.points(ax, list(rows), list(rows.values()), color=colour[name], marker=marker[name])
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
