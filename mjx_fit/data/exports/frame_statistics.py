"""Statistics of features, of each episode and of all, as LeRobot normalises by them."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mjx_fit.data.exports.frames import Frames

Statistics = dict[str, dict[str, list[Any]]]
"""``min``, ``max``, ``mean``, ``std`` and ``count`` of each feature that is a number."""


class _Moments(NamedTuple):
    count: int
    least: Float[np.ndarray, "*shape"]
    most: Float[np.ndarray, "*shape"]
    total: Float[np.ndarray, "*shape"]
    squares: Float[np.ndarray, "*shape"]

    def __add__(self, other: "_Moments") -> "_Moments":  # pyright: ignore[reportIncompatibleMethodOverride]
        return _Moments(
            self.count + other.count,
            np.minimum(self.least, other.least),
            np.maximum(self.most, other.most),
            self.total + other.total,
            self.squares + other.squares,
        )

    def told(self) -> dict[str, list[Any]]:
        mean = self.total / self.count
        deviation = np.sqrt(np.maximum(self.squares / self.count - mean**2, 0))
        values = {"min": self.least, "max": self.most, "mean": mean, "std": deviation}
        return {name: value.tolist() for name, value in values.items()} | {"count": [self.count]}


class FrameStatistics:
    """Statistics of the frames of a data set, which are added an episode at a time."""

    def __init__(self) -> None:
        self._all: dict[str, _Moments] = {}

    def add(self, frames: Frames) -> Statistics:
        """Add the frames of an episode, and return its own statistics."""
        own = {name: _moments(values) for name, values in frames.items() if values.dtype.kind != "U"}
        self._all = {name: self._all[name] + one if name in self._all else one for name, one in own.items()}
        return {name: one.told() for name, one in own.items()}

    def total(self) -> Statistics:
        """Return the statistics of all frames that were added."""
        return {name: one.told() for name, one in self._all.items()}


def _moments(values: np.ndarray[Any, Any]) -> _Moments:
    numbers = np.asarray(values, np.float64)
    numbers = numbers[:, None] if numbers.ndim == 1 else numbers
    return _Moments(len(numbers), numbers.min(0), numbers.max(0), numbers.sum(0), np.square(numbers).sum(0))
