"""Rows of a result file's ``trials``, one type for each experiment, with the ranges of their values."""

from typing import (
    Annotated,
    Any,
    NotRequired,  # pydantic requires this import before Python 3.12
)

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter
from typing_extensions import TypedDict

from mjx_fit.config.sections.scene import MOST_TYPES

MAX_PEGS, MAX_ATTEMPTS, MAX_ACTIONS = 100, 10_000, 10**6
LARGEST = 1e12
"""Largest absolute value of a measured number; its square cannot overflow a float."""


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
_One = Annotated[list[Size | None], Field(min_length=1, max_length=1)]


class _Effort(TypedDict):
    """Time and force of each attempt (``task.effort``), and the time of the moves; older files lack them.

    Numbers are null without an attempt, and forces where a simulation diverged.
    """

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    seconds: NotRequired[list[Size | None]]
    contact_s: NotRequired[list[Size | None]]
    over_20n_s: NotRequired[list[Size | None]]
    impulse_ns: NotRequired[list[Size | None]]
    move_seconds: NotRequired[Size]


class AssemblyTrial(TypedDict):
    """One trial of the assembly experiment; lists run over the pegs in the order of grasping.

    A peg that a human inserted (``human``) has the maximum number of attempts. ``inserted_wrongly``, present
    only if true for some peg, marks pegs that the robot put into holes of another type; ``pulled_out``,
    present only if there is any, counts how often an inserted peg was pulled out again. ``holes`` are the
    shapes of the holes, and ``move_seconds`` is the time of all moves between holes with a peg in hand. The
    remaining lists have an entry for each peg and attempt: the hole ``tried``, its match probability and
    position error before (``match_probability``, ``error_cm``) and after the attempt (``match_after``,
    ``error_after_cm``), the predicted probability of success (``chance``), the highest one at the other empty
    holes (``next_best``, null if there is no other), and the time and force of ``Effort``.
    """

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    trial: Whole
    method: Name
    pegs: Annotated[list[Name], Field(min_length=1, max_length=MAX_PEGS)]
    attempts: list[Count]
    human: list[bool]
    inserted_wrongly: NotRequired[list[bool]]
    pulled_out: NotRequired[list[Whole]]
    holes: NotRequired[Annotated[list[Name], Field(min_length=1, max_length=MAX_PEGS)]]
    tried: NotRequired[list[list[Whole]]]
    chance: NotRequired[list[list[Probability]]]
    next_best: NotRequired[list[list[Probability | None]]]
    match_probability: NotRequired[list[list[Probability]]]
    error_cm: NotRequired[list[list[Size]]]
    seconds: NotRequired[list[list[Size]]]
    contact_s: NotRequired[list[list[Size | None]]]
    peak_force_n: NotRequired[list[list[Size | None]]]
    over_20n_s: NotRequired[list[list[Size | None]]]
    impulse_ns: NotRequired[list[list[Size | None]]]
    move_seconds: NotRequired[Size]
    match_after: NotRequired[list[list[Probability]]]
    error_after_cm: NotRequired[list[list[Size]]]


class AttemptTrial(TypedDict):
    """One attempt.

    ``pair`` contains the shapes of peg and hole, ``length`` counts actions, and ``error_m`` is the distance
    of the detector's estimate from the hole. ``inserted`` means inserted into a matching hole;
    ``inserted_wrongly``, present only if true, into a mismatched one. ``sensed``, present only with
    ``task.success: sensed``, means that the robot measured an insertion. Time and force are lists of one, as
    in the other experiments; older files have a number as ``peak_force_n``.
    """

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    trial: Whole
    pair: Pair
    matched: bool
    inserted: bool
    valid: bool
    length: Annotated[int, Field(ge=0, le=MAX_ACTIONS)]
    peak_force_n: _One | Size | None
    seconds: NotRequired[_One]
    contact_s: NotRequired[_One]
    over_20n_s: NotRequired[_One]
    impulse_ns: NotRequired[_One]
    move_seconds: NotRequired[Size]
    error_m: Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
    inserted_wrongly: NotRequired[bool]
    sensed: NotRequired[bool]


