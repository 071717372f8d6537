"""Methods compared in the experiments: what each learns from a failed attempt."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from jaxtyping import Bool

from mjx_fit.utils.errors import RequestError, shown

KNOWN_VARIANCE_M2 = 1e-8
"""Variance of a known position: (0.1 mm)²."""


@dataclass(frozen=True)
class Method:
    """Method of an assembly experiment. Every method learns from the failure itself (the outcome model T).

    Attributes:
        name: Name in commands and files.
        learns_position: Whether the trace updates the belief about the position.
        learns_type: Whether the trace updates the belief about the type.
        knows_truth: Whether the prior is the true position and type: an upper bound for any method.
        learns_truth: Whether one failed attempt reveals the true position and type of that hole: an upper
            bound for any sensor.
        learns_match: Whether one failed attempt reveals the true position and whether the types match: an
            upper bound for any sensor of the paper's form, with its o_match.
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
    """Method of a single-hole experiment.

    Attributes:
        name: Name in commands and files.
        reads: Estimator that turns the trace into a new estimate: ``filter`` for the sensor and the filter,
            ``position`` for these about x and y alone, ``frame`` for the frame-by-frame sensor alone, which
            discards the prior, or ``""`` for no update.
        starts: Start position of an attempt: ``mean`` of the belief, or a ``sample`` from it.
        knows_truth: Whether the prior is the true position: an upper bound for any method.
    """

    name: str
    reads: Literal["", "filter", "position", "frame"] = ""
    starts: Literal["mean", "sample"] = "mean"
    knows_truth: bool = False


_FULL, _FRAMES = HoleMethod("full", reads="filter"), HoleMethod("frame_by_frame", reads="frame")
_ORACLE = HoleMethod("oracle", knows_truth=True)

_POSITION_ONLY = HoleMethod("position_only", reads="position")

POSITION = (_FULL, _POSITION_ONLY, _FRAMES, _ORACLE)
INSERTION = (
    _FULL, _POSITION_ONLY, HoleMethod("no_update"), HoleMethod("sample", starts="sample"), _FRAMES, _ORACLE,
)  # fmt: skip

M = TypeVar("M", Method, HoleMethod)


def chosen(names: str, among: Sequence[M]) -> tuple[M, ...]:
    """Return the methods named in a comma-separated list, without duplicates.

    Raises:
        RequestError: A method does not exist.
    """
    known = {method.name: method for method in among}
    picked = {}
    for name in names.split(","):
        if name not in known:
            raise RequestError(f"--methods: {shown(name)} is invalid: choose from {', '.join(known)}")
        picked[name] = known[name]
    return tuple(picked.values())


def of_rows(methods: Sequence[M], n_trials: int, trait: Callable[[M], bool]) -> Bool[np.ndarray, "R"]:
    """Return the trait of each row's method; rows are ordered by method, then by trial."""
    return np.repeat([trait(method) for method in methods], n_trials)
