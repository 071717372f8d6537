"""Figures of effort: the seconds until an insertion, and the largest force on the way."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from mjx_fit.evaluation.effort_summary import largest_forces, seconds_of_pegs, totals
from mjx_fit.evaluation.results import by_method
from mjx_fit.report.figures import style
from mjx_fit.task.effort import HARD_N

Trials = list[dict[str, Any]]


def has_effort(trials: Trials) -> bool:
    """Return whether the trials have seconds and forces; older files lack them."""
    return bool(trials) and all("seconds" in trial and "peak_force_n" in trial for trial in trials)


def inserted_by_seconds(trials: Trials) -> Figure:
    """Draw the share of pegs that are in their holes after a number of seconds of attempts.

    Args:
        trials: Rows of an insertion or an assembly result.
    """
    figure = _shares_below({name: _seconds_needed(own) for name, own in by_method(trials).items()}, 10.0)
    figure.axes[0].set(xlabel="Seconds of attempts", ylabel="Pegs inserted")
    return figure


def peak_forces(trials: Trials) -> Figure:
    """Draw the share of trials whose largest force stays below a force, with a line at 20 N.

    Args:
        trials: Rows of an insertion or an assembly result.
    """
    peaks = {name: np.maximum(largest_forces(own), 1) for name, own in by_method(trials).items()}
    figure = _shares_below(peaks, 1.5 * HARD_N)
    ax = figure.axes[0]
    ax.axvline(HARD_N, color=style.PAPER_COLOUR, linestyle="--", linewidth=1)
    ax.set(xlabel="Largest force (N)", ylabel="Trials below", xscale="log")
    ax.set_xlim(left=1)
    style.log_axis(ax.xaxis)
    return figure


def _seconds_needed(trials: Trials) -> Float[np.ndarray, " n"]:
    """Return the seconds until each peg is in; infinite if it is not."""
    if "pegs" in trials[0]:
        return seconds_of_pegs(trials)
    return np.where([trial["success"] for trial in trials], totals(trials, "seconds"), np.inf)


def _shares_below(values: dict[str, Float[np.ndarray, " n"]], least: float) -> Figure:
    """Draw the cumulative distribution of each method's values, which may be infinite.

    Args:
        values: Values by method.
        least: Least upper end of the horizontal axis.
    """
    figure, ax = style.axes()
    colour = style.colours(list(values))
    last = max([least, *(float(own[np.isfinite(own)].max(initial=0)) for own in values.values())])
    for name, own in values.items():
        ordered = np.sort(own[np.isfinite(own)])
        share = np.arange(1, len(ordered) + 1) / len(own)
        end = share[-1] if len(share) else 0.0
        ax.step([0, *ordered, last], [0, *share, end], where="post", color=colour[name])
    ax.set(xlim=(0, last), ylim=(-0.02, 1.04))
    ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    style.legend(figure, [Line2D([], [], color=colour[n], label=style.label(n)) for n in values])
    return figure