class PositionTrial(_Effort):
    """One trial of the position experiment: consecutive attempts at one hole.

    ``error_cm`` and ``squared_mahalanobis`` score the belief before the first and after each attempt; they
    are constant after the insertion. ``turn_deg``, present if a rotation is believed, is the angle of its
    error, ``yaw_deg`` its part about the vertical where the hole has one, and ``degrees`` the number of
    coordinates that count, 2 if it is absent. ``inserted_at`` is the attempt that inserted the peg, from 1,
    or null; ``inserted_wrongly``, present only if true, marks an insertion into a mismatched hole. Time and
    force of each attempt (``Effort``) are null without an attempt;
    ``move_seconds`` is the time of the moves between.
    """

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    trial: Whole
    method: Name
    pair: Pair
    error_cm: Annotated[list[Size], Field(min_length=2, max_length=MAX_ATTEMPTS)]
    turn_deg: NotRequired[list[Size]]
    yaw_deg: NotRequired[list[Size]]
    squared_mahalanobis: list[Size]
    degrees: NotRequired[Annotated[int, Field(ge=1, le=6)]]
    inserted_at: Count | None
    peak_force_n: list[Size | None]
    inserted_wrongly: NotRequired[bool]


class RobustnessTrial(_Effort):
    """One trial of the robustness experiment: consecutive attempts at one hole under one perturbation.

    ``match_probability`` is the belief that the hole matches the peg; other keys as in ``PositionTrial``.
    """

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    trial: Whole
    method: Name
    perturbation: Name
    pair: Pair
    error_cm: Annotated[list[Size], Field(min_length=2, max_length=MAX_ATTEMPTS)]
    turn_deg: NotRequired[list[Size]]
    yaw_deg: NotRequired[list[Size]]
    squared_mahalanobis: list[Size]
    degrees: NotRequired[Annotated[int, Field(ge=1, le=6)]]
    match_probability: list[Probability]
    inserted_at: Count | None
    peak_force_n: NotRequired[list[Size | None]]


class InsertionTrial(_Effort):
    """One trial of the insertion experiment: a draw of hole and detection with a seed of exploration noise.

    ``attempts`` counts all attempts, including the successful one; time and force as in ``PositionTrial``.
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
    """One update from the first ``actions`` of one failed attempt at the hole ``trial``.

    ``attempt`` is its number in a sequence, from 1, ``pair`` contains the shapes of peg and hole,
    ``prior_error_cm`` and ``error_cm`` are the position errors before and after the update,
    ``squared_mahalanobis`` and ``nll`` score the position's covariance, ``match_probability`` comes from
    h_match, and ``type_probability`` from the filter, for each shape.
    """

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    trial: Whole
    method: Name
    attempt: Count
    actions: Annotated[int, Field(ge=1, le=MAX_ACTIONS)]
    pair: Pair
    prior_error_cm: Size
    prior_turn_deg: NotRequired[Size]
    prior_yaw_deg: NotRequired[Size]
    error_cm: Size
    turn_deg: NotRequired[Size]
    yaw_deg: NotRequired[Size]
    squared_mahalanobis: Size
    degrees: NotRequired[Annotated[int, Field(ge=1, le=6)]]
    nll: Number
    match_probability: Probability
    type_probability: Annotated[list[Probability], Field(min_length=1, max_length=MOST_TYPES)]


KINDS: dict[str, TypeAdapter[Any]] = {
    "assembly": TypeAdapter(list[AssemblyTrial]),
    "attempt": TypeAdapter(list[AttemptTrial]),
    "calibration": TypeAdapter(list[CalibrationTrial]),
    "insertion": TypeAdapter(list[InsertionTrial]),
    "position": TypeAdapter(list[PositionTrial]),
    "robustness": TypeAdapter(list[RobustnessTrial]),
}
"""Schema of the trials of each experiment."""
