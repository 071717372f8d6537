"""Samples of one signal as they come, in memory that is reserved once."""

import numpy as np
from jaxtyping import Float

from mjx_fit.utils.errors import RequestError


class SampleBuffer:
    """Samples in order of time.

    Attributes:
        left_out: Number of samples that came too late, or were not finite.
    """

    def __init__(self, name: str, most: int, width: int):
        """Reserve memory.

        Args:
            name: What the samples are, for messages.
            most: Most samples that are kept.
            width: Numbers in a sample.
        """
        self._name = name
        self._time, self._values = np.empty(most), np.empty((most, width))
        self._count = self.left_out = 0

    def __len__(self) -> int:
        return self._count

    @property
    def time_s(self) -> Float[np.ndarray, "n"]:
        """Times, s."""
        return self._time[: self._count]

    @property
    def values(self) -> Float[np.ndarray, "n width"]:
        """Samples."""
        return self._values[: self._count]

    @property
    def last_s(self) -> float:
        """Time of the last sample, s; -inf: there is none."""
        return float(self._time[self._count - 1]) if self._count else -np.inf

    @property
    def full(self) -> bool:
        """Whether no sample more is kept."""
        return self._count == len(self._time)

    def add(self, time_s: float, values: Float[np.ndarray, "width"]) -> None:
        """Keep a sample, unless it comes after a later one or is not finite.

        Raises:
            RequestError: It has another shape.
        """
        if np.shape(values) != self._values.shape[1:]:
            expected = self._values.shape[1:]
            raise RequestError(
                f"online: {self._name}: shape {np.shape(values)} is invalid: expected {expected}"
            )
        if self.full or not self.last_s < time_s < np.inf or not np.isfinite(values).all():
            self.left_out += not self.full
            return
        self._time[self._count], self._values[self._count] = time_s, values
        self._count += 1

    def forget_before(self, time_s: float) -> None:
        """Forget samples before a time."""
        first = int(np.searchsorted(self.time_s, time_s))
        kept = self._count - first
        self._time[:kept] = self._time[first : self._count].copy()
        self._values[:kept] = self._values[first : self._count].copy()
        self._count = kept

    def clear(self) -> None:
        """Forget all samples."""
        self._count = self.left_out = 0
