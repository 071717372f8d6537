"""From a log to attempts: read, clean, convert, cut, resample, and check against the laws of contact."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.data.logs import cutting
from mjx_fit.data.logs.attempt_facts import AttemptFacts, LoggedTruth, facts_of
from mjx_fit.data.logs.cleaning import FROZEN_S, BadTime, bad_times, cleaned
from mjx_fit.data.logs.consistency import inconsistencies
from mjx_fit.data.logs.cutting import Span
from mjx_fit.data.logs.findings import Finding
from mjx_fit.data.logs.lateness import late_wrenches
from mjx_fit.data.logs.log_map import LogMap
from mjx_fit.data.logs.raw_log import RawLog
from mjx_fit.data.logs.signals import FORCE_N, Signals, signals_of
from mjx_fit.data.logs.sources import read_raw
from mjx_fit.scene.robot import ROBOTS, Robot
from mjx_fit.sensors.resampling import felt_from_log
from mjx_fit.sensors.sensor_log import SensorLog
from mjx_fit.types import Felt
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.rates import ACTION_S

MOST_M = 5.0
"""A TCP further than this from the origin is in other units."""
MOST_COMMAND_M = 0.05
"""So is a command, in the median, of a longer way than this in 0.1 s."""
_PLACED = ": check pose.base_in_world and pose.tool_in_pose"
_OFF_GRID_S = 0.02


@dataclass(frozen=True)
class LoggedAttempt:
    """One attempt of a log.

    Attributes:
        name: Its label, or its number among all attempts of the log, those that are left out included.
        begin_s: Start of its first action, in the time of the log, s.
        end_s: End of its last action, s.
        label: Its label in the log; None: the log has none.
        log: Its samples, in the library's units, frames and signs.
        felt: The same, resampled to the library's times.
        truth: What is known about it afterwards; None: the map does not say.
    """

    name: str
    begin_s: float
    end_s: float
    label: str | None
    log: SensorLog
    felt: Felt
    truth: LoggedTruth | None


@dataclass(frozen=True)
class ImportedLog:
    """Attempts of a log, and what was found in it.

    Attributes:
        name: Name of the file.
        attempts: The attempts that can be used.
        findings: One line each about what is wrong. With one that is ``refused`` there is no attempt.
    """

    name: str
    attempts: tuple[LoggedAttempt, ...]
    findings: tuple[Finding, ...]

    @property
    def refused(self) -> bool:
        """Whether the log cannot be used."""
        return _refused(self.findings)


def import_log(path: Path | str, said: LogMap, config: Config) -> ImportedLog:
    """Read the attempts of a log.

    Args:
        path: The log (``mjx_fit.data.logs.sources``).
        said: Its map.
        config: Defines the parts, the robot's workspace and the length of the peg.

    Raises:
        RequestError: The file cannot be read or lacks a signal, or the map does not suit it. What is wrong
            with its samples is a finding.
    """
    raw = read_raw(Path(path), said)
    raw, bad, findings = _in_order(raw, said)
    if _refused(findings):
        return ImportedLog(raw.name, (), tuple(findings))
    signals = signals_of(raw, said, config)
    facts = facts_of(raw, said, config)
    findings += _out_of_place(signals)
    spans: list[Span] = []
    if not _refused(findings):
        spans, cut = _cut(signals, raw, said)
        findings += [*cut, *late_wrenches(signals, spans)]
        spans = cutting.tared(spans, said.attempts.tare_s)
    attempts, robot = [], ROBOTS[config.scene.robot]
    for number, span in enumerate(spans):
        name = str(number) if span.label is None else span.label
        try:
            next_s = spans[number + 1].begin_s if number + 1 < len(spans) else math.inf
            attempts.append(_attempt(signals, span, (name, next_s), (bad, facts), robot))
        except RequestError as error:
            hint = _PLACED if "outside the workspace" in str(error) else ""
            findings.append(Finding("left out", f"attempt {name}: {error}{hint}", span.begin_s))
    findings += inconsistencies([one.felt for one in attempts], config)
    if not attempts and not _refused(findings):
        findings.append(Finding("refused", "no attempt can be used"))
    told = ImportedLog(raw.name, tuple(attempts), tuple(findings))
    return replace(told, attempts=()) if told.refused else told


def _refused(findings: Iterable[Finding]) -> bool:
    return any(one.severity == "refused" for one in findings)


def _in_order(raw: RawLog, said: LogMap) -> tuple[RawLog, list[BadTime], list[Finding]]:
    """Return the log with its samples in order, times at which the wrench is wrong, and what was found."""
    streams, findings, bad = {}, [], []
    for name, stream in raw.streams.items():
        if name in ("estimate", "place"):  # one for each attempt
            streams[name] = stream
            continue
        streams[name], found = cleaned(name, stream)
        findings += found
    if not _refused(findings):
        bad = bad_times(streams["wrench"], said.wrench.most_n / FORCE_N[said.wrench.force])
    return replace(raw, streams=streams), bad, findings


def _out_of_place(signals: Signals) -> list[Finding]:
    """Find positions in other units."""
    far = np.linalg.norm(signals.tip_pos_world, axis=1)
    if signals.command_world is not None:
        way = float(np.median(np.linalg.norm(signals.command_world, axis=1)))
        if way > MOST_COMMAND_M:
            text = f"command: {way:.4g} m in an action is too far: check command.length and command.kind"
            return [Finding("refused", text, float(signals.pose_time_s[0]))]
    if np.median(far) <= MOST_M:
        return []
    text = (
        f"pose: the TCP is {np.median(far):.4g} m from the origin: expected at most {MOST_M:g}: check "
        "pose.length (m or mm) and pose.base_in_world"
    )
    return [Finding("refused", text, float(signals.pose_time_s[0]))]


def _cut(signals: Signals, raw: RawLog, said: LogMap) -> tuple[list[Span], list[Finding]]:
    match said.attempts.by:
        case "contact":
            spans, found = cutting.spans_of_contact(signals)
        case "file":
            spans, found = cutting.whole(signals)
        case "column":
            spans, found = cutting.spans_of_labels(signals, raw.labels["attempts"])
    return spans, found


def _attempt(
    signals: Signals,
    span: Span,
    place: tuple[str, float],
    known: tuple[list[BadTime], AttemptFacts],
    robot: Robot,
) -> LoggedAttempt:
    """Return an attempt, checked and resampled.

    Args:
        signals: The log.
        span: Where it is.
        place: Its name, and when the next one begins, s.
        known: What is wrong in the log, and what is known of its attempts.
        robot: The robot.

    Raises:
        RequestError: Samples are missing, saturated, or out of the robot's workspace.
    """
    (name, next_s), (bad, facts) = place, known
    for one in bad:
        if _harms(one, span):
            raise RequestError(f"{one.why} at {one.begin_s:.3f} s")
    times, commands = _commands(signals, span)
    log = _within(signals, span, times, commands)
    begin = float(times[0])
    estimate = _at(signals, times[:1])[0, :2] if facts.estimate_at is None else facts.estimate_at(begin)
    felt = felt_from_log(log, facts.peg_at(begin), np.asarray(estimate, np.float32), robot)
    end = float(times[-1]) + ACTION_S
    truth = None if facts.truth_of is None else facts.truth_of(begin, end, next_s)
    return LoggedAttempt(name, begin, end, span.label, log, felt, truth)


def _harms(one: BadTime, span: Span) -> bool:
    """Tell whether an interval is in an attempt; where the sensor stopped, in its contact."""
    begin = max(span.begin_s, span.free_s[1]) if one.stopped else span.begin_s
    return one.begin_s < span.end_s - one.stopped * FROZEN_S and one.end_s > begin + one.stopped * FROZEN_S


def _commands(signals: Signals, span: Span) -> tuple[Float[np.ndarray, "J"], Float[np.ndarray, "J 3"]]:
    """Return start times of actions and their displacements; those of the TCP where there are no commands."""
    if signals.command_time_s is None or signals.command_world is None:
        count = int((span.end_s - span.begin_s) / ACTION_S + 1e-6)
        times = span.begin_s + ACTION_S * np.arange(count)
        return times, _at(signals, times + ACTION_S) - _at(signals, times)
    inside = (signals.command_time_s >= span.begin_s - _OFF_GRID_S) & (
        signals.command_time_s <= span.end_s - ACTION_S + _OFF_GRID_S
    )
    if not inside.any():
        raise RequestError(f"command: none between {span.begin_s:.3f} and {span.end_s:.3f} s")
    return signals.command_time_s[inside], signals.command_world[inside]


def _at(signals: Signals, times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
    """Return positions of the TCP."""
    columns = signals.tip_pos_world.T
    return np.column_stack([np.interp(times, signals.pose_time_s, column) for column in columns])


def _within(
    signals: Signals, span: Span, times: Float[np.ndarray, "J"], commands: Float[np.ndarray, "J 3"]
) -> SensorLog:
    """Return the samples of an attempt and of the free motion before it, with one more on either side."""
    begin, end = min(span.begin_s, span.free_s[0]), times[-1] + ACTION_S
    wrench, pose = (_around(time, begin, end) for time in (signals.wrench_time_s, signals.pose_time_s))
    return SensorLog(
        wrench_time_s=signals.wrench_time_s[wrench],
        wrench_sensor=signals.wrench_sensor[wrench],
        pose_time_s=signals.pose_time_s[pose],
        tip_pos_world=signals.tip_pos_world[pose],
        tip_quat_world=signals.turns[pose].as_quat(scalar_first=True),
        command_time_s=times,
        command_world=commands,
        free_s=np.array(span.free_s),
        tip_linvel_world=None if signals.linvel_world is None else signals.linvel_world[pose],
        tip_angvel_world=None if signals.angvel_world is None else signals.angvel_world[pose],
    )


def _around(time: Float[np.ndarray, "N"], begin: float, end: float) -> slice:
    first, last = np.searchsorted(time, begin, "right") - 1, np.searchsorted(time, end, "left") + 1
    return slice(max(int(first), 0), int(last))
