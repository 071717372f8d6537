"""Insertions of REASSEMBLE: import your download, draw its attempts, and score what its sensors tell.

    python experiments/real/reassemble.py 2025-01-09-13-59-54.h5 ... --out OUT [--map reassemble.yaml]

Files have the layout of the data set's README; the poses of the board are in `NAME_poses.json` beside them or
in `../poses`. Nothing is downloaded. `OUT` gets each recording as an npz file that `mjx-fit log check` and
`log import` read with `OUT/NAME.yaml`, a figure of its insertions, and `scores.json`. A peg is taken to be in
if the tool ends at least DEPTH_M below the face of the board; the labels say who was right.
"""

import argparse
import json
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np
import yaml
from matplotlib.figure import Figure

import mjx_fit as mf
from mjx_fit.data.logs.importing import ImportedLog, LoggedAttempt, import_log
from mjx_fit.data.logs.log_map import read_map
from mjx_fit.report import script
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.utils.errors import RequestError

MAP = Path(__file__).parent / "reassemble.yaml"
DEPTH_M, LAST = 0.005, 3
"""Depth of an insertion, and actions whose height counts as the end."""
CONFIG = mf.Config()


@dataclass(frozen=True)
class Segment:
    """An insertion as the annotators saw it: its number, times (s), words, and whether it succeeded."""

    number: int
    begin_s: float
    end_s: float
    text: str
    success: bool


def segments_of(file: h5py.File) -> list[Segment]:
    """Return the insertions of a recording."""
    found = []
    for name in sorted(cast(h5py.Group, file["segments_info"]), key=int):
        text, begin, end, success = (
            values(file, f"segments_info/{name}/{key}") for key in ("text", "start", "end", "success")
        )
        text = text.decode() if isinstance(text, bytes) else str(text)
        if text.lower().startswith("insert"):
            found.append(Segment(int(name), float(begin), float(end), text, bool(success)))
    return sorted(found, key=lambda one: one.begin_s)


def values(file: h5py.File, name: str) -> Any:
    """Return what a data set of a file holds."""
    return cast(h5py.Dataset, file[name])[()]


def convert(path: Path, said: Path, out: Path) -> tuple[Path, Path, list[Segment]]:
    """Write a recording as arrays with a map of its own; return both files and its insertions."""
    with h5py.File(path) as file:
        segments = segments_of(file)
        force, torque, pose = (
            values(file, f"robot_state/{name}") for name in ("measured_force", "measured_torque", "pose")
        )
        names = ("measured_force", "measured_torque", "pose")
        times = {name: values(file, f"timestamps/{name}").ravel() for name in names}
    if not segments:
        raise RequestError(f"{path}: no segment is an insertion")
    at = times["measured_force"]
    # Each has a clock of its own: torques are read at the times of the forces.
    torque = np.column_stack([np.interp(at, times["measured_torque"], column) for column in torque.T[:3]])
    # Where one insertion ends when another begins, the beginning counts.
    for one, other in pairwise(segments):
        if other.begin_s < one.end_s:
            raise RequestError(f"{path}: segments {one.number} and {other.number} overlap")
    edges = [(one.begin_s, one.number) for one in segments] + [(one.end_s, -1) for one in segments]
    edges = np.array(sorted(edges, key=lambda edge: (edge[0], edge[1] >= 0)))
    arrays = {
        "wrench": np.column_stack([force, torque]),
        "wrench_time": at,
        "pose": pose,
        "pose_time": times["pose"],
        "trial": edges[:, 1].astype(int),
        "attempts_time": edges[:, 0],
    }
    tree = yaml.safe_load(said.read_text())
    base = tree["pose"].setdefault("base_in_world", {})
    x, y, _ = base.get("position_m", (0.0, 0.0, 0.0))
    base["position_m"] = [x, y, plate_top_m(CONFIG.scene) - board_height_m(path)]
    arrays_file, map_file = out / f"{path.stem}.npz", out / f"{path.stem}.yaml"
    np.savez(arrays_file, **arrays)
    map_file.write_text(yaml.safe_dump(tree))
    return arrays_file, map_file, segments


