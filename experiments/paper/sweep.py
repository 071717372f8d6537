"""Vary settings beyond the paper: assemblies of ``full`` by number of holes, detector and clearance.

    python experiments/paper/sweep.py FOLDER [--trials N]

One setting changes at a time; the outcome model depends on the belief's covariance. The priors do not change:
σ = 1 cm for every detector, and success by distance as for a clearance of 1 mm. Result files go to FOLDER,
the table and the figure to the folder of the world, ``home``. Rerun the command to resume.
"""

import argparse
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from mjx_fit.config.files import read_config
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.assembly import assembly
from mjx_fit.evaluation.request import Request
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report import script
from mjx_fit.report.figures import style
from mjx_fit.training.sensor_loader import load_trained_sensor
from mjx_fit.utils import process_setup, resources

HERE = Path(__file__).parent / "home"
METHODS = "full,oracle"
SWEEPS: dict[str, tuple[str, tuple[float, ...], float, str]] = {
    "task.n_holes": ("Holes", (2, 5, 8), 1, "{:g}"),
    "detector.half_width_m": ("Maximum detection error per axis (cm)", (0.01, 0.02, 0.03), 100, "{:g}"),
    "scene.clearance_m": ("Clearance per side (mm)", (0.0005, 0.001, 0.002), 1000, "{:g}"),
}


def main(folder: Path, trials: int) -> None:
    rows: list[tuple[str, float, Row]] = []
    for key, (_, values, *_rest) in SWEEPS.items():
        for value in values:
            result = _assembled(folder, key, value, trials)
            rows += [(key, value, row) for row in result.summary if row.group == "all"]
    table = [{"key": key, "setting": value, **row.to_json()} for key, value, row in rows]
    script.save(HERE / "sweep.json", {"trials": trials, "rows": table})
    script.draw(HERE / "sweep.png", lambda: _figure(rows))


def _assembled(folder: Path, key: str, value: float, trials: int) -> Result:
    config = read_config(None, [f"{key}={value}", "task.outcome_model=covariance"])
    # One file per configuration: all sweeps share the defaults, which run once.
    same = config == read_config(None, ["task.outcome_model=covariance"])
    name = "default" if same else f"{key}-{value:g}"
    out = folder / f"{name}.json"
    sensor = load_trained_sensor(resources.folder("weights"))
    request = Request(config, out, make_engine("auto", config), trials, methods=METHODS, sensor=sensor)
    return assembly(request)


def _figure(rows: list[tuple[str, float, Row]]) -> Figure:
    figure = Figure(figsize=(10.5, 5.6))
    axes = figure.subplots(2, len(SWEEPS), sharey="row")
    methods = METHODS.split(",")
    colour, marker = style.colours(methods), style.markers(methods)
    for column, (key, (label, values, scale, text)) in enumerate(SWEEPS.items()):
        for line, metric in enumerate(("attempts", "intervention_rate")):
            ax = axes[line, column]
            for name in methods:
                own = [row for of, _, row in rows if (of, row.metric, row.method) == (key, metric, name)]
                style.points(ax, range(len(own)), own, color=colour[name], marker=marker[name])
            ax.set_xticks(range(len(values)), [text.format(value * scale) for value in values])
            ax.set_xlim(-0.3, len(values) - 0.7)
            if line:
                ax.set_xlabel(label)
                ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=None))
    for ax in axes.flat:  # after drawing: the axes of a row share their limits
        ax.set_ylim(0, None)
    axes[0, 0].set_ylabel("Attempts for all pegs")
    axes[1, 0].set_ylabel("Human intervention rate")
    style.legend(figure, style.method_handles(methods))
    return figure


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--trials", type=int, default=100)
    asked = parser.parse_args()
    process_setup.configure()
    main(asked.folder, asked.trials)
