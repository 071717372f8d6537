"""Common style of all figures, and their conversion to SVG for a page."""

import io
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from mjx_fit.evaluation.statistics import Row

RC: Any = {  # matplotlib types the keys
    "figure.figsize": (5.2, 3.6),  # inches: narrow, legible on a phone
    "figure.constrained_layout.use": True,
    "figure.dpi": 150,
    "font.size": 11,
    "legend.fontsize": 10,
    "xtick.labelsize": 10,
    "ytick.labelsize": 10,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e4e4",
    "legend.frameon": False,
    "errorbar.capsize": 3,
    "svg.fonttype": "none",  # text stays text: small, searchable, escaped
    "svg.hashsalt": "mjx_fit",
    "text.parse_math": False,  # a method's name may hold a dollar sign
}

# Okabe and Ito's colour-blind safe palette.
_COLOURS = {
    "full": "#0072B2",
    "failure_position": "#E69F00",
    "failure_only": "#D55E00",
    "position_only": "#E69F00",
    "frame_by_frame": "#009E73",
    "no_update": "#CC79A7",
    "sample": "#56B4E9",
    "perfect_match": "#CC79A7",
    "perfect_sensor": "#009E73",
    "oracle": "#4d4d4d",
    "spiral": "#0072B2",
}
# Tol's muted palette, for unknown methods.
_OTHERS = ("#882255", "#117733", "#999933", "#332288", "#AA4499", "#44AA99", "#DDCC77", "#661100")
_MARKERS = "osD^vPX<>"

PAPER_COLOUR = "#111111"
MATCHED_COLOUR, MISMATCHED_COLOUR = "#0072B2", "#D55E00"


@dataclass(frozen=True)
class Picture:
    """Figure, ready for the page.

    Attributes:
        name: File name without suffix; unique in a report.
        caption: Caption.
        svg: The figure as an SVG document.
    """

    name: str
    caption: str
    svg: str


def picture(name: str, caption: str, draw: Callable[[], Figure]) -> Picture:
    """Draw a figure in the common style; the same data give the same bytes."""
    with matplotlib.rc_context(RC):
        buffer = io.StringIO()
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        draw().savefig(buffer, format="svg", metadata=nothing)
    return Picture(name, caption, _unique_ids(buffer.getvalue(), name))


def axes(height_in: float | None = None) -> tuple[Figure, Axes]:
    """Return an empty figure with one set of axes."""
    figure = Figure()
    if height_in is not None:
        figure.set_figheight(height_in)
    return figure, figure.subplots()


def colours(methods: Sequence[str]) -> dict[str, str]:
    """Return a colour for each method: fixed for ours, in alphabetical order for others."""
    others = sorted(set(methods) - set(_COLOURS))
    chosen = {name: _OTHERS[i % len(_OTHERS)] for i, name in enumerate(others)}
    return {name: _COLOURS.get(name) or chosen[name] for name in methods}


def markers(methods: Sequence[str]) -> dict[str, str]:
    """Return a marker for each method, so that methods differ by more than colour."""
    return {name: _MARKERS[i % len(_MARKERS)] for i, name in enumerate(methods)}


def label(name: str) -> str:
    """Return a readable name in at most two short lines."""
    words = name.replace("_", " ").strip() or name
    lines = textwrap.wrap(words, 20, max_lines=2, placeholder="…")
    return "\n".join(lines)


def log_axis(axis: Axis) -> None:
    """Label a logarithmic axis at 1, 2 and 5 times powers of ten, in plain numbers.

    Minor ticks have no labels: Matplotlib writes theirs as formulas, which our SVG keeps as text.
    """
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_formatter(NullFormatter())


def legend(figure: Figure, handles: Sequence[Any]) -> None:
    """Add a legend above the axes, if there are handles."""
    if not handles:
        return
    n_columns = 2 if any(len(handle.get_label()) > 16 for handle in handles) else 3
    figure.legend(handles=list(handles), loc="outside upper left", ncols=min(n_columns, len(handles)))


def method_handles(methods: Sequence[str]) -> list[Line2D]:
    """Return the legend entries of the methods' lines."""
    colour, marker = colours(methods), markers(methods)
    return [
        Line2D([], [], color=colour[name], marker=marker[name], markersize=5, label=label(name))
        for name in methods
    ]


def points(ax: Axes, at: Sequence[float], rows: Sequence[Row], *, lying: bool = False, **look: Any) -> None:
    """Plot values of a summary with their intervals, vertical or, if ``lying``, horizontal."""
    value, low, high = ([getattr(row, end) for row in rows] for end in ("value", "low", "high"))
    ends = spread(value, low, high)
    look = {"marker": "o", "markersize": 5} | look
    if lying:
        ax.errorbar(value, at, xerr=ends, **look)
    else:
        ax.errorbar(at, value, yerr=ends, **look)


def against(rows: Sequence[Row], words: Sequence[str], equal: float, xlabel: str) -> Figure:
    """Plot one method against others, a row for each; the dashed line marks equality."""
    figure, ax = axes(1.2 + 0.55 * len(rows))
    at = list(range(len(rows)))
    points(ax, at, rows, lying=True, linestyle="none", color=MATCHED_COLOUR)
    ax.axvline(equal, color=PAPER_COLOUR, linestyle="--", linewidth=1)
    ax.set_yticks(at, list(words))
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_xlabel(xlabel)
    return figure


def spread(value: Any, low: Any, high: Any) -> np.ndarray:
    """Return interval ends as matplotlib's (2, n) distances below and above; 0 where unknown."""
    value, low, high = (np.asarray(x, float) for x in (value, low, high))
    return np.nan_to_num(np.maximum([value - low, high - value], 0))


def _unique_ids(svg: str, name: str) -> str:
    """Prefix every id: matplotlib repeats ids across figures, and the page contains many figures."""
    prefix = re.sub(r"[^A-Za-z0-9_-]", "-", name)
    svg = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}.\1"', svg)
    svg = re.sub(r'href="#([^"]+)"', rf'href="#{prefix}.\1"', svg)
    return re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}.\1)", svg)
