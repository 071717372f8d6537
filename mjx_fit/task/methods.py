"""The methods that the experiments compare: what each of them learns from a failed attempt."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from jaxtyping import Bool

from mjx_fit.utils.errors import RequestError, shown

KNOWN_VARIANCE_M2 = 1e-8
"""What is believed of a position that is known: (0.1 mm)²."""


@dataclass(frozen=True)
class Method:
    """A way to act on failures. All of them learn from the failure itself (the outcome model T).

    Attributes:
        name: As in commands and files.
        learns_position: Whether the trace updates the belief about the position.
        learns_type: Whether the trace updates the belief about the type.
        knows_truth: Whether it starts with the true positions and types: a bound that nobody can beat.
        learns_truth: Whether one failed attempt tells it the true position and type of that hole: a bound
            that no sensor can beat.
        learns_match: Whether it tells it the true position, and of the type whether it is the peg's: a bound
            that no sensor of the paper's form, with its o_match, can beat.
    """

    name: str
    learns_position: bool = False
    learns_type: bool = False
    knows_truth: bool = False
    learns_truth: bool = False
    learns_match: bool = False

    @property
    def needs_sensor(self) -> bool:
        return self.learns_position or self.learns_type


ASSEMBLY = (
    Method("failure_only"),
    Method("failure_position", learns_position=True),
    Method("full", learns_position=True, learns_type=True),
    Method("perfect_match", learns_match=True),
    Method("perfect_sensor", learns_truth=True),
    Method("oracle", knows_truth=True),
)


@dataclass(frozen=True)
class HoleMethod:
    """A way to go on at one hole after a failed attempt.

    Attributes:
        name: As in commands and files.
        reads: What makes a new estimate of the trace: the ``filter`` behind the sensor; the
            ``frame``-by-frame sensor alone, which forgets what was believed before; or nothing.
        starts: From where an attempt starts: the ``mean`` of the belief, or a ``sample`` of it.
        knows_truth: Whether it starts with the true position: a bound that nobody can beat.
    """

    name: str
    reads: Literal["", "filter", "frame"] = ""
    starts: Literal["mean", "sample"] = "mean"
    knows_truth: bool = False


_FULL, _FRAMES = HoleMethod("full", reads="filter"), HoleMethod("frame_by_frame", reads="frame")
_ORACLE = HoleMethod("oracle", knows_truth=True)

POSITION = (_FULL, _FRAMES, _ORACLE)
INSERTION = (_FULL, HoleMethod("no_update"), HoleMethod("sample", starts="sample"), _FRAMES, _ORACLE)

M = TypeVar("M", Method, HoleMethod)


def chosen(names: str, among: Sequence[M]) -> tuple[M, ...]:
    """The methods that a comma-separated list names, each once.

    Raises:
        RequestError: One of them does not exist.
    """
    known = {method.name: method for method in among}
    picked = {}
    for name in names.split(","):
        if name not in known:
            raise RequestError(f"--methods: {shown(name)} is invalid: choose from {', '.join(known)}")
        picked[name] = known[name]
    return tuple(picked.values())


def of_rows(methods: Sequence[M], n_trials: int, trait: Callable[[M], bool]) -> Bool[np.ndarray, "R"]:
    """Whether each row's method has a trait; rows go method by method, trial by trial."""
    return np.repeat([trait(method) for method in methods], n_trials)
