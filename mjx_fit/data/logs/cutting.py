"""Cut a log into attempts, and find the free motion before each.

An attempt begins in free motion and ends when its contact is over. Contact is a force that differs by
``TOUCH_N`` from that of free motion, for at least ``TOUCH_S``. Spells of contact less than ``APART_S`` apart
belong together. An attempt begins with its first command, or where a log without commands shows the tool set
off from rest, at most ``LEAD_S`` before the contact and not before the last one; its tare is the mean of the
free motion in that time, to ``CLEAR_S`` before the contact.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from mjx_fit.data.logs.cleaning import runs
from mjx_fit.data.logs.findings import Finding
from mjx_fit.data.logs.raw_log import Labels
from mjx_fit.data.logs.signals import Signals
from mjx_fit.utils.rates import ACTION_S

TOUCH_N = 2.0
TOUCH_S = 0.02
APART_S = 0.5
LEAD_S = 1.0
CLEAR_S = 0.05
LEAST_FREE_S = 0.1
"""Shortest free motion that gives a tare."""
LEAST_S = 3 * ACTION_S
"""Shortest attempt."""
_BASELINE_S = 0.3
"""Free motion at the beginning of a log, where its force is known to be that of no contact."""
_GRID_S = 0.002
_STILL_M = 0.0002
"""Longest way of a tool at rest in an action, m."""
_STILL_N = 1.5
"""Largest standard deviation of the force there, each axis."""


class Span(NamedTuple):
    """An attempt in a log, s.

    Attributes:
        begin_s: Start of its first action.
        end_s: Its end.
        free_s: Interval of free motion that gives its tare.
        label: Its label in the log, if attempts have labels.
    """

    begin_s: float
    end_s: float
    free_s: tuple[float, float]
    label: str | None = None


_Interval = tuple[float, float]
_Candidate = tuple[float, float, _Interval | None, str | None]
"""An attempt that may be too short, or have no free motion: as a ``Span``."""


def spans_of_contact(signals: Signals) -> tuple[list[Span], list[Finding]]:
    """Cut by contact."""
    time, force = signals.wrench_time_s, signals.wrench_sensor[:, :3]
    first = time < time[0] + _BASELINE_S
    if force[first].std(0).max() > _STILL_N:
        text = (
            f"wrench: it varies by {force[first].std(0).max():.2f} N in the first {_BASELINE_S} s: expected "
            "free motion there; or cut the log by: column"
        )
        return [], [Finding("refused", text, float(time[0]))]
    spells = _spells(time, force)
    if not spells:
        return [], [
            Finding("refused", f"wrench: no contact: no force of {TOUCH_N:g} N differs from the first")
        ]
    spans: list[_Candidate] = []
    before = float(time[0])
    for touch, leave in spells:
        earliest = max(before, touch - LEAD_S)
        begin = _sets_off(signals, earliest, touch)
        end = _stops(signals, begin, leave)
        spans.append((begin, end, _free(earliest, touch), None))
        before = leave
    return _long_enough(spans)


def _stops(signals: Signals, begin: float, leave: float) -> float:
    """Return the end of an attempt whose contact ends at ``leave``."""
    if signals.command_time_s is not None:  # they say where actions are
        return min(leave + ACTION_S, float(signals.wrench_time_s[-1]))
    # A contact that ends within the last fifth of an action was that action's.
    return begin + ACTION_S * np.floor((leave - begin) / ACTION_S + 0.2)


def _sets_off(signals: Signals, earliest: float, touch: float) -> float:
    """Return when the tool leaves its last place of rest before a contact; without one, ``earliest``."""
    if signals.command_time_s is not None:  # they say where actions are
        return earliest
    time = np.arange(earliest, touch, _GRID_S)
    at = np.column_stack([np.interp(time, signals.pose_time_s, one) for one in signals.tip_pos_world.T])
    still = round(ACTION_S / _GRID_S)
    if len(time) <= still:
        return earliest
    rests = np.linalg.norm(at[still:] - at[:-still], axis=1) < _STILL_M
    if not rests.any():
        return earliest
    last = int(np.flatnonzero(rests)[-1])
    here = np.median(at[last : last + still], axis=0)
    away = np.linalg.norm(at - here, axis=1)
    left = int(np.flatnonzero(away < _STILL_M)[-1])
    ahead = min(left + still // 2, len(time) - 1)
    speed = (away[ahead] - away[left]) / max(_GRID_S * (ahead - left), _GRID_S)
    return float(time[left] - min(away[left] / max(speed, 1e-6), ACTION_S / 2))


def _spells(time: Float[np.ndarray, "N"], force: Float[np.ndarray, "N 3"]) -> list[_Interval]:
    """Return begin and end of each spell of contact, s.

    The force of free motion follows the sensor's drift: after each spell it is that of the time after it.
    """
    base, found, start = force[time < time[0] + _BASELINE_S].mean(0), [], 0
    while start < len(time):
        away = np.linalg.norm(force[start:] - base, axis=1) > TOUCH_N
        merged = _merged(time[start:], away)
        if not merged:
            break
        touch, leave = merged[0]
        found.append((touch, leave))
        start = int(np.searchsorted(time, leave, side="right"))
        after = (time > leave + CLEAR_S) & (time < leave + APART_S - CLEAR_S)
        base = force[after].mean(0) if after.sum() > 1 else base
    return found


def _merged(time: Float[np.ndarray, "N"], away: Bool[np.ndarray, "N"]) -> list[_Interval]:
    """Return the first spell of contact, of runs that are long enough and near each other, in a list."""
    spell: _Interval | None = None
    for begin, end in runs(away):
        touch, leave = float(time[begin]), float(time[end - 1])
        if spell is None:
            spell = (touch, leave) if leave - touch >= TOUCH_S else None
        elif touch - spell[1] < APART_S:
            spell = (spell[0], leave)
        elif leave - touch >= TOUCH_S:
            break
    return [] if spell is None else [spell]


def spans_of_labels(signals: Signals, labels: Labels) -> tuple[list[Span], list[Finding]]:
    """Cut where the label changes; samples without a label do not change it.

    A negative number or an empty text is the label of what is no attempt.
    """
    has_one = labels.values == labels.values  # not NaN
    labels = Labels(labels.time_s[has_one], labels.values[has_one])
    if not len(labels.values):
        return [], [Finding("refused", "attempts: no sample has a label")]
    order = np.argsort(labels.time_s, kind="stable")
    time, values = labels.time_s[order], labels.values[order]
    change = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    ends = np.append(time[change[1:]], max(float(time[-1]), _last(signals)))
    spans = [
        (float(time[i]), float(end), str(values[i]))
        for i, end in zip(change, ends, strict=True)
        if not _means_none(values[i])
    ]
    return _long_enough([(begin, end, _free_of(signals, begin, end), label) for begin, end, label in spans])


def _means_none(label: str | float) -> bool:
    return label == "" if isinstance(label, str) else label < 0


def whole(signals: Signals) -> tuple[list[Span], list[Finding]]:
    """Take a log for one attempt."""
    begin = max(signals.wrench_time_s[0], signals.pose_time_s[0])
    if signals.command_time_s is not None and len(signals.command_time_s):
        begin = max(begin, signals.command_time_s[0])
    begin, end = float(begin), _last(signals)
    return _long_enough([(begin, end, _free_of(signals, begin, end), None)])


def _last(signals: Signals) -> float:
    return float(min(signals.wrench_time_s[-1], signals.pose_time_s[-1]))


def _free_of(signals: Signals, begin_s: float, end_s: float) -> _Interval | None:
    """Return the free motion at the beginning of an attempt, before its first contact."""
    # The peg may hang free for longer before the attempt than in it.
    inside = (signals.wrench_time_s >= begin_s - _BASELINE_S) & (signals.wrench_time_s <= end_s)
    time, force = signals.wrench_time_s[inside], signals.wrench_sensor[inside, :3]
    first = time < time[0] + LEAST_FREE_S if len(time) else np.zeros(0, bool)
    if not first.any() or force[first].std(0).max() > _STILL_N:
        return None
    spells = _merged(time, np.linalg.norm(force - force[first].mean(0), axis=1) > TOUCH_N)
    return _free(float(time[0]), spells[0][0] if spells else end_s)


def _free(begin_s: float, touch_s: float) -> _Interval | None:
    end = touch_s - CLEAR_S
    return (begin_s, end) if end - begin_s >= LEAST_FREE_S else None


def _long_enough(spans: list[_Candidate]) -> tuple[list[Span], list[Finding]]:
    kept, found = [], []
    for number, (begin, end, free, label) in enumerate(spans):
        what = f"attempt {number if label is None else label}"
        if end - begin < LEAST_S:
            text = f"{what}: it lasts {end - begin:.3f} s: expected at least {LEAST_S:.1f}"
            found.append(Finding("left out", text, begin))
        elif free is None:
            text = f"{what}: no {LEAST_FREE_S} s of free motion before its contact, and so no tare"
            found.append(Finding("left out", text, begin))
        else:
            kept.append(Span(begin, end, free, label))
    return kept, found


_BEFORE_S = 1e-5
"""The first wrench of an action is no part of the rest before it."""


def tared(spans: list[Span], rest_s: float | None) -> list[Span]:
    """Return spans whose tare is taken from so long a rest before them, s; None: as they are."""
    if rest_s is None:
        return spans
    return [one._replace(free_s=(one.begin_s - rest_s, one.begin_s - _BEFORE_S)) for one in spans]
