"""Figures of what comes before an experiment: a data set and a training run."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mjx_fit.errors import RequestError
from mjx_fit.report import style
from mjx_fit.types import Interaction

VIEW_CM = 6.0
"""Half width of the picture of visited positions."""


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """The epochs of a ``metrics.jsonl`` in order; should one stand there twice, its last record.

    A run that is at work, or was killed, may have left half a line at the end.

    Raises:
        RequestError: The file cannot be read, or holds no epoch.
    """
    epochs: dict[int, dict[str, Any]] = {}
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        raise RequestError(f"report: {path} cannot be read") from None
    for number, line in enumerate(lines, 1):
        try:
            record = json.loads(line)
            epochs[int(record["epoch"])] = record
        except (ValueError, KeyError, TypeError):
            if number < len(lines):
                raise RequestError(f"report: {path} line {number} is not a record with an epoch") from None
    if not epochs:
        raise RequestError(f"report: {path} holds no epoch yet; nothing can be shown")
    return [epochs[epoch] for epoch in sorted(epochs)]


def training_curve(metrics: list[dict[str, Any]]) -> Figure:
    """Negative log-likelihood of the truth under the updated belief, by epoch, against the prior's.

    Args:
        metrics: Records of a run; of ``nll``, ``val_nll`` and ``prior_nll`` those are drawn that are there.
    """
    figure, ax = style.axes()
    epoch = np.array([record["epoch"] for record in metrics])
    lines = (
        ("nll", "training", "#999999", "-"),
        ("val_nll", "validation", "#0072B2", "-"),
        ("prior_nll", "prior belief", "#D55E00", "--"),
    )
    few = "o" if len(epoch) < 30 else ""
    for key, name, colour, dash in lines:
        value = np.array([record.get(key) for record in metrics], float)
        if np.isfinite(value).any():
            seen = np.isfinite(value)
            ax.plot(epoch[seen], value[seen], dash, color=colour, label=name, marker=few, markersize=4)
    ax.set(xlabel="Epoch", ylabel="Negative log-likelihood (nat)")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    handles = ax.get_legend_handles_labels()[0]
    if handles:
        style.legend(figure, handles)
    return figure


def interaction_lengths(data: Interaction) -> Figure:
    """How long interactions lasted, for matched and mismatched pairs."""
    matched = np.asarray(data.peg_type == data.hole_type)
    length = np.asarray(data.length)
    figure, ax = style.axes()
    edges = np.linspace(0, max(int(length.max()), 1), 26).tolist()
    groups = (("matched", matched, style.MATCHED_COLOUR), ("mismatched", ~matched, style.MISMATCHED_COLOUR))
    drawn = [(name, length[which], colour) for name, which, colour in groups]
    ax.hist(
        [values for _, values, _ in drawn],
        edges,
        color=[colour for *_, colour in drawn],
        label=[f"{name} (n = {len(values)})" for name, values, _ in drawn],
        rwidth=0.9,
    )
    ax.set(xlabel="Length of the interaction (actions of 0.1 s)", ylabel="Interactions")
    ax.set_xlim(0, edges[-1] * 1.01)
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)
    return figure


def visited_positions(data: Interaction) -> Figure:
    """Where the tip was relative to the true hole, all actions of all interactions together."""
    tip = np.asarray(data.trace.tip_pos_world)[..., :2] - np.asarray(data.hole_pos_world)[:, None]
    real = np.arange(tip.shape[1]) < np.asarray(data.length)[:, None]
    x, y = 100 * tip[real].T
    counts, edges, _ = np.histogram2d(x, y, bins=np.linspace(-VIEW_CM, VIEW_CM, 61), density=False)
    figure, ax = style.axes(4.2)
    shown = np.ma.masked_equal(counts.T, 0)
    # One image instead of 3,600 squares keeps the page small.
    mesh = ax.pcolormesh(edges, edges, shown, norm=LogNorm(1, max(counts.max(), 10)), rasterized=True)
    ax.plot(0, 0, "+", color="#D55E00", markersize=14, markeredgewidth=2)
    ax.set(xlabel="x from the hole's centre (cm)", ylabel="y from the hole's centre (cm)", aspect="equal")
    ax.grid(visible=False)
    # A log axis writes its labels as formulas, which the style has switched off.
    figure.colorbar(mesh, ax=ax, label="Actions that ended there", format="%g", fraction=0.046, pad=0.03)
    return figure
