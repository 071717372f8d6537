"""Judge the sensor for NIST's parts outside of its training's world, after ``learned.py OUT``; resumes.

    python experiments/parts/shifted.py OUT [SHIFT ...]

Each shift collects 600 attempts, two at each of 300 holes, and judges the sensor on those that failed:
``seed`` differs in its draws only, ``stiff`` has the default contact, almost twice as stiff as the
training's, ``home`` has the default friction, gains and readings, and ``mjx`` is the other engine.
Results are in ``shifted.json``.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from learned import HERE, TASK

from mjx_fit.evaluation import results
from mjx_fit.report import script
from mjx_fit.utils import process_setup

FILE = HERE / "shifted.json"
METRICS = ("position_error_cm", "coverage_50", "coverage_90", "match_auroc", "type_accuracy")
ATTEMPTS = ("--episodes", 600, "--sequence", 2, "--seed", 36)
SHIFTS: dict[str, tuple[object, ...]] = {
    "seed": (),
    "stiff": ("--set", "scene.contact_time_per_gap=11"),
    "home": ("--world", "home"),
    "mjx": ("--engine", "mjx"),
}


def main(out: Path, shifts: list[str]) -> None:
    """Collect and judge; keep the other shifts of ``shifted.json``."""
    found = json.loads(FILE.read_text())["shifts"] if FILE.exists() else {}
    for name in shifts:
        found[name] = shifted(out, name)
        script.save(FILE, {"shifts": found})


def shifted(out: Path, name: str) -> dict[str, Any]:
    """Return position errors, coverage and AUROC of the sensor on failed attempts, with their intervals."""
    data, result = out / f"shifted_{name}", out / f"calibration_{name}.json"
    script.command("collect", "--out", data, *ATTEMPTS, *TASK, *SHIFTS[name])
    world = SHIFTS[name] if name != "mjx" else ()
    judged = ("--data", data, "--run", out / "run", "--out", result)
    script.command("evaluate", "calibration", *judged, *TASK, *world)
    return {group: scores(result, group) for group in ("all", "attempt:1")}


def scores(result: Path, group: str) -> dict[str, list[float | int | None]]:
    """Return the scores of a group of attempts, each with its interval and number."""
    of_group = [row for row in results.read(result).summary if row.group == group]
    return {
        f"{row.method}_{row.metric}": [row.value, row.low, row.high, row.n]
        for row in of_group
        if (row.method, row.metric) == ("prior", "position_error_cm")
        or (row.method == "full" and row.metric in METRICS)
    }


if __name__ == "__main__":
    process_setup.configure()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("shifts", nargs="*", choices=SHIFTS, default=list(SHIFTS), metavar="SHIFT")
    asked = parser.parse_args()
    main(asked.out, asked.shifts)
