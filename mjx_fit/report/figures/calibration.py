"""Figures of the calibration experiment: information in one attempt, and calibration of the posterior."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from mjx_fit.evaluation.results import number_in
from mjx_fit.evaluation.scores import inside, reliability
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report.figures import style

Trials = list[dict[str, Any]]

LEVELS = np.linspace(0.05, 0.95, 19)
HEADED = 45.0
"""Rotation of the names of pairs, in degrees."""
MOST_PAIRS = 12
"""Most pairs on one axis; more are drawn as a matrix."""


def error_by_actions(summary: list[Row]) -> Figure:
    """Draw the mean position error after one update from part of an attempt, by number of actions used."""
    figure, ax = style.axes()
    methods = [name for name in ("full", "frame_by_frame") if _by_actions(summary, name)]
    colour, marker = style.colours(methods), style.markers(methods)
    for name in methods:
        points = _by_actions(summary, name)
        actions = sorted(points)
        rows = [points[count] for count in actions]
        style.points(ax, actions, rows, color=colour[name], marker=marker[name])
    prior = next(row for row in summary if (row.method, row.group) == ("prior", "all"))
    ax.axhline(prior.value, color=style.PAPER_COLOUR, linestyle="--", linewidth=1)
    handles = style.method_handles(methods)
    handles.append(Line2D([], [], color=style.PAPER_COLOUR, linestyle="--", label="prior"))
    ax.set(xlabel="Actions of the attempt used", ylabel="Position error (cm)", ylim=(0, None))
    style.legend(figure, handles)
    return figure


def error_by_attempt(summary: list[Row]) -> Figure:
    """Draw the mean position error before and after each attempt of a sequence."""
    figure, ax = style.axes()
    after = _by_attempt(summary, "full", "position_error_cm")
    first = _by_attempt(summary, "prior", "position_error_cm").get(1)
    rows = after if first is None else {0: first} | after
    attempts = list(rows)
    style.points(ax, attempts, list(rows.values()), color=style.MATCHED_COLOUR)
    ax.set(xlabel="Failed attempts", ylabel="Position error (cm)", yscale="log", xticks=attempts)
    style.log_axis(ax.yaxis)
    return figure


def coverage_by_attempt(summary: list[Row]) -> Figure:
    """Draw the coverage of the 50 and 90 % ellipses after each attempt of a sequence."""
    figure, ax = style.axes()
    kinds = ((90, style.MATCHED_COLOUR, "o"), (50, style.MISMATCHED_COLOUR, "s"))
    for level, colour, marker in kinds:
        rows = _by_attempt(summary, "full", f"coverage_{level}")
        style.points(ax, list(rows), list(rows.values()), color=colour, marker=marker)
        ax.axhline(level / 100, color=colour, linestyle="--", linewidth=1)
        ax.set_xticks(list(rows))
    ax.set(xlabel="Failed attempts", ylabel="Coverage", ylim=(0.3, 1))
    ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    handles = [
        Line2D([], [], color=c, marker=m, markersize=5, label=f"{level} % ellipse") for level, c, m in kinds
    ]
    style.legend(figure, handles)
    return figure


def coverage(trials: Trials) -> Figure:
    """Draw the observed coverage of each credible ellipse; a calibrated posterior lies on the diagonal."""
    figure, ax = style.axes()
    methods = list(dict.fromkeys(trial["method"] for trial in trials))
    colour, marker = style.colours(methods), style.markers(methods)
    for name in methods:
        squared = np.array([t["squared_mahalanobis"] for t in trials if t["method"] == name])
        share = [inside(squared, float(level)).mean() for level in LEVELS]
        ax.plot(LEVELS, share, color=colour[name], marker=marker[name], markersize=4)
    _diagonal(ax, "Probability of the ellipse", "Observed coverage")
    style.legend(figure, style.method_handles(methods))
    return figure


def match_reliability(trials: Trials, names: tuple[str, ...]) -> Figure:
    """Draw the reliability diagram of the match probability of h_match and of the histogram filter."""
    own = [trial for trial in trials if trial["method"] == "full"]
    matched = np.array([trial["pair"][0] == trial["pair"][1] for trial in own])
    filtered = np.array([trial["type_probability"][names.index(trial["pair"][0])] for trial in own])
    figure, ax = style.axes()
    kinds = (
        ("h_match", np.array([trial["match_probability"] for trial in own]), style.MATCHED_COLOUR, "o"),
        ("histogram filter", filtered, style.MISMATCHED_COLOUR, "s"),
    )
    for _, probability, colour, marker in kinds:
        mean, frequency, n = reliability(probability, matched)
        half = 1.96 * np.sqrt(frequency * (1 - frequency) / n)
        bars = style.spread(frequency, frequency - half, frequency + half)
        ax.errorbar(mean, frequency, bars, color=colour, marker=marker, markersize=5)
    _diagonal(ax, "Predicted probability of a match", "Observed frequency")
    handles = [Line2D([], [], color=c, marker=m, markersize=5, label=name) for name, _, c, m in kinds]
    style.legend(figure, handles)
    return figure


def match_by_pair(summary: list[Row]) -> Figure:
    """Draw the match AUROC of h_match: each peg's matching hole against each other hole type."""
    pairs = {row.group: row for row in summary if row.metric == "match_auroc" and row.group.count(":") == 1}
    names = [name for name in pairs if not name.startswith("actions")]
    rows = [pairs[name] for name in names]
    if len(rows) > MOST_PAIRS:
        return _match_matrix(rows)
    figure, ax = style.axes()
    style.points(ax, range(len(rows)), rows, linestyle="none", color=style.MATCHED_COLOUR)
    ax.axhline(0.5, color=style.PAPER_COLOUR, linestyle="--", linewidth=1)
    texts = ["{} peg,\n{} hole".format(*name.split(":")) for name in names]
    ax.set_xticks(range(len(rows)), texts, rotation=HEADED, ha="right", rotation_mode="anchor")
    lowest = min([0.45, *(row.value if row.low is None else row.low - 0.02 for row in rows)])
    ax.set(ylabel="Match AUROC", ylim=(max(lowest, 0.0), 1.0))
    return figure


