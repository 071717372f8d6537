"""Measure how far a spiral gets on the socket by friction and stiffness, in the world ``home``.

    python experiments/robust/reach.py

The same 64 spirals run under each change; those that fail count. ``reach_mm`` is the largest distance of the
TCP from the start of an attempt in the plane, ``path_mm`` the length of its way, both as means over attempts.
"""

from pathlib import Path

import jax
import numpy as np

from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.data.schedule import draw_attempts
from mjx_fit.engines.select import make_engine
from mjx_fit.report import script
from mjx_fit.utils import process_setup

CHANGES = ("scene.friction=0.15", "scene.friction=0.3", "scene.friction=0.6", "scene.friction=0.8")
CHANGES += ("control.kp_position=360",)
ATTEMPTS, SEED = 64, 3
MM_PER_M = 1000.0


def main() -> None:
    results = {change: _measured(change) for change in CHANGES}
    script.save(Path(__file__).with_suffix(".json"), {"attempts": ATTEMPTS, "seed": SEED} | results)


def _measured(change: str) -> dict[str, float]:
    config = read_config(world_file("home"), [change])
    attempts = draw_attempts(jax.random.key(SEED), np.arange(ATTEMPTS), policy="spiral", config=config)
    done = make_engine("native", config).run(attempts)
    place = np.asarray(done.felt.trace.tip_pos_world)[np.asarray(done.truth.failed), :, :2]
    start = np.asarray(attempts.estimate_world)[np.asarray(done.truth.failed), None]
    away, moved = (np.linalg.norm(way, axis=-1) for way in (place - start, np.diff(place, axis=1)))
    reach, path = np.nanmax(away, 1).mean(), np.nansum(moved, 1).mean()
    return {"reach_mm": round(MM_PER_M * float(reach), 1), "path_mm": round(MM_PER_M * float(path), 1)}


if __name__ == "__main__":
    process_setup.configure()
    main()
