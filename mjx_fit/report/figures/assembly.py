"""Figures of the assembly and attempt experiments, from the rows of a result, with 95 % intervals."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, PercentFormatter

from mjx_fit.evaluation.results import by_method, pegs_inserted_wrongly
from mjx_fit.evaluation.statistics import Row, bootstrap_means, wilson
from mjx_fit.report.figures import style

ATTEMPTS_BIN = 6
"""Width of a histogram bin in attempts, as in the paper."""
ERROR_BIN_MM = 4.0

Trials = list[dict[str, Any]]


def success_curve(trials: Trials, cap: int) -> Figure:
    """Draw the insertion rate within k attempts, with intervals by bootstrap over trials.

    Args:
        trials: Rows of an assembly result.
        cap: Maximum number of attempts at one peg before human intervention.
    """
    methods = by_method(trials)
    colour, marker = style.colours(list(methods)), style.markers(list(methods))
    figure, ax = style.axes()
    k = np.arange(1, cap + 1)
    for name, own in methods.items():
        attempts = np.array([trial["attempts"] for trial in own])
        human = np.array([trial["human"] for trial in own], bool)
        clusters = np.repeat([trial["trial"] for trial in own], attempts.shape[1])
        succeeded = ~human & ~pegs_inserted_wrongly(own)
        inserted = (attempts.ravel()[:, None] <= k) & succeeded.ravel()[:, None]
        mean, low, high = bootstrap_means(inserted, clusters)
        ax.fill_between(k, low, high, color=colour[name], alpha=0.18, linewidth=0)
        ax.plot(k, mean, color=colour[name], marker=marker[name], markersize=4, markevery=max(1, cap // 10))
    ax.set(xlabel="Attempts at one peg", ylabel="Insertion rate", ylim=(-0.02, 1.04))
    ax.set_xlim(min(1, cap - 1), cap + 0.5)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    style.legend(figure, style.method_handles(list(methods)))
    return figure


def attempts_histogram(trials: Trials) -> Figure:
    """Draw histograms of the cumulative attempts for the first n pegs, a row for each n, with means.

    Args:
        trials: Rows of an assembly result.
    """
    methods = by_method(trials)
    colour = style.colours(list(methods))
    totals = {name: np.cumsum([trial["attempts"] for trial in own], 1) for name, own in methods.items()}
    n_pegs = next(iter(totals.values())).shape[1]
    most = max(int(total.max()) for total in totals.values())
    edges = np.arange(0, most + ATTEMPTS_BIN, ATTEMPTS_BIN) + 0.5  # bins hold 1-6, 7-12, ...
    figure = Figure(figsize=(5.2, 1.0 + 1.35 * n_pegs))
    rows = figure.subplots(n_pegs, 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for n, ax in enumerate(rows):
        for name, total in totals.items():
            weights = np.full(len(total), 1 / len(total))
            look = {"facecolor": (colour[name], 0.22), "edgecolor": colour[name], "linewidth": 1.2}
            ax.hist(total[:, n], edges, weights=weights, histtype="stepfilled", **look)
            ax.axvline(total[:, n].mean(), color=colour[name], linewidth=2, linestyle=(0, (4, 1.5)))
        ax.set_title(f"first {n + 1} pegs" if n else "first peg", loc="right", pad=3)
        ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
        ax.grid(axis="x", visible=False)
    rows[-1].set_xlim(0, edges[-1] + 0.5)
    rows[-1].xaxis.set_major_locator(MaxNLocator(8, integer=True, steps=[1, 2, 3, 6, 10]))
    rows[-1].set_xlabel(f"Cumulative attempts (bins of {ATTEMPTS_BIN})")
    figure.supylabel("Trials", fontsize=11)
    lines = [Line2D([], [], color=colour[name], linewidth=5, label=style.label(name)) for name in methods]
    mean = Line2D([], [], color="#444444", linewidth=2, linestyle=(0, (4, 1.5)), label="mean")
    style.legend(figure, [*lines, mean])
    return figure


def intervention_rate(summary: Sequence[Row], paper: Mapping[tuple[str, str, str], float]) -> Figure:
    """Draw the human intervention rate, with the paper's value where it reports one.

    Args:
        summary: Rows of an assembly result.
        paper: Values by method, metric and group.
    """
    rows = [row for row in summary if row.metric == "intervention_rate" and row.group == "all"]
    colour = style.colours([row.method for row in rows])
    labels = [f"{style.label(row.method)}\n{row.value:.1%} of {row.n} pegs" for row in rows]
    figure = _bars(rows, labels, [colour[row.method] for row in rows])
    ax = figure.axes[0]
    marks = [(paper.get((row.method, row.metric, row.group)), i) for i, row in enumerate(rows)]
    known = [(value, i) for value, i in marks if value is not None]
    if known:
        ax.plot(*zip(*known, strict=True), "D", **_PAPER_MARK, label="paper")
        style.legend(figure, ax.get_legend_handles_labels()[0])
    highest = [x for row in rows for x in (row.value, row.high or 0)] + [value for value, _ in known]
    ax.set_xlim(0, min(1.02, max(0.05, 1.15 * max(highest))))
    ax.set_xlabel("Human intervention rate")
    return figure


def attempts_ratio(summary: Sequence[Row]) -> Figure:
    """Draw the ratio of attempts for all pegs, ``full`` to each other method, in the same trials.

    Args:
        summary: Rows of an assembly result.
    """
    rows = [row for row in summary if row.metric == "attempts_ratio"]
    words = [f"full /\n{style.label(row.group)}" for row in rows]
    figure = style.against(rows, words, 1, "Ratio of attempts for all pegs")
    figure.axes[0].set_xlim(0, None)
    return figure


def where_attempts_went(trials: Trials) -> Figure:
    """Draw the mean number of attempts of an assembly by outcome, for each method.

    Args:
        trials: Rows of an assembly result, with ``holes`` and ``tried``.
    """
    methods = by_method(trials)
    figure, ax = style.axes(1.4 + 0.5 * len(methods))
    spent = np.array([np.mean([_spent(trial) for trial in own], axis=0) for own in methods.values()])
    left = np.zeros(len(methods))
    for (word, colour), share in zip(_SPENT, spent.T, strict=True):
        ax.barh(np.arange(len(methods)), share, 0.6, left=left, color=colour, label=word)
        left += share
    ax.set_yticks(np.arange(len(methods)), [style.label(name) for name in methods])
    ax.set_ylim(len(methods) - 0.5, -0.5)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("Attempts for all pegs")
    style.legend(figure, ax.get_legend_handles_labels()[0])
    return figure


_SPENT = (
    ("inserted", "#0072B2"),
    ("failed, matching hole", "#56B4E9"),
    ("failed, mismatched hole", "#D55E00"),
)


def _spent(trial: dict[str, Any]) -> tuple[int, int, int]:
    """Count the attempts of a trial that succeeded, failed at a matching hole, and failed at another."""
    by_robot = len(trial["human"]) - sum(trial["human"])
    inserted = by_robot - sum(trial.get("inserted_wrongly", []))
    fits = sum(
        trial["holes"][hole] == peg
        for peg, tried in zip(trial["pegs"], trial["tried"], strict=True)
        for hole in tried
    )
    return inserted, fits - inserted, sum(trial["attempts"]) - fits


def attempt_success(summary: Sequence[Row], paper: Mapping[tuple[str, str, str], float]) -> Figure:
    """Draw the success rate of attempts, matched, by shape and mismatched, with the paper's α as a line.

    Args:
        summary: Rows of an attempt result.
        paper: Values by method, metric and group; without α there is no line.
    """
    rates = {row.group: row for row in summary if row.metric == "success_rate"}
    order = [name for name in ("matched", "mismatched") if name in rates]
    order[1:1] = [name for name in rates if name not in order]
    rows = [rates[name] for name in order]
    colour = [style.MISMATCHED_COLOUR if name == "mismatched" else style.MATCHED_COLOUR for name in order]
    names = ["all matched" if name == "matched" else style.label(name) for name in order]
    labels = [f"{name}\n{row.value:.0%} of {row.n}" for name, row in zip(names, rows, strict=True)]
    figure = _bars(rows, labels, colour)
    ax = figure.axes[0]
    if alpha := paper.get(("spiral", "success_rate", "matched")):
        line = ax.axvline(alpha, color=style.PAPER_COLOUR, linewidth=1, linestyle="--")
        line.set_label(f"paper, matched: {alpha:.2f}")
        style.legend(figure, [line])
    ax.set_xlim(0, 1.02)
    ax.set_xlabel("Success rate")
    return figure


def success_by_error(matched: Trials) -> Figure:
    """Draw the success rate of matched attempts by the detection error.

    Args:
        matched: Rows of an attempt result, matched pairs only.
    """
    error_mm = np.array([trial["error_m"] for trial in matched]) * 1000
    inserted = np.array([trial["inserted"] for trial in matched], bool)
    bins = (error_mm // ERROR_BIN_MM).astype(int)
    figure, ax = style.axes()
    look: dict[str, Any] = {"color": style.MATCHED_COLOUR, "marker": "o", "capsize": 0}
    for b in np.unique(bins):
        n = int((bins == b).sum())
        rate = wilson(int(inserted[bins == b].sum()), n)
        centre = (b + 0.5) * ERROR_BIN_MM
        ends = style.spread([rate.value], [rate.low], [rate.high])
        ax.errorbar(centre, rate.value, yerr=ends, xerr=ERROR_BIN_MM / 2, **look)
        ax.text(centre, 1.03, f"{n}", transform=ax.get_xaxis_transform(), ha="center", fontsize=9)
    ax.text(-0.02, 1.03, "n =", transform=ax.transAxes, ha="right", fontsize=9)
    ax.set(xlabel="Detection error (mm)", ylabel="Success rate, matched hole")
    ax.set(ylim=(-0.02, 1.02), xlim=(0, (bins.max() + 1) * ERROR_BIN_MM))
    ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    return figure


_PAPER_MARK: dict[str, Any] = {"markerfacecolor": "none", "markeredgecolor": style.PAPER_COLOUR, "zorder": 5}


def _bars(rows: Sequence[Row], labels: Sequence[str], colour: Sequence[str]) -> Figure:
    """Draw horizontal bars with intervals, which leave room for long names."""
    figure, ax = style.axes(1.2 + 0.55 * len(rows))
    value, low, high = np.array([(row.value, row.low, row.high) for row in rows], float).T
    at = np.arange(len(rows))
    ax.barh(at, value, 0.5, color=list(colour), alpha=0.75)
    ax.errorbar(value, at, xerr=style.spread(value, low, high), fmt="none", color="#222222", linewidth=1.2)
    ax.set_yticks(at, list(labels))
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.grid(axis="y", visible=False)
    ax.xaxis.set_major_formatter(PercentFormatter(1, decimals=None))
    return figure
