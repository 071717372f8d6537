"""LeRobot data sets, version 3: every episode is a recording of its own.

A source is a feature, or elements of features as ``FEATURE:NAME`` or ``FEATURE:INDEX``. The wrenches of a
feature of shape (k, 6) are the k samples of the time from the frame before to its own; one of shape (6,) is
a sample at the time of its frame. The last frame of an episode is the situation after its last action: its
own action was not performed.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mjx_fit.data.logs.log_map import LogMap, Source
from mjx_fit.data.logs.raw_log import Labels, RawLog, Stream
from mjx_fit.utils.errors import RequestError, shortened, shown

try:
    from pyarrow import dataset
except ImportError:
    raise ImportError(
        "LeRobot's files need pyarrow, which is not installed: pip install 'mjx-fit[logs]'"
    ) from None

INFO = "meta/info.json"
_APART_S = 2.0
_NO_ATTEMPT = -1
_VERSION = "v3"


def read_lerobot(folder: Path, asked: LogMap) -> RawLog:
    """Read the features that a map asks for.

    Raises:
        RequestError: The folder cannot be read or is of another version, or a feature is missing or has
            another shape.
    """
    about = _about(folder)
    table = _Table(folder, about)
    time, last = table.times()
    streams = {}
    for name, source in asked.sources.items():
        values = table.values(name, source)
        match name:
            case "wrench":
                streams[name] = _wrenches(folder, time, values, about["fps"])
            case "command":
                streams[name] = Stream(time[~last], values[~last])
            case _:
                streams[name] = Stream(time, values)
    labels = {}
    for name, source in asked.labels.items():
        own = table.column(source).to_numpy(zero_copy_only=False)
        none = _NO_ATTEMPT if np.issubdtype(own.dtype, np.number) else ""
        # An episode is over at its last frame.
        labels[name] = Labels(time, np.where(last, none, own)) if name == "attempts" else Labels(time, own)
    return RawLog(folder.name, streams, labels)


def _about(folder: Path) -> dict[str, Any]:
    try:
        about = json.loads((folder / INFO).read_text())
        version, fps = about["codebase_version"], about["fps"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RequestError(f"{folder / INFO} cannot be read: {type(error).__name__}: {error}") from None
    if not str(version).startswith(_VERSION):
        raise RequestError(f"{folder}: version {shown(version)} is invalid: expected {_VERSION}.x of LeRobot")
    if not isinstance(fps, int | float) or not 1 <= fps <= 10_000:
        raise RequestError(f"{folder / INFO}: fps: {shown(fps)} is invalid: expected 1 to 10000")
    return about


class _Table:
    """Frames of all episodes, and what is said about their features."""

    def __init__(self, folder: Path, about: dict[str, Any]):
        self._folder, self._fps = folder, about["fps"]
        self._features = about.get("features", {})
        try:
            self._frames = dataset.dataset(folder / "data", format="parquet").to_table()
        except (OSError, ValueError) as error:
            text = shortened(" ".join(str(error).split()), 200)
            raise RequestError(f"{folder / 'data'} cannot be read: {text}") from None
        if not self._frames.num_rows:
            raise RequestError(f"{folder / 'data'} cannot be used: it has no frames")
        order = np.lexsort([self.column(name).to_numpy() for name in ("frame_index", "episode_index")])
        self._frames = self._frames.take(order)

    def times(self) -> tuple[Float[np.ndarray, "N"], np.ndarray[Any, Any]]:
        """Return times of frames, with ``_APART_S`` between episodes, and whether each is an episode's last.

        Timestamps are single precision; a clock that all episodes share needs double.
        """
        time = np.round(self.column("timestamp").to_numpy().astype(float), 6)
        episode = self.column("episode_index").to_numpy()
        first = np.concatenate([[True], episode[1:] != episode[:-1]])
        last = np.append(first[1:], True)
        begins, lasts = time[first], time[last] - time[first]
        shift = np.concatenate([[0.0], np.cumsum(np.ceil(lasts[:-1]) + _APART_S)]) - begins
        return 1.0 + time + shift[np.cumsum(first) - 1], last

    def column(self, name: str) -> Any:
        """Return a column."""
        if name not in self._frames.column_names:
            there = shortened(", ".join(self._frames.column_names), 300)
            raise RequestError(f"{self._folder}: the feature {shown(name)} is missing: it has {there}")
        return self._frames.column(name)

    def values(self, name: str, source: Source) -> Float[np.ndarray, "N *shape"]:
        """Return a feature, or elements of features side by side."""
        if isinstance(source, str):
            return self._feature(source)
        columns = []
        for one in source:
            feature, found, element = one.rpartition(":")
            if not found:
                columns.append(self._feature(one).reshape(self._frames.num_rows, -1))
                continue
            values = self._feature(feature)
            if values.ndim != 2:
                raise RequestError(f"map: {name}.source: {shown(one)} is invalid: {feature} is no vector")
            columns.append(values[:, [self._index(feature, element, values.shape[1])]])
        return np.concatenate(columns, 1)

    def _index(self, feature: str, element: str, size: int) -> int:
        names = self._features.get(feature, {}).get("names")
        if isinstance(names, dict):
            names = next(iter(names.values()), None)
        names = [str(one) for one in names] if isinstance(names, list) else []
        if element in names:
            return names.index(element)
        if element.isdecimal() and int(element) < size:
            return int(element)
        expected = ", ".join(names) or f"0 to {size - 1}"
        raise RequestError(f"{self._folder}: {feature} has no element {shown(element)}: expected {expected}")

    def _feature(self, name: str) -> Float[np.ndarray, "N *shape"]:
        column = self.column(name)
        try:
            values = np.array(column.to_pylist(), np.float64)
        except (TypeError, ValueError):
            raise RequestError(f"{self._folder}: {name}: its frames are no numbers of one shape") from None
        return values[:, None] if values.ndim == 1 else values


def _wrenches(folder: Path, time: Float[np.ndarray, "N"], values: np.ndarray[Any, Any], fps: float) -> Stream:
    if values.ndim == 2:
        return Stream(time, values)
    if values.ndim != 3:
        raise RequestError(f"{folder}: wrench: shape {values.shape[1:]} is invalid: expected (6,) or (k, 6)")
    k = values.shape[1]
    before = (np.arange(k) - k) / (k * fps)
    return Stream((time[:, None] + before).ravel(), values.reshape(-1, values.shape[2]))
