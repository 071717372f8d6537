"""Figures of a data set."""

from itertools import product

import numpy as np
from jaxtyping import Bool
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from mjx_fit.config.schema import Config
from mjx_fit.data.episode import UNKNOWN
from mjx_fit.report.figures import style
from mjx_fit.sensors.force_torque import touched
from mjx_fit.types import Rollout
from mjx_fit.utils.type_colours import FIGURE_COLOURS

VIEW_CM = 6.0
"""Half width of the figure of visited positions."""
MOST_ROWS = 16
"""Most pairs with a row each; beyond it, mismatched holes of a peg share a row."""


def interaction_lengths(data: Rollout, names: tuple[str, ...]) -> Figure:
    """Draw the share of pegs not yet inserted after each action, by shape where peg and hole match.

    The estimate is Kaplan and Meier's, since interactions of different policies end at different lengths.
    """
    matched, peg = np.asarray(data.felt.peg_type == data.truth.hole_type), np.asarray(data.felt.peg_type)
    length, inserted = np.asarray(data.felt.length), np.asarray(data.truth.inserted)
    actions = np.arange(1, data.felt.trace.action_world.shape[1] + 1)
    figure, ax = style.axes(None if len(names) <= 3 else 2.8 + 0.22 * len(names))
    groups = [(f"{name} in {name}", matched & (peg == i)) for i, name in enumerate(names)]
    colours = [*FIGURE_COLOURS[: len(names)], style.MISMATCHED_COLOUR]
    for (name, which), colour in zip([*groups, ("mismatched", ~matched)], colours, strict=True):
        if not which.any():
            continue
        going = (length[which, None] >= actions).sum(0)
        ended = ((length[which, None] == actions) & inserted[which, None]).sum(0)
        left = np.cumprod(1 - ended[going > 0] / going[going > 0])
        label = f"{name} ({which.sum():,})"
        ax.step([0, *actions[going > 0]], [1, *left], where="post", color=colour, label=label)
    ax.set(
        xlabel="Actions (100 ms each)",
        ylabel="Pegs not yet inserted",
        ylim=(-0.02, 1.04),
        xlim=(0, actions[-1]),
    )
    ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    figure.legend(loc="outside upper left", ncols=2)
    return figure


def visited_positions(data: Rollout) -> Figure:
    """Draw end-effector positions relative to the true hole, over all actions of all interactions."""
    tip = np.asarray(data.felt.trace.tip_pos_world)[..., :2] - np.asarray(data.truth.hole_pos_world)[:, None]
    x, y = 100 * tip[_real(data)].T
    counts, edges, _ = np.histogram2d(x, y, bins=np.linspace(-VIEW_CM, VIEW_CM, 61), density=False)
    figure, ax = style.axes(4.2)
    shown = np.ma.masked_equal(counts.T, 0)
    # Rasterised: one image instead of 3,600 squares keeps the page small.
    mesh = ax.pcolormesh(edges, edges, shown, norm=LogNorm(1, max(counts.max(), 10)), rasterized=True)
    ax.plot(0, 0, "+", color="#D55E00", markersize=14, markeredgewidth=2)
    ax.set(xlabel="x from the hole centre (cm)", ylabel="y from the hole centre (cm)", aspect="equal")
    ax.grid(visible=False)
    # A log axis formats its labels as formulas, which the style disables.
    figure.colorbar(mesh, ax=ax, label="Number of actions", format="%g", fraction=0.046, pad=0.03)
    return figure


def forces_by_pair(data: Rollout, config: Config) -> Figure:
    """Draw the contact force by pair: the ranges of the middle 50 % and 90 % of the samples.

    Only actions with contact are used, and every tenth sample. If there are more than ``MOST_ROWS`` pairs,
    all mismatched holes of a peg share a row.
    """
    tared = (
        np.asarray(data.felt.trace.wrench_sensor)[:, :, ::10, :3]
        - np.asarray(data.felt.tare_sensor)[:, None, None, :3]
    )
    seen = touched(data.felt, config.wrist)
    rows = _pairs(data, config.scene.names)
    figure, ax = style.axes(max(4.6, 1 + 0.24 * len(rows)))
    for row, (_, pair, matched) in enumerate(rows):
        force = np.linalg.norm(tared[seen & pair[:, None]], axis=-1).ravel()
        if not len(force):
            continue
        low, first, middle, third, high = np.quantile(force, [0.05, 0.25, 0.5, 0.75, 0.95])
        colour = style.MATCHED_COLOUR if matched else style.MISMATCHED_COLOUR
        ax.plot([low, high], [row, row], color=colour, linewidth=1.2)
        ax.plot([first, third], [row, row], color=colour, linewidth=6, alpha=0.55, solid_capstyle="butt")
        ax.plot(middle, row, "o", color=colour, markersize=5)
    ax.set_yticks(range(len(rows)), [label for label, _, _ in rows])
    ax.set(xlabel="Force (N)", ylim=(len(rows) - 0.4, -0.6))
    ax.set_xlim(left=0)
    ax.grid(axis="y", visible=False)
    return figure


def _pairs(data: Rollout, names: tuple[str, ...]) -> list[tuple[str, Bool[np.ndarray, "n"], bool]]:
    """Return the rows of a figure by pair: label, mask of its rollouts, and whether peg and hole match."""
    peg, hole = np.asarray(data.felt.peg_type), np.asarray(data.truth.hole_type)
    if (hole == UNKNOWN).all():  # a robot's attempts
        return [(name, peg == i, True) for i, name in enumerate(names) if (peg == i).any()]
    if len(names) ** 2 <= MOST_ROWS:
        return [
            (f"{a} in {b}", (peg == i) & (hole == j), i == j)
            for (i, a), (j, b) in product(enumerate(names), repeat=2)
        ]
    own = [(f"{name} in {name}", (peg == i) & (hole == i), True) for i, name in enumerate(names)]
    others = [(f"{name} in others", (peg == i) & (hole != i), False) for i, name in enumerate(names)]
    return [row for both in zip(own, others, strict=True) for row in both]


def _real(data: Rollout) -> Bool[np.ndarray, "n J"]:
    """Return the mask of the actions that were performed."""
    return np.arange(data.felt.trace.action_world.shape[1]) < np.asarray(data.felt.length)[:, None]
