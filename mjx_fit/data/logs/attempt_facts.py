"""What is known about each attempt of a log: its peg, where the hole was believed to be, and the truth."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.data.logs.attempts_map import AttemptsMap, TruthMap
from mjx_fit.data.logs.log_map import LogMap
from mjx_fit.data.logs.raw_log import RawLog
from mjx_fit.utils.errors import RequestError, shown

_SLACK_S = 1e-6
"""Times of bags are rounded to ns."""
_END_SLACK_S = 1e-3
"""Frames of 10 Hz are stamped in float32 at times."""
_WORDS = {"0": False, "1": True, "false": False, "true": True, "0.0": False, "1.0": True}
"""Outcomes, in lower case."""
_At = Callable[[float], int]


class LoggedTruth(NamedTuple):
    """What is known about an attempt afterwards.

    Attributes:
        hole_type: Index of the hole's type.
        place_world: Where the TCP is when the peg is in the hole, x and y, m.
        inserted: Whether the peg went in.
    """

    hole_type: int
    place_world: Float[np.ndarray, "2"]
    inserted: bool


@dataclass(frozen=True)
class AttemptFacts:
    """What a log and its map say about attempts, by the start of their first actions, s.

    Attributes:
        peg_at: Index of the peg's type.
        estimate_at: Estimate of the hole (D,); None: the attempt begins above it.
        truth_of: What is known afterwards, by the start and end of the attempt and the start of the next;
            None: nothing.
    """

    peg_at: _At
    estimate_at: Callable[[float], Float[np.ndarray, "D"]] | None
    truth_of: Callable[[float, float, float], LoggedTruth] | None


def facts_of(raw: RawLog, said: LogMap, config: Config) -> AttemptFacts:
    """Return what is known about attempts; its functions raise RequestError where nothing is said.

    Raises:
        RequestError: A type's name is missing or unknown, an estimate or a place has another number of
            values, or an outcome is neither true nor false.
    """
    if said.attempts.peg is None and said.attempts.peg_source is None:
        expected = f"expected one of {', '.join(config.scene.names)}"
        raise RequestError(f"map: attempts.peg: it is missing: {expected}")
    pegs = _types(raw, "pegs", ("attempts.peg", said.attempts.peg), said.attempts.peg_source, config)
    return AttemptFacts(pegs, _estimates(raw, said.attempts, config), _truth(raw, said.truth, config))


def _types(
    raw: RawLog, name: str, constant: tuple[str, str | None], source: str | None, config: Config
) -> _At:
    """Return the index of a type at a time: of a constant with its key in the map, or of labels."""
    names = config.scene.names
    expected = f"expected one of {', '.join(names)}"
    if source is None:
        key, value = constant
        if value not in names:
            raise RequestError(f"map: {key}: {shown(value)} is invalid: {expected}")
        return lambda begin_s: names.index(value)
    own = raw.labels[name]
    told = np.array([str(value) for value in own.values])
    for value in np.unique(told):
        if value not in names:
            raise RequestError(f"{raw.name}: {source}: {shown(str(value))} is invalid: {expected}")
    order = np.argsort(own.time_s, kind="stable")
    what = name.removesuffix("s")
    return lambda begin_s: names.index(str(told[order[_last(own.time_s[order], begin_s, what)]]))


def _truth(
    raw: RawLog, said: TruthMap | None, config: Config
) -> Callable[[float, float, float], LoggedTruth] | None:
    if said is None:
        return None
    coordinates = config.filter.coordinates
    if len(coordinates) > 2:
        raise RequestError(
            f"map: truth: it cannot be used with filter.coordinates {', '.join(coordinates)}: expected x, y"
        )
    holes = _types(raw, "holes", ("truth.hole", said.hole), said.hole_source, config)
    places, inserted = _places(raw, said), _outcomes(raw, said)
    return lambda begin_s, end_s, next_s: LoggedTruth(
        holes(begin_s), places(begin_s), inserted(begin_s, end_s, next_s)
    )


def _places(raw: RawLog, said: TruthMap) -> Callable[[float], Float[np.ndarray, "2"]]:
    if said.place is not None:
        constant = np.array(said.place)
        return lambda begin_s: constant
    own = raw.streams["place"]
    if own.values.shape[1] != 2 or not np.isfinite(own.values).all():
        raise RequestError(
            f"{raw.name}: place: {own.values.shape[1]} values are invalid: expected x and y, m"
        )
    order = np.argsort(own.time_s, kind="stable")
    return lambda begin_s: own.values[order[_last(own.time_s[order], begin_s, "place")]]


def _outcomes(raw: RawLog, said: TruthMap) -> Callable[[float, float, float], bool]:
    """Return the outcome of an attempt: the last that is said in it, or else the first until the next one."""
    if said.inserted is not None:
        return lambda begin_s, end_s, next_s: bool(said.inserted)
    own = raw.labels["inserted"]
    told = [str(value).lower() for value in own.values]
    for value in told:
        if value not in _WORDS:
            raise RequestError(
                f"{raw.name}: {said.inserted_source}: {shown(value)} is invalid: expected 0, 1, false or true"
            )
    order = np.argsort(own.time_s, kind="stable")
    times = own.time_s[order]

    def outcome(begin_s: float, end_s: float, next_s: float) -> bool:
        first, after = np.searchsorted(times, (begin_s - _SLACK_S, end_s + _END_SLACK_S))
        index = after - 1 if after > first else after
        if index >= len(times) or (after == first and times[index] >= next_s):
            raise RequestError(f"no outcome is said from {begin_s:.3f} s on until the next attempt")
        return _WORDS[told[order[index]]]

    return outcome


def _estimates(
    raw: RawLog, asked: AttemptsMap, config: Config
) -> Callable[[float], Float[np.ndarray, "D"]] | None:
    if "estimate" in raw.streams:
        stream = raw.streams["estimate"]
        order = np.argsort(stream.time_s, kind="stable")
        values = _completed(stream.values[order], f"{raw.name}: estimate", config)
        return lambda begin_s: values[_last(stream.time_s[order], begin_s, "estimate")]
    if asked.estimate is None:
        return None
    value = _completed(np.array(asked.estimate)[None], "map: attempts.estimate", config)[0]
    return lambda begin_s: value


def _completed(values: Float[np.ndarray, "n k"], name: str, config: Config) -> Float[np.ndarray, "n D"]:
    """Append zeros, what a detector says about an upright socket, to x and y."""
    coordinates = config.filter.coordinates
    k, d = values.shape[1], len(coordinates)
    if k not in (2, d):
        raise RequestError(f"{name}: {k} values are invalid: expected x and y, or {', '.join(coordinates)}")
    if not np.isfinite(values).all():
        raise RequestError(f"{name}: a value is not finite: expected numbers")
    return np.pad(values, ((0, 0), (0, d - k)))


def _last(time_s: Float[np.ndarray, "n"], begin_s: float, name: str) -> int:
    index = int(np.searchsorted(time_s, begin_s + _SLACK_S, "right")) - 1
    if index < 0:
        raise RequestError(f"no {name} is said until {begin_s:.3f} s")
    return index
