"""What is known about each attempt of a log: the peg's type, and where the hole was believed to be."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config
from mjx_fit.data.logs.log_map import AttemptsMap, LogMap
from mjx_fit.data.logs.raw_log import RawLog
from mjx_fit.utils.errors import RequestError, shown

_SLACK_S = 1e-6
"""Times of bags are rounded to ns."""


@dataclass(frozen=True)
class AttemptFacts:
    """What a log and its map say about attempts, by the start of their first actions, s.

    Attributes:
        peg_at: Index of the peg's type.
        estimate_at: Estimate of the hole (D,); None: the attempt begins above it.
    """

    peg_at: Callable[[float], int]
    estimate_at: Callable[[float], Float[np.ndarray, "D"]] | None


def facts_of(raw: RawLog, said: LogMap, config: Config) -> AttemptFacts:
    """Return what is known about attempts; its functions raise RequestError where nothing is said.

    Raises:
        RequestError: A peg's name is missing or unknown, or an estimate has another number of values.
    """
    return AttemptFacts(_pegs(raw, said.attempts, config), _estimates(raw, said.attempts, config))


def _pegs(raw: RawLog, asked: AttemptsMap, config: Config) -> Callable[[float], int]:
    names = config.scene.names
    expected = f"expected one of {', '.join(names)}"
    if asked.peg_source is None:
        name = asked.peg
        if name is None:
            raise RequestError(f"map: attempts.peg: it is missing: {expected}")
        if name not in names:
            raise RequestError(f"map: attempts.peg: {shown(name)} is invalid: {expected}")
        return lambda begin_s: names.index(name)
    own = raw.labels["pegs"]
    told = np.array([str(value) for value in own.values])
    for name in np.unique(told):
        if name not in names:
            raise RequestError(f"{raw.name}: {asked.peg_source}: {shown(str(name))} is invalid: {expected}")
    order = np.argsort(own.time_s, kind="stable")
    return lambda begin_s: names.index(str(told[order[_last(own.time_s[order], begin_s, "peg")]]))


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
