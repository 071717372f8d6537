"""Put the samples of a signal in order, and say what was wrong with them.

Samples that are not finite, and samples at a time that another one has, are left out. Samples that come late
by at most ``MOST_LATE_S`` are sorted. A clock that goes back further belongs to two recordings, and a signal
that is slower than the library needs tells too little: such logs are refused.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.data.logs.findings import Finding
from mjx_fit.data.logs.raw_log import Stream

MOST_LATE_S = 0.05
"""Longest time by which a sample may come after a later one."""
LEAST_HZ = {"wrench": 90.0, "pose": 9.0, "command": 5.0, "twist": 9.0}
"""Lowest mean rates: those of 100 and 10 Hz, a little late."""
FROZEN_S = 0.1
"""A wrench that does not change at all for so long comes from a sensor that has stopped."""


def cleaned(name: str, stream: Stream) -> tuple[Stream, list[Finding]]:
    """Return a signal with finite values at increasing times, and what was found."""
    found: list[Finding] = []
    finite = np.isfinite(stream.values).all(1) & np.isfinite(stream.time_s)
    if not finite.all():
        first = _first(~finite, stream.time_s)
        found.append(_left_out(name, int((~finite).sum()), "not finite", first))
    stream = _where(stream, finite)
    if len(stream.time_s) < 2:
        return stream, [*found, Finding("refused", f"{name}: it has {len(stream.time_s)} usable samples")]
    stream, disorder = _sorted(name, stream)
    found += disorder
    again = np.concatenate([[False], np.diff(stream.time_s) <= 0])
    if again.any():
        found.append(
            _left_out(name, int(again.sum()), "at the time of another", _first(again, stream.time_s))
        )
    stream = _where(stream, ~again)
    return stream, found + _slow(name, stream)


class BadTime(NamedTuple):
    """Interval at which the wrench is wrong, s.

    Attributes:
        begin_s: Its begin.
        end_s: Its end.
        why: What is wrong.
        stopped: Whether the sensor had stopped; in free motion that does no harm.
    """

    begin_s: float
    end_s: float
    why: str
    stopped: bool = False


def bad_times(wrench: Stream, most: float) -> list[BadTime]:
    """Find where a sensor was at the end of its range, or had stopped.

    Args:
        wrench: Wrenches in the log's units.
        most: Largest force that it measures, in these units.
    """
    found, time, values = [], wrench.time_s, wrench.values
    for begin, end in runs(np.abs(values[:, :3]).max(1) >= most):
        found.append(BadTime(float(time[begin]), float(time[end - 1]), "the force is saturated"))
    for begin, end in runs(np.concatenate([[False], (np.diff(values, axis=0) == 0).all(1)])):
        first, last = float(time[begin - 1]), float(time[end - 1])
        if last - first >= FROZEN_S:
            text = f"the wrench does not change for {last - first:.3f} s: the sensor stopped"
            found.append(BadTime(first, last, text, stopped=True))
    return found


def runs(which: Bool[np.ndarray, "N"]) -> list[tuple[int, int]]:
    """Return the first index, and that after the last one, of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], which.astype(np.int8), [0]])))
    return [(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


def _sorted(name: str, stream: Stream) -> tuple[Stream, list[Finding]]:
    time = stream.time_s
    late = np.maximum.accumulate(time) - time
    if late.max() <= 0:
        return stream, []
    i = int(late.argmax())
    if late.max() > MOST_LATE_S:
        text = (
            f"{name}: the clock goes back by {late[i]:.3f} s: cut the log there; at most {MOST_LATE_S} s are "
            "sorted"
        )
        first = int((late > MOST_LATE_S).argmax())
        return stream, [Finding("refused", text, float(time[first]))]
    text = f"{name}: {int((late > 0).sum())} samples come late, by up to {1000 * late.max():.1f} ms: sorted"
    found = [Finding("repaired", text, float(time[int((late > 0).argmax())]))]
    order = np.argsort(time, kind="stable")
    return Stream(time[order], stream.values[order]), found


def _slow(name: str, stream: Stream) -> list[Finding]:
    """Refuse a signal that is too slow; its gaps are those of single attempts."""
    step = float(np.median(np.diff(stream.time_s))) if len(stream.time_s) > 1 else np.inf
    if step <= 1 / LEAST_HZ[name]:
        return []
    text = f"{name}: {1 / step:.3g} samples per second are too few: expected at least {LEAST_HZ[name]:g}"
    return [Finding("refused", text)]


def _where(stream: Stream, which: Bool[np.ndarray, "N"]) -> Stream:
    return Stream(stream.time_s[which], stream.values[which])


def _first(which: Bool[np.ndarray, "N"], time: Float[np.ndarray, "N"]) -> float | None:
    """Return the time of the first, or of the last one before it that is finite."""
    known = time[: int(which.argmax()) + 1]
    known = known[np.isfinite(known)]
    return float(known[-1]) if len(known) else None


def _left_out(name: str, count: int, what: str, at_s: float | None) -> Finding:
    samples = "1 sample is" if count == 1 else f"{count} samples are"
    return Finding("repaired", f"{name}: {samples} {what}: left out", at_s)
