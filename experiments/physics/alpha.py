"""Measure the success rate of one spiral attempt and its sensitivities.

    python experiments/physics/alpha.py detectors      both detectors, per shape, and the mismatched pairs
    python experiments/physics/alpha.py error          success rate by estimation error, 0 to 30 mm
    python experiments/physics/alpha.py sensitivity    one physics setting varied at a time

All commands use the C engine and seed 0. The attempts of one command share hole positions, directions of the
error, and exploration noise.
"""

import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import shared
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from mjx_fit.config.schema import Config
from mjx_fit.config.sections.scene import SceneConfig
from mjx_fit.data.schedule import mismatched_pairs
from mjx_fit.engines.select import make_engine
from mjx_fit.evaluation.statistics import wilson
from mjx_fit.report.figures import style
from mjx_fit.types import Array, Attempt

NAMES = SceneConfig().names
N_TYPES = len(NAMES)

PER_SHAPE = 400
MISMATCHED_ATTEMPTS = 600
ERRORS_MM = (0, 1, 2, 3, 5, 7.5, 10, 12.5, 15, 17.5, 20, 25, 30)
PER_ERROR = 150
VARIED = {
    "control.kp_position": (300.0, 1200.0),
    "control.kp_orientation": (300.0, 1200.0),
    "scene.friction": (0.15, 0.6),
    "scene.clearance_m": (0.0005, 0.002),
    "scene.contact_time_s": (0.006, 0.02),
    "spiral.push_m": (0.002, 0.008),
    "spiral.wiggle_m": (0.0, 0.0025),
    "task.insertion_depth_m": (0.005, 0.02),
}
COLOURS = ("#D55E00", "#0072B2", "#009E73")


def detectors() -> None:
    """Measure the success rate under each detector."""
    results = {}
    for kind in ("square", "disc"):
        config = shared.config(f"detector.kind={kind}")
        peg = np.repeat(np.arange(N_TYPES), PER_SHAPE)
        others = mismatched_pairs(N_TYPES)
        others = others[np.arange(MISMATCHED_ATTEMPTS) % len(others)]
        asked = shared.spiral_attempts(
            config, f"alpha: {kind}", np.append(peg, others[:, 0]), np.append(peg, others[:, 1])
        )
        done = make_engine("native", config).run(asked, config.task.attempt_actions)
        matched = done.truth.inserted[: len(peg)]
        results[kind] = {
            "matched": _rate(matched),
            **{name: _rate(matched[peg == i]) for i, name in enumerate(NAMES)},
            "mismatched": _rate(done.truth.inserted[len(peg) :]),
            "mean_error_mm": 1e3 * np.linalg.norm(asked.estimate_world - asked.hole_pos_world, axis=1).mean(),
        }
    value = results["disc"]["matched"]["value"]
    results["holds"] = {"disc_between_0.28_and_0.40": bool(0.28 <= value <= 0.40)}
    shared.save("alpha_detectors", results)


def error() -> None:
    """Measure the success rate by distance of the estimate from the hole."""
    config = shared.config()
    n = len(ERRORS_MM) * PER_ERROR
    mm = np.repeat(ERRORS_MM, PER_ERROR)
    rows: dict[str, list] = {}
    for shape, name in enumerate(NAMES):
        asked = _at_distance(config, np.full(n, shape), 1e-3 * mm)
        inserted = make_engine("native", config).run(asked, config.task.attempt_actions).truth.inserted
        rows[name] = [{"error_mm": e, **_rate(inserted[mm == e])} for e in ERRORS_MM]
    shared.save("alpha_error", {"attempts_per_point": PER_ERROR, "rows": rows})
    shared.draw("alpha_error", lambda: _figure(rows))


def sensitivity() -> None:
    """Measure the success rate with one setting changed, under ``disc``."""
    base = shared.config("detector.kind=disc")
    results = {"default": _matched_rate(base)}
    for path, values in VARIED.items():
        section, key = path.split(".")
        for value in values:
            changed = replace(base, **{section: replace(getattr(base, section), **{key: value})})
            results[f"{path}={value:g}"] = _matched_rate(changed)
            print(path, value, results[f"{path}={value:g}"], flush=True)
    shared.save("alpha_sensitivity", {"detector": "disc", "rows": results})


def _matched_rate(config: Config) -> dict[str, float]:
    peg = np.arange(3 * PER_SHAPE) % N_TYPES
    asked = shared.spiral_attempts(config, "alpha: sensitivity", peg, peg)
    return _rate(make_engine("native", config).run(asked, config.task.attempt_actions).truth.inserted)


def _at_distance(config: Config, peg: np.ndarray, distance_m: np.ndarray) -> Attempt:
    """Draw matched attempts whose estimates are off by these distances in random directions."""
    asked = shared.spiral_attempts(config, "alpha: error", peg, peg)
    angle = jax.random.uniform(jax.random.key(1), (len(peg),), maxval=2 * np.pi)
    way = jnp.asarray(distance_m, jnp.float32)[:, None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], 1)
    return replace(asked, estimate_world=asked.hole_pos_world + way)


def _rate(inserted: Array) -> dict[str, float]:
    return {**wilson(int(inserted.sum()), len(inserted))._asdict(), "n": len(inserted)}


def _figure(rows: dict[str, list]) -> Figure:
    figure, ax = style.axes()
    for (name, own), colour, marker in zip(rows.items(), COLOURS, "osD", strict=True):
        x = np.array([row["error_mm"] for row in own])
        value, low, high = (np.array([row[key] for row in own]) for key in ("value", "low", "high"))
        ax.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
        ax.plot(x, value, color=colour, marker=marker, markersize=4, label=name)
    ax.axvline(1e3 * Config().spiral.radius_m, color=style.PAPER_COLOUR, linestyle=":", linewidth=1)
    ax.text(1e3 * Config().spiral.radius_m + 0.3, 0.93, "spiral radius")
    ax.set(xlabel="Estimation error [mm]", ylabel="Success rate", ylim=(-0.02, 1.02))
    ax.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    figure.legend(loc="outside upper left", ncols=3)
    return figure


if __name__ == "__main__":
    commands = {"detectors": detectors, "error": error, "sensitivity": sensitivity}
    if len(sys.argv) < 2 or sys.argv[1] not in commands:
        raise SystemExit(__doc__)
    shared.begin()
    commands[sys.argv[1]]()