def _match_matrix(rows: list[Row]) -> Figure:
    """Draw many pairs as a matrix: a row for each peg, a column for each hole."""
    names = list(dict.fromkeys(row.group.split(":")[0] for row in rows))
    area = np.full((len(names), len(names)), np.nan)
    for row in rows:
        peg, hole = row.group.split(":")
        area[names.index(peg), names.index(hole)] = row.value
    figure, ax = style.axes(1.4 + 0.32 * len(names))
    image = ax.imshow(area, cmap="cividis", vmin=0.5, vmax=1, aspect="auto")
    for (peg, hole), value in np.ndenumerate(area):
        if np.isfinite(value):
            ink = "white" if value < 0.8 else "black"
            ax.text(hole, peg, f"{100 * value:.0f}", ha="center", va="center", color=ink, fontsize=8)
    labels = [style.label(name) for name in names]
    ax.set_xticks(range(len(names)), labels, rotation=HEADED, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(names)), labels)
    ax.set(xlabel="Hole", ylabel="Peg")
    ax.grid(visible=False)
    figure.colorbar(image, ax=ax, label="Match AUROC (cells: %)", format="%g", fraction=0.046, pad=0.03)
    return figure


def _by_attempt(summary: list[Row], method: str, metric: str) -> dict[int, Row]:
    return _by_number(summary, method, metric, "attempt:")


def _by_actions(summary: list[Row], method: str) -> dict[int, Row]:
    return _by_number(summary, method, "position_error_cm", "actions:")


def _by_number(summary: list[Row], method: str, metric: str, prefix: str) -> dict[int, Row]:
    """Return the rows whose groups are numbers after a prefix, by number."""
    rows = [row for row in summary if (row.method, row.metric) == (method, metric)]
    return {number: row for row in rows if (number := number_in(row.group, prefix)) is not None}


def _diagonal(ax, xlabel: str, ylabel: str) -> None:
    ax.plot([0, 1], [0, 1], color=style.PAPER_COLOUR, linestyle="--", linewidth=1)
    ax.set(xlabel=xlabel, ylabel=ylabel, xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(PercentFormatter(1, decimals=0))
