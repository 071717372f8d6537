"""Figures of effort: the seconds until an insertion, and the largest force on the way."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from mjx_fit.evaluation.effort_summary import totals
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
    figure, ax = style.axes()
    methods = by_method(trials)
    colour = style.colours(list(methods))
    needed = {method: _seconds_needed(own) for method, own in methods.items()}
    last = max([10.0, *(float(own[np.isfinite(own)].max(initial=0)) for own in needed.values())])
    for method, own in needed.items():
        _cumulative(ax, own, last, color=colour[method])
    ax.set(xlabel="Seconds of attempts", ylabel="Pegs inserted", xlim=(0, last), ylim=(-0.02, 1.04))
    ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    style.legend(figure, [Line2D([], [], color=colour[n], label=style.label(n)) for n in methods])
    return figure


def peak_forces(trials: Trials) -> Figure:
    """Draw the share of trials whose largest force stays below a force, with a line at 20 N.

    Args:
        trials: Rows of an insertion or an assembly result.
    """
    figure, ax = style.axes()
    methods = by_method(trials)
    colour = style.colours(list(methods))
    peaks = {method: _peaks(own) for method, own in methods.items()}
    last = max([1.5 * HARD_N, *(float(own.max(initial=0)) for own in peaks.values())])
    for method, own in peaks.items():
        _cumulative(ax, np.maximum(own, 1), last, color=colour[method])
    ax.axvline(HARD_N, color=style.PAPER_COLOUR, linestyle="--", linewidth=1)
    ax.set(xlabel="Largest force (N)", ylabel="Trials below", xscale="log", xlim=(1, last))
    ax.set_ylim(-0.02, 1.04)
    ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    style.log_axis(ax.xaxis)
    style.legend(figure, [Line2D([], [], color=colour[n], label=style.label(n)) for n in methods])
    return figure


def _seconds_needed(trials: Trials) -> Float[np.ndarray, " n"]:
    """Return the seconds until the insertion of each trial's peg, or of each peg; infinite without one."""
    if "pegs" not in trials[0]:
        return np.where([trial["success"] for trial in trials], totals(trials, "seconds"), np.inf)
    seconds = np.array([sum(peg) for trial in trials for peg in trial["seconds"]])
    return np.where([human for trial in trials for human in trial["human"]], np.inf, seconds)


def _peaks(trials: Trials) -> Float[np.ndarray, " n"]:
    """Return the largest force of each trial; unknown forces of diverged simulations are left out."""
    peaks = []
    for trial in trials:
        given = trial["peak_force_n"]
        flat = [force for peg in given for force in peg] if "pegs" in trial else given
        peaks.append(max((force for force in flat if force is not None), default=0.0))
    return np.array(peaks)


def _cumulative(ax: Any, values: Float[np.ndarray, " n"], last: float, **look: Any) -> None:
    ordered = np.sort(values)
    share = np.arange(1, len(ordered) + 1) / len(ordered)
    seen = ordered <= last
    end = share[seen][-1] if seen.any() else 0.0
    ax.step([0, *ordered[seen], last], [0, *share[seen], end], where="post", **look)
