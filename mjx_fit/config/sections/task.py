"""Configuration section of the task: holes, attempts, and the outcome model."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from statistics import fmean
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator
from pydantic.dataclasses import dataclass

from mjx_fit.config.sections.fields import ACTIONS_UNIT, ATTEMPTS_UNIT, LEAST_PROBABILITY, STRICT, Probability
from mjx_fit.config.sections.shape import SHAPES, Shape
from mjx_fit.utils.errors import shown

Rates = tuple[Annotated[float, Field(ge=0, le=0.999999)], ...]


def _number_or_row(value: Any) -> str:
    return "row" if isinstance(value, list | tuple) else "number"


Alphas = tuple[
    Annotated[
        Annotated[Probability, Tag("number")] | Annotated[Rates, Tag("row")],
        Discriminator(_number_or_row),
    ],
    ...,
]
"""One number per shape (the diagonal of the matrix), or one row of the matrix per shape."""

_ERROR_KNOTS_M = (0.0, 0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.0125, 0.015, 0.0175)
_SUCCESS_BY_ERROR = (
    (0.993, 0.98, 0.84, 0.653, 0.267, 0.44, 0.313, 0.107, 0.033, 0.0),
    (0.997, 0.993, 0.94, 0.86, 0.827, 0.773, 0.48, 0.127, 0.033, 0.0),
    (0.997, 0.993, 0.893, 0.793, 0.66, 0.673, 0.42, 0.12, 0.033, 0.0),
)
"""Of 150 attempts each; 150 of 150 count as 150.5 of 151, since no attempt is certain."""

DEFAULT_ALPHA = (0.126, 0.192, 0.167)
"""Success rate of a matched attempt for each default shape, by ``evaluate attempt --trials 1000``."""
LEAST_STEP_M = 0.00001
"""Smallest spacing of the error knots that single precision resolves, m."""


def _mean(rates: Sequence[float]) -> float:
    """Compute the mean rate; without NumPy, so that a request is read before large imports."""
    return round(fmean(rates), 6)


@dataclass(frozen=True, config=STRICT)
class TaskConfig:
    """High-level assembly task.

    Attributes:
        n_holes: Holes, and pegs, in one assembly.
        max_attempts: Attempts before a human helps. The limit applies to each peg.
        attempt_actions: Length J of one attempt.
        insertion_depth_m: Depth that counts as inserted. The TCP must be at least this far below the top of
            the socket, in the hole.
        success_probability: Success rates α by shape. The outcome model uses either one number per shape, the
            success rate of a matched attempt, or a matrix with one row per peg and one column per hole, if
            pegs also fit into holes of other types. The default (null) was measured by
            ``evaluate attempt --trials 1000`` for cross, rectangle and square with all other settings at
            their defaults; for other ``scene.shapes`` it is their mean, a guess. Measure it again after
            changes to the detector, the scene or the control.
        outcome_model: How success is predicted. α is ``constant`` per shape, as in the paper, or computed
            from the ``covariance`` of the belief: the mean of ``success_by_error`` over the belief if the
            types match (``mjx_fit.filters.outcome_model``).
        error_knots_m: Errors at which α is known. These are distances between estimate and hole.
        success_by_error: Success rates at these errors. One list per shape, for matched attempts. The default
            (null) was measured by ``experiments/physics/alpha.py error`` for cross, rectangle and square with
            all other settings at their defaults; for other ``scene.shapes`` it is their mean.
        hard_match: Update the type by the arg max. Use the arg max of h_match, as in Algorithm 3; otherwise
            average over its probabilities, as in training. H is learned with the latter, and is overconfident
            with the former.
        next_hole: Value that chooses the next hole. Either the success ``chance`` of the attempt, as in the
            paper, or the ``rate``: insertions per second (``mjx_fit.task.hole_choice``), by which the policy
            ``seek`` also leaves a hole.
        revisit_from: Position for a second visit. A peg that comes back to a hole starts from the ``belief``,
            or from the ``detection``: a visit misled to a wrong place would only repeat itself; or where the
            hole may be and was not searched for, ``map`` (``mjx_fit.filters.search_map``). The type is
            what the visits said, and other pegs start from the belief.
        success: Who tells that the peg is in. The ``truth`` of the simulator does, as in the paper, or what
            the robot ``sensed``: a TCP ``insertion_depth_m`` and ``sensed_margin_m`` below where it takes the
            top of the socket to be. The truth then only scores.
        sensed_margin_m: Depth beyond insertion_depth_m. A measured insertion must have it; the default is
            five times the error of height, ``pose.height_offset_m``.
    """

    n_holes: Annotated[int, Field(ge=1, le=8, json_schema_extra={"unit": "holes"})] = 5
    max_attempts: Annotated[int, Field(ge=1, le=1000, json_schema_extra=ATTEMPTS_UNIT)] = 30
    attempt_actions: Annotated[int, Field(ge=1, le=400, json_schema_extra=ACTIONS_UNIT)] = 100
    insertion_depth_m: Annotated[float, Field(ge=0.001, le=0.025)] = 0.01
    success_probability: Alphas | None = None
    outcome_model: Literal["constant", "covariance"] = "constant"
    error_knots_m: Annotated[
        tuple[Annotated[float, Field(ge=0, le=0.1)], ...], Field(min_length=1, max_length=100)
    ] = _ERROR_KNOTS_M
    success_by_error: tuple[Rates, ...] | None = None
    hard_match: bool = False
    next_hole: Literal["chance", "rate"] = "chance"
    revisit_from: Literal["belief", "detection", "map"] = "belief"
    success: Literal["truth", "sensed"] = "truth"
    sensed_margin_m: Annotated[float, Field(ge=0, le=0.01)] = 0.0015

    @model_validator(mode="after")
    def _one_rate_for_each_knot(self) -> "TaskConfig":
        knots = self.error_knots_m
        if any(after - before < LEAST_STEP_M for before, after in pairwise(knots)):
            raise ValueError(
                f"error_knots_m: {shown(list(knots))} is invalid: expected increasing values at least "
                f"{LEAST_STEP_M} apart"
            )
        for rates in self.success_by_error or _SUCCESS_BY_ERROR:
            if len(rates) != len(knots):
                raise ValueError(
                    f"success_by_error: {shown(list(rates))} is invalid: expected one rate for "
                    f"each of the {len(knots)} error_knots_m"
                )
        return self

    @model_validator(mode="after")
    def _rows_of_one_matrix(self) -> "TaskConfig":
        alphas = self.success_probability or ()
        rows = [row for row in alphas if isinstance(row, tuple)]
        if rows and [len(row) for row in rows] != [len(alphas)] * len(alphas):
            raise ValueError(
                f"success_probability: {shown(list(alphas))} is invalid: expected one number per shape, "
                "or one row per shape with one number per shape"
            )
        for i, row in enumerate(rows):
            if row[i] < LEAST_PROBABILITY:
                raise ValueError(
                    f"success_probability.{i}.{i}: {row[i]} is invalid: expected at least "
                    f"{LEAST_PROBABILITY} for a peg that matches its hole"
                )
        return self

    def for_shapes(self, shapes: tuple[Shape, ...]) -> "TaskConfig":
        """Replace missing rates (null) by the defaults for these shapes."""
        alphas, by_error = self.success_probability, self.success_by_error
        if alphas is None:
            alphas = DEFAULT_ALPHA if shapes == SHAPES else (_mean(DEFAULT_ALPHA),) * len(shapes)
        if by_error is None:
            means = tuple(_mean(rates) for rates in zip(*_SUCCESS_BY_ERROR, strict=True))
            by_error = _SUCCESS_BY_ERROR if shapes == SHAPES else (means,) * len(shapes)
        return replace(self, success_probability=alphas, success_by_error=by_error)
