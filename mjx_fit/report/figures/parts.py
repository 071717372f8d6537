"""Figures of parts: every peg in its socket, to scale, and which peg fits which socket."""

import numpy as np
from jaxtyping import Bool
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from shapely import MultiPolygon

from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.scene.outline import hole_outline, inset, peg_outline, rings_of

MM_PER_M = 1000.0
_COLUMNS = 4
_MARGIN = 1.15
_PEG, _PLATE = "#0072B2", "#d9d9d9"


def parts(scene: SceneConfig) -> Figure:
    """Draw every peg in its socket as seen from above, all at one scale, with the gap in the title.

    Thin lines bound the chamfers of tips and mouths.
    """
    n = len(scene.shapes)
    rows = -(-n // _COLUMNS)
    columns = min(n, _COLUMNS)
    figure = Figure(figsize=(2.3 * columns, 2.4 * rows), layout="constrained")
    holes = [hole_outline(shape, scene) for shape in scene.shapes]
    reach = _MARGIN * MM_PER_M * max(abs(np.array(hole.bounds)).max() for hole in holes)
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for ax in axes[n:]:
        ax.set_axis_off()
    for ax, shape, hole in zip(axes, scene.shapes, holes, strict=False):
        ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", facecolor=_PLATE)
        ax.grid(visible=False)
        peg = peg_outline(shape, scene)
        _fill(ax, hole, "white")
        _fill(ax, peg, _PEG)
        if shape.chamfer_m:
            _draw(ax, inset(peg, shape.chamfer_m), "white")
        if shape.socket.chamfer_m:
            _draw(ax, inset(hole, -shape.socket.chamfer_m), "black")
        ax.set_title(f"{shape.name}\ngap {MM_PER_M * scene.clearance_of(shape):g} mm")
    figure.supxlabel("x (mm)", fontsize=11)
    figure.supylabel("y (mm)", fontsize=11)
    return figure


def fit_table(
    names: tuple[str, ...], fixed: Bool[np.ndarray, "C C"], turned: Bool[np.ndarray, "C C"]
) -> Figure:
    """Draw which peg (row) enters which socket (column): at the given yaw, or turned only."""
    n = len(names)
    figure = Figure(figsize=(1.8 + 0.42 * n, 1.4 + 0.36 * n), layout="constrained")
    ax = figure.subplots()
    ax.imshow(fixed.astype(int) + turned, cmap="Blues", vmin=0, vmax=3)
    for peg, hole in np.argwhere(turned):
        ax.text(hole, peg, "yes" if fixed[peg, hole] else "turned", ha="center", va="center", fontsize=7)
    ax.set_xticks(range(n), names, rotation=60, ha="right")
    ax.set_yticks(range(n), names)
    ax.set(xlabel="socket", ylabel="peg")
    ax.grid(visible=False)
    return figure


def _draw(ax: Axes, figure: MultiPolygon, colour: str) -> None:
    """Draw the outlines of polygons as thin lines."""
    for ring in rings_of(figure):
        x, y = MM_PER_M * np.asarray(ring.coords).T
        ax.plot(x, y, color=colour, linewidth=0.5, marker="")


def _fill(ax: Axes, figure: MultiPolygon, colour: str) -> None:
    """Fill polygons, with their holes left out."""
    for polygon in figure.geoms:
        rings = [MM_PER_M * np.asarray(ring.coords) for ring in (polygon.exterior, *polygon.interiors)]
        codes = [[Path.MOVETO, *[Path.LINETO] * (len(ring) - 2), Path.CLOSEPOLY] for ring in rings]
        ax.add_patch(
            PathPatch(Path(np.concatenate(rings), np.concatenate(codes)), facecolor=colour, linewidth=0)
        )
