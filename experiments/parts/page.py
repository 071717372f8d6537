"""Print the tables of this page from the results in this folder.

python experiments/parts/page.py
"""

import json
from pathlib import Path
from typing import Any

from mjx_fit.evaluation import results

HERE = Path(__file__).parent
SPEEDS = {"raw_batch": "raw batch", "native": "`native`", "mjx": "MJX"}


def main() -> None:
    """Print all tables."""
    parts(_read("table"), _read("speed")["rows"])
    causes(_read("causes"))
    for name in ("insertion", "assembly"):
        methods(name)


def parts(table: dict[str, Any], speeds: dict[str, Any]) -> None:
    """Print geometry and speed of every part."""
    head = ["part", "area, mm²", "facets, µm", "gap", "pieces", "points", "steps", *SPEEDS.values()]
    lines = [[*head, "`native` of box", "MJX of box"]]
    for name, row in ((name, row) for name, row in table.items() if name in speeds):
        speed = speeds[name]
        lines.append(
            [
                f"`{name}`",
                f"{row['area_mm2']:.1f}",
                f"{row['facet_error_um']:.1f} of {row['facet_tolerance_um']:.0f}",
                " to ".join(dict.fromkeys(f"{one:.3f}" for one in row["gap_over_clearance"])),
                f"{row['pieces_peg']} + {row['pieces_socket']}",
                f"{speed['contact_points']:.0f}",
                str(speed["physics_steps"]),
                *(f"{speed[one]:.3g}" if one in speed else "" for one in SPEEDS),
                *(f"{speed[f'{one}_over_box']:.2f}" for one in ("native", "mjx") if one in speed),
            ]
        )
    _print(lines)


def causes(found: dict[str, Any]) -> None:
    """Print position errors by what the pegs met, and those of other sensors, by part."""
    lines = [["met", "attempts", "before, mm", "after, mm"]]
    for what, group in found["reach"].items():
        one = group["all"]
        lines.append([what, str(one["n"]), _interval(one["before_mm"]), _interval(one["after_mm"])])
    _print(lines)
    sensors = found["sensors"]
    lines = [["part", "before, mm", *sensors]]
    for part, own in sensors["all"].items():
        after = [_interval(sensor[part]["after_mm"]) for sensor in sensors.values()]
        lines.append([part, f"{own['before_mm'][0]:.2f}", *after])
    _print(
        [*lines, ["coverage of 90 %", "", *(_interval(s["all"]["coverage_90"]) for s in sensors.values())]]
    )


def methods(name: str) -> None:
    """Print each row of a result's summary that speaks of all trials."""
    lines = [["method", "metric", "group", "value", "n"]]
    for row in results.read(HERE / f"{name}.json").summary:
        spread = "" if row.low is None else f" ({row.low:.3f} to {row.high:.3f})"
        value = f"{row.value:.3f}{spread}"
        lines.append([row.method, row.metric, row.group, value, str(row.n)])
    _print(lines)


def _read(name: str) -> dict[str, Any]:
    return json.loads((HERE / f"{name}.json").read_text())


def _interval(found: list[float]) -> str:
    return "{:.2f} ({:.2f} to {:.2f})".format(*found)


def _print(lines: list[list[str]]) -> None:
    head, *body = lines
    print("", *("| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *body)), sep="\n")


if __name__ == "__main__":
    main()
