"""LeRobot data sets, version 3.0: parquet tables with a row for each frame, 10 frames a second.

Frame t of an episode is the situation before action t; the last one follows the last action, and its action
is 0. ``observation.wrench`` holds the 50 wrenches of the 0.1 s before the frame.
Source of the layout: the documentation of ``LeRobotDataset`` v3.0, and the loader of LeRobot 0.4.4.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mjx_fit.config.schema import config_from_stored
from mjx_fit.data.exports import frames as frame
from mjx_fit.data.exports.frame_statistics import FrameStatistics
from mjx_fit.data.exports.frames import Frames, features_of, frames_of
from mjx_fit.data.exports.recording import Recording, recordings, truth_of
from mjx_fit.data.manifest import Manifest, knows_truth
from mjx_fit.utils import locks
from mjx_fit.utils.progress import Progress
from mjx_fit.utils.rates import ACTION_S

try:
    import pandas
    import pyarrow as pa
    from pyarrow import parquet
except ImportError:
    raise ImportError(
        "LeRobot's files need pyarrow, which is not installed: pip install 'mjx-fit[logs]'"
    ) from None

VERSION = "v3.0"
INFO, STATISTICS, TASKS, MAP = "meta/info.json", "meta/stats.json", "meta/tasks.parquet", "map.yaml"
FILES_IN_CHUNK = 1000
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_MEGABYTES = 100


def map_of(manifest: Manifest) -> dict[str, Any]:
    """Return the map of a data set's folder (``mjx_fit.data.logs.log_map``)."""
    config = config_from_stored(manifest.request["config"])

    def state(names: tuple[str, ...]) -> list[str]:
        return [f"{frame.STATE}:{name}" for name in names]

    return {
        "wrench": {
            "source": frame.WINDOW,
            "acts_on": "peg",
            "sensor_in_tool": {"position_m": [0.0, 0.0, -config.scene.peg_length_m]},
        },
        "pose": {"source": state(frame.POSE), "rotation": "quat_wxyz"},
        "twist": {"source": state(frame.TWIST)},
        "command": {"source": [f"{frame.ACTION}:{name}" for name in frame.COMMAND]},
        "attempts": {
            "by": "column",
            "source": "episode_index",
            "peg_source": frame.PEG,
            "estimate_source": frame.ESTIMATE,
            "tare_s": ACTION_S,
        },
        **truth_of(manifest, frame.HOLE, frame.PLACE, frame.SUCCESS),
    }


def write_lerobot(folder: Path, manifest: Manifest, out: Path) -> None:
    """Write the attempts of a data set; the folder appears when all of them are there."""
    with locks.holding_file(out):
        partial = out.with_name(f".{out.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        try:
            _write(folder, manifest, partial)
            partial.replace(out)
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def _write(folder: Path, manifest: Manifest, out: Path) -> None:
    config = config_from_stored(manifest.request["config"])
    writer = _Writer(out, config.scene.names)
    turns = False
    with Progress("export: shard", len(manifest.shards)) as progress:
        for done, attempts in enumerate(recordings(folder, manifest), 1):
            turns = turns or any(one.turn_world is not None for one in attempts)
            if attempts:
                writer.add(attempts)
            progress(done)
    features = features_of(config, turns, knows_truth(manifest.request))
    writer.finish(features, config.scene.robot)
    (out / MAP).write_text(yaml.safe_dump(map_of(manifest)))


class _Writer:
    """Tables of frames and of episodes, a file of each for each shard."""

    def __init__(self, out: Path, pegs: tuple[str, ...]):
        self._out, self._tasks = out, [f"insert the peg {name}" for name in pegs]
        self._pegs = pegs
        self._statistics = FrameStatistics()
        self._files = self._episodes = self._frames = 0

    def add(self, attempts: list[Recording]) -> None:
        """Write the frames and episodes of a shard."""
        place = {"chunk_index": self._files // FILES_IN_CHUNK, "file_index": self._files % FILES_IN_CHUNK}
        tables, episodes = [], []
        for one in attempts:
            frames, task = frames_of(one), self._pegs.index(one.peg)
            n = len(frames["timestamp"])
            frames["episode_index"] = np.full(n, self._episodes)
            frames["index"] = self._frames + np.arange(n)
            frames["task_index"] = np.full(n, task)
            tables.append(frames)
            episodes.append(self._episode(frames, place, self._tasks[task]))
            self._episodes, self._frames = self._episodes + 1, self._frames + n
        joined = {name: np.concatenate([one[name] for one in tables]) for name in tables[0]}
        table = pa.table({name: _column(values) for name, values in joined.items()})
        self._save("data", place, table)
        self._save("meta/episodes", place, pa.Table.from_pylist(episodes))
        self._files += 1

    def finish(self, features: dict[str, Any], robot: str) -> None:
        """Write what describes the whole."""
        info = {
            "codebase_version": VERSION,
            "robot_type": robot,
            "total_episodes": self._episodes,
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            "chunks_size": FILES_IN_CHUNK,
            "data_files_size_in_mb": _MEGABYTES,
            "video_files_size_in_mb": 2 * _MEGABYTES,
            "fps": round(1 / ACTION_S),
            "splits": {"train": f"0:{self._episodes}"},
            "data_path": f"data/{_FILE}",
            "video_path": None,
            "features": features,
        }
        (self._out / "meta").mkdir(parents=True, exist_ok=True)
        (self._out / INFO).write_text(json.dumps(info, indent=2))
        (self._out / STATISTICS).write_text(json.dumps(self._statistics.total()))
        tasks = pandas.DataFrame({"task_index": range(len(self._tasks))}, index=pandas.Index(self._tasks))
        tasks.to_parquet(self._out / TASKS)

    def _episode(self, frames: Frames, place: dict[str, int], task: str) -> dict[str, Any]:
        n = len(frames["timestamp"])
        found = {
            "episode_index": self._episodes,
            "tasks": [task],
            "length": n,
            "dataset_from_index": self._frames,
            "dataset_to_index": self._frames + n,
        }
        for part in ("data", "meta/episodes"):
            found |= {f"{part}/{name}": index for name, index in place.items()}
        for name, values in self._statistics.add(frames).items():
            found |= {f"stats/{name}/{what}": value for what, value in values.items()}
        return found

    def _save(self, part: str, place: dict[str, int], table: Any) -> None:
        path = self._out / part / _FILE.format(**place)
        path.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(table, path)


def _column(values: np.ndarray[Any, Any]) -> Any:
    """Return a column; rows of several numbers are lists, and windows lists of lists."""
    if values.dtype.kind == "U":
        return pa.array(values.tolist(), pa.string())
    if values.dtype == np.float64:
        values = values.astype(np.float32)
    column = pa.array(values.ravel())
    for size in reversed(values.shape[1:]):
        column = pa.FixedSizeListArray.from_arrays(column, size)
    return column
