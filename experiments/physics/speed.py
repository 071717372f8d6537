"""Measure how the speed of each engine scales with the number of worlds.

    python experiments/physics/speed.py [raw_batch native ...]

Each point is measured like a row of ``mjx-fit bench``. If you give names, only those are measured again; the
other rows of the result file are kept.
"""

import json
import sys

import jax
import shared
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from mjx_fit.cli.bench.run import measure
from mjx_fit.config.schema import Config
from mjx_fit.report.figures import style

NAMES = ("raw_batch", "native", "mjx_step", "mjx")
LABELS = {
    "raw_batch": "C MuJoCo alone (mujoco.batch)",
    "native": "native: with control and sensing",
    "mjx_step": "MJX alone",
    "mjx": "mjx: with control and sensing",
}
COLOURS = ("#4d4d4d", "#0072B2", "#E69F00", "#D55E00")
WORLDS = {"cpu": (16, 64, 256, 1024, 4096), "gpu": (256, 1024, 4096, 16384)}


def main() -> None:
    """Measure the speeds and draw the figure."""
    names = sys.argv[1:] or NAMES
    kept = json.loads((shared.FOLDER / "speed.json").read_text())["rows"] if len(names) < len(NAMES) else []
    rows = [row for row in kept if row["name"] not in names]
    for worlds in WORLDS[jax.default_backend()]:
        for name in names:
            rows.append(measure(name, Config(), worlds))
            print(rows[-1], file=sys.stderr, flush=True)
    best = {name: max(row["physics_steps_per_s"] for row in rows if row["name"] == name) for name in NAMES}
    shared.save(
        "speed", {"rows": rows, "best": best, "best_mjx_of_best_raw": best["mjx"] / best["raw_batch"]}
    )
    shared.draw("speed", lambda: _figure(rows))


def _figure(rows: list[dict]) -> Figure:
    figure, ax = style.axes()
    for name, colour, marker in zip(NAMES, COLOURS, "s^oD", strict=True):
        own = [row for row in rows if row["name"] == name]
        x, y = ([row[key] for row in own] for key in ("worlds", "physics_steps_per_s"))
        ax.plot(x, y, color=colour, marker=marker, markersize=5, label=LABELS[name])
    ax.set(xlabel="Worlds", ylabel="Physics steps per second", xscale="log", yscale="log", ylim=(3e4, 5e5))
    ax.set_xticks(WORLDS[jax.default_backend()])
    ax.minorticks_off()
    ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:,.0f}"))
    ax.set_yticks([3e4, 1e5, 3e5])
    ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:,.0f}"))
    figure.legend(loc="outside upper left", ncols=1)
    return figure


if __name__ == "__main__":
    main()
