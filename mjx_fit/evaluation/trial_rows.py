"""The rows of a result file's ``trials``, one kind for each experiment, and what their values may be."""

from typing import (
    Annotated,
    Any,
    NotRequired,  # pydantic needs this one before Python 3.12
)

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter
from typing_extensions import TypedDict

from mjx_fit.config.sections.world import MOST_TYPES

MAX_PEGS, MAX_ATTEMPTS, MAX_ACTIONS = 100, 10_000, 10**6
LARGEST = 1e12
"""Of a number that was measured; its square is far from the end of a float."""


def _printable(text: str) -> str:
    if text.isprintable():
        return text
    raise ValueError("a name must be printable")


Name = Annotated[str, Field(max_length=200), AfterValidator(_printable)]
Whole = Annotated[int, Field(ge=0, le=2**53)]
Count = Annotated[int, Field(ge=1, le=MAX_ATTEMPTS)]
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Size = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Probability = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Pair = Annotated[list[Name], Field(min_length=2, max_length=2)]
STRICT = ConfigDict(strict=True)


class AssemblyTrial(TypedDict):
    """One trial of the assembly experiment; lists run over the pegs in the order in which they were grasped.

    A peg that a human inserted (``human``) has as many attempts as were allowed. ``inserted_wrongly``, there
    only where it is true of a peg, says which pegs the robot put into holes of another type. ``holes`` are
    the shapes of the holes. The rest says, for each peg and attempt, which of them was ``tried``; how likely
    it was believed to match and how far from its true place it was thought to be, before
    (``match_probability``, ``error_cm``) and after (``match_after``, ``error_after_cm``); how likely the
    attempt was thought to succeed (``chance``), and the best of those at the other empty holes
    (``next_best``, null where there was none); and the largest tared force.
    """

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    trial: Whole
    method: Name
    pegs: Annotated[list[Name], Field(min_length=1, max_length=MAX_PEGS)]
    attempts: list[Count]
    human: list[bool]
    inserted_wrongly: NotRequired[list[bool]]
    holes: NotRequired[Annotated[list[Name], Field(min_length=1, max_length=MAX_PEGS)]]
    tried: NotRequired[list[list[Whole]]]
    chance: NotRequired[list[list[Probability]]]
    next_best: NotRequired[list[list[Probability | None]]]
    match_probability: NotRequired[list[list[Probability]]]
    error_cm: NotRequired[list[list[Size]]]
    peak_force_n: NotRequired[list[list[Size | None]]]
    match_after: NotRequired[list[list[Probability]]]
    error_after_cm: NotRequired[list[list[Size]]]


class AttemptTrial(TypedDict):
    """One attempt.

    ``pair`` is the shapes of peg and hole, ``length`` counts actions, ``error_m`` is the distance of the
    detector's estimate from the hole, ``peak_force_n`` the largest tared force. ``inserted`` means into a
    hole that matches; ``inserted_wrongly``, there only where it is true, into one that does not.
    """

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    trial: Whole
    pair: Pair
    matched: bool
    inserted: bool
    valid: bool
    length: Annotated[int, Field(ge=0, le=MAX_ACTIONS)]
    peak_force_n: Size | None
    error_m: Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
    inserted_wrongly: NotRequired[bool]


class PositionTrial(TypedDict):
    """One trial of the position experiment: attempts in a row at one hole.

    ``error_cm`` and ``squared_mahalanobis`` are of the belief before the first and after each attempt; they
    stay as they are from the insertion on. ``inserted_at`` is the attempt after which the peg was in, from 1,
    or null; ``inserted_wrongly``, there only where it is true, says that the pair does not match.
    ``peak_force_n`` is the largest tared force of each attempt, null where there was none.
    """

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    trial: Whole
    method: Name
    pair: Pair
    error_cm: Annotated[list[Size], Field(min_length=2, max_length=MAX_ATTEMPTS)]
    squared_mahalanobis: list[Size]
    inserted_at: Count | None
    peak_force_n: list[Size | None]
    inserted_wrongly: NotRequired[bool]


class InsertionTrial(TypedDict):
    """One trial of the insertion experiment: a draw of hole and detection under one seed of the wiggles.

    ``attempts`` are those that were made, the successful one included.
    """

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    trial: Whole
    seed: Whole
    method: Name
    shape: Name
    attempts: Count
    success: bool
    peak_force_n: list[Size | None]


class CalibrationTrial(TypedDict):
    """One update from one failed attempt at the hole ``trial``, of which the first ``actions`` were read.

    ``attempt`` is its place in a sequence, from 1, ``pair`` the shapes of peg and hole, ``prior_error_cm``
    and ``error_cm`` the distance of the believed from the true position before and after,
    ``squared_mahalanobis`` and ``nll`` score the position's covariance, ``match_probability`` is h_match's,
    ``type_probability`` the filter's for each shape.
    """

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    trial: Whole
    method: Name
    attempt: Count
    actions: Annotated[int, Field(ge=1, le=MAX_ACTIONS)]
    pair: Pair
    prior_error_cm: Size
    error_cm: Size
    squared_mahalanobis: Size
    nll: Number
    match_probability: Probability
    type_probability: Annotated[list[Probability], Field(min_length=1, max_length=MOST_TYPES)]


KINDS: dict[str, TypeAdapter[Any]] = {
    "assembly": TypeAdapter(list[AssemblyTrial]),
    "attempt": TypeAdapter(list[AttemptTrial]),
    "calibration": TypeAdapter(list[CalibrationTrial]),
    "insertion": TypeAdapter(list[InsertionTrial]),
    "position": TypeAdapter(list[PositionTrial]),
}
"""What the trials of each experiment must be."""
