"""Compare whole attempts in MJX and C MuJoCo, in distribution.

    python experiments/physics/parity_attempts.py

The script runs the same 600 attempts in both engines. Contact is chaotic, so trajectories diverge and only
distributions are comparable.
"""

# pyright: reportAttributeAccessIssue=false
import time

import numpy as np
import shared
from matplotlib.figure import Figure

from mjx_fit.config.schema import Config
from mjx_fit.control.policies import NAMES
from mjx_fit.data.schedule import mismatched_pairs
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.statistics import bootstrap_mean, bootstrap_means
from mjx_fit.report.figures import style
from mjx_fit.scene.build import simulation_scene
from mjx_fit.types import Rollout
from mjx_fit.utils.rates import ACTION_S

ATTEMPTS = 600
SUCCESS_MARGIN, FORCE_MARGIN = 0.06, 0.10


def main() -> None:
    """Run the same attempts in both engines and compare the outcomes."""
    config = shared.config()
    matched, others = np.arange(ATTEMPTS // 2) % config.scene.n_types, mismatched_pairs(config.scene.n_types)
    others = others[np.arange(ATTEMPTS // 2) % len(others)]
    peg, hole = np.concatenate([matched, others[:, 0]]), np.concatenate([matched, others[:, 1]])
    asked = shared.spiral_attempts(config, "parity", peg, hole)
    measured, seconds = {}, {}
    for name in ("native", "mjx"):
        began = time.perf_counter()
        measured[name] = _measure(make_engine(name, config).run(asked, config.task.attempt_actions), config)
        seconds[name] = time.perf_counter() - began
    ids = np.arange(ATTEMPTS)
    rows = {}
    for what in measured["native"]:
        c, x = measured["native"][what], measured["mjx"][what]
        keep = peg == hole if what == "inserted" else np.ones(ATTEMPTS, bool)
        difference = bootstrap_mean((x - c)[keep], ids[keep].tolist())
        ratio = _ratio(x[keep], c[keep])
        rows[what] = {
            "native": c[keep].mean(),
            "mjx": x[keep].mean(),
            "difference": difference,
            "ratio": ratio,
        }
    low, high = rows["inserted"]["difference"][1:]
    results = {
        "attempts_per_engine": ATTEMPTS,
        "policy": NAMES[0],
        "seconds_with_compilation": seconds,
        "rows": rows,
        "holds": {
            "success_within_6_points": bool(low > -SUCCESS_MARGIN and high < SUCCESS_MARGIN),
            "mean_and_median_force_within_10_percent": all(
                rows[what]["ratio"][1] > 1 - FORCE_MARGIN and rows[what]["ratio"][2] < 1 + FORCE_MARGIN
                for what in ("mean_force_n", "median_force_n")
            ),
        },
    }
    shared.save("parity_attempts", results)
    shared.draw("parity_attempts", lambda: _figure(measured, rows, peg == hole))


def _measure(done: Rollout, config: Config) -> dict[str, np.ndarray]:
    assert done.truth.valid.all()
    felt, length = shared.force(done), np.asarray(done.felt.length)
    last = np.asarray(done.felt.trace.tip_pos_world)[np.arange(len(felt)), length - 1, 2]
    return {
        "inserted": np.asarray(done.truth.inserted, float),
        "mean_force_n": np.nanmean(felt, 1),
        "median_force_n": np.nanmedian(felt, 1),
        "peak_force_n": np.nanmax(felt, 1),
        "final_depth_mm": 1e3 * (simulation_scene(config.scene).plate_top_m - last),
        "duration_s": ACTION_S * length,
    }


def _ratio(x: np.ndarray, c: np.ndarray) -> tuple[float, float, float]:
    """Compute the ratio of means, MJX to C, with a bootstrap interval over attempts."""
    draws = np.random.default_rng(0).integers(len(x), size=(2000, len(x)))
    low, high = np.quantile(x[draws].mean(1) / c[draws].mean(1), (0.025, 0.975))
    return float(x.mean() / c.mean()), float(low), float(high)


def _figure(measured: dict, rows: dict, matched: np.ndarray) -> Figure:
    figure = Figure(figsize=(10, 5.6))
    axes = figure.subplots(2, 3).ravel()
    labels = {
        "inserted": "Success rate, matched",
        "mean_force_n": "Mean force [N]",
        "median_force_n": "Median force [N]",
        "peak_force_n": "Peak force [N]",
        "final_depth_mm": "Final depth of the TCP [mm]",
        "duration_s": "Duration [s]",
    }
    for ax, (what, label) in zip(axes, labels.items(), strict=True):
        for x, (engine, colour) in enumerate(
            (("native", style.MATCHED_COLOUR), ("mjx", style.MISMATCHED_COLOUR))
        ):
            values = measured[engine][what]
            name = {"native": "C MuJoCo", "mjx": "MJX"}[engine]
            if what == "inserted":
                mean, low, high = bootstrap_means(values[matched, None], np.flatnonzero(matched))
                ax.bar(x, mean[0], yerr=style.spread(mean, low, high), color=colour, width=0.6)
                ax.set_xticks([0, 1], ["C MuJoCo", "MJX"])
            else:
                ordered = np.sort(values)
                share = np.arange(1, len(ordered) + 1) / len(ordered)
                ax.plot(ordered, share, color=colour, label=name, linestyle="-" if x == 0 else "--")
        value, low, high = rows[what]["difference"] if what == "inserted" else rows[what]["ratio"]
        word = "difference" if what == "inserted" else "ratio of means"
        ax.set(xlabel=label, title=f"{word} {value:.3f} ({low:.3f} to {high:.3f})")
        if what != "inserted":
            ax.set_ylabel("Share of attempts")
    axes[1].legend(loc="lower right")
    return figure


if __name__ == "__main__":
    shared.begin()
    main()
