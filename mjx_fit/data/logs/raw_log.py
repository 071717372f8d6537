"""A log as it was written: samples in their order, with their own units, frames and faults."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Seconds in each unit of times."""


@dataclass(frozen=True)
class Stream:
    """Samples of one signal.

    Attributes:
        time_s: Times (N,), s.
        values: Values (N, k), in the log's units.
    """

    time_s: Float[np.ndarray, "N"]
    values: Float[np.ndarray, "N k"]


@dataclass(frozen=True)
class Labels:
    """To which attempt samples belong.

    Attributes:
        time_s: Times (N,), s, from each of which on the label holds.
        values: Labels (N,), numbers or texts.
    """

    time_s: Float[np.ndarray, "N"]
    values: np.ndarray[Any, Any]


@dataclass(frozen=True)
class RawLog:
    """The signals that a map asks for.

    Attributes:
        name: Name of the file, for messages.
        streams: ``wrench`` (six values), ``pose`` (seven or six), and those of ``command`` (three), ``twist``
            (six), ``estimate`` and ``place`` that the map asks for.
        labels: Labels of ``attempts``, names of ``pegs`` and ``holes``, and outcomes (``inserted``), if the
            map asks for them.
        quaternions_xyzw: Whether poses have quaternions in this order, whatever the map says: messages do.
    """

    name: str
    streams: dict[str, Stream] = field(default_factory=dict)
    labels: dict[str, Labels] = field(default_factory=dict)
    quaternions_xyzw: bool = False
