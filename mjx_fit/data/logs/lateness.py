"""Do wrenches and poses have the same clock? Where a tool that comes down is stopped, a force begins.

The descent ends when the height, falling at its speed, reaches that of the contact that follows. With poses
every 0.1 s forces begin 0.03 to 0.08 s before it (48 simulated attempts, 2026-12-01); a tool that rocks, or a
path without such a descent, tells nothing, and no attempts then agree.
"""

import numpy as np

from mjx_fit.data.logs.cutting import CLEAR_S, Span
from mjx_fit.data.logs.findings import Finding
from mjx_fit.data.logs.signals import Signals

MOST_OFF_S = 0.045
"""Largest lateness that is taken for that of poses."""
AGREE_S = 0.05
"""Largest difference between attempts whose lateness is believed."""
USUAL_S = -0.04
"""Lateness of the wrenches of a good log."""
LEAST_ATTEMPTS = 2
_LEAST_MPS = 0.003
_ABOVE_M = 0.0005
_STEP_S = 0.002
_SEARCHED_S = 0.8


def late_wrenches(signals: Signals, spans: list[Span]) -> list[Finding]:
    """Return what the beginnings of contact say about the clocks."""
    found = [one for span in spans if (one := _lateness(signals, span)) is not None]
    if len(found) < LEAST_ATTEMPTS or np.ptp(found) > AGREE_S:
        return []
    off = float(np.median(found)) - USUAL_S
    if abs(off) <= MOST_OFF_S:
        return []
    side = "after" if off > 0 else "before"
    text = (
        f"wrench: forces begin {1000 * abs(off):.0f} ms {side} the tool is stopped: expected the same clock"
    )
    return [Finding("refused", text, spans[0].begin_s)]


def _lateness(signals: Signals, span: Span) -> float | None:
    """Return by how much the force begins after the descent ends, s; None: there is no such descent."""
    touch = span.free_s[1] + CLEAR_S
    time = np.arange(touch - _SEARCHED_S, touch + _SEARCHED_S, _STEP_S)
    height = np.interp(time, signals.pose_time_s, signals.tip_pos_world[:, 2])
    rest = float(np.median(height[(time > touch + 0.3)]))
    below = np.flatnonzero(height < rest + _ABOVE_M)
    if not len(below):
        return None
    at, back = int(below[0]), round(0.2 / _STEP_S)
    if at < back:
        return None
    speed = (height[at - back] - height[at]) / (_STEP_S * back)
    if speed < _LEAST_MPS:
        return None
    return touch - float(time[at] + _ABOVE_M / speed)