def board_height_m(path: Path) -> float:
    """Return the height of the board's origin in the frame of the base, m."""
    name = f"{path.stem}_poses.json"
    for file in (path.parent / name, path.parent.parent / "poses" / name):
        if file.exists():
            poses = json.loads(file.read_text())
            if "NIST_Board1" not in poses:
                raise RequestError(f"{file}: NIST_Board1 is missing")
            return float(poses["NIST_Board1"][0][2])
    raise RequestError(f"{path}: {name} is missing: expected beside it or in ../poses")


def depth_m(attempt: LoggedAttempt) -> float:
    """Return how far below the face of the board the tool ends, m."""
    height = np.asarray(attempt.felt.trace.tip_pos_world)[-LAST:, 2].mean()
    return float(plate_top_m(CONFIG.scene) - height)


def scored(log: ImportedLog, segments: list[Segment]) -> list[dict[str, Any]]:
    """Return what was labelled and what the sensors tell, for each insertion that could be read."""
    attempts = {one.label: one for one in log.attempts}
    return [
        {
            "segment": one.number,
            "text": one.text,
            "labelled": one.success,
            "depth_m": round(depth_m(attempts[str(one.number)]), 5),
            "sensed": depth_m(attempts[str(one.number)]) >= DEPTH_M,
        }
        for one in segments
        if str(one.number) in attempts
    ]


def drawn(log: ImportedLog, rows: list[dict[str, Any]]) -> Figure:
    """Draw force along the tool and height of each insertion."""
    figure = Figure(figsize=(9, 2.2 * max(1, len(rows))), layout="constrained")
    panels = figure.subplots(max(1, len(rows)), 1, squeeze=False)[:, 0]
    attempts = {one.label: one for one in log.attempts}
    for panel, row in zip(panels, rows, strict=False):
        one = attempts[str(row["segment"])]
        wrench = np.asarray(one.felt.trace.wrench_sensor) - np.asarray(one.felt.tare_sensor)
        force = wrench[:, :, 2].ravel()
        panel.plot(one.begin_s + 0.002 * np.arange(len(force)), force, color="#0072B2", linewidth=0.8)
        panel.set_ylabel("F_z, N", color="#0072B2")
        beside = panel.twinx()
        height = 1000 * np.asarray(one.felt.trace.tip_pos_world)[:, 2]
        beside.plot(one.begin_s + 0.1 * (1 + np.arange(len(height))), height, color="#D55E00")
        beside.set_ylabel("height, mm", color="#D55E00")
        told = [("labelled", row["labelled"]), ("sensed", row["sensed"])]
        words = ", ".join(f"{name} {'in' if what else 'not in'}" for name, what in told)
        panel.set_title(f"{row['text']}: {words}", fontsize=9)
    panels[-1].set_xlabel("time, s")
    return figure


def main(paths: list[Path], said: Path, out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    told: dict[str, Any] = {}
    read_map(said)  # refuse before any work
    for path in paths:
        try:
            arrays, own_map, segments = convert(path, said, out)
            log = import_log(arrays, read_map(own_map), CONFIG)
        except (RequestError, OSError, KeyError) as error:
            told[path.name] = {"findings": [f"refused: {error}"], "insertions": []}
            print(f"{path.name}: refused: {error}")
            continue
        rows = scored(log, segments)
        told[path.name] = {"findings": [str(one) for one in log.findings], "insertions": rows}
        print(f"{path.name}: {len(rows)} of {len(segments)} insertions can be read")
        for finding in log.findings:
            print(f"  {finding}")
        if rows:
            drawn(log, rows).savefig(out / f"{path.stem}.png", dpi=110)
    rows = [row for one in told.values() for row in one["insertions"]]
    right = sum(row["labelled"] == row["sensed"] for row in rows)
    print(f"the sensors tell what the labels say in {right} of {len(rows)} insertions")
    script.save(out / "scores.json", {"recordings": told, "right": right, "of": len(rows)})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE.h5")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--map", type=Path, default=MAP, help="default: reassemble.yaml beside this script")
    asked = parser.parse_args()
    try:
        main(asked.files, asked.map, asked.out)
    except RequestError as error:
        sys.exit(f"reassemble.py: {error}")
