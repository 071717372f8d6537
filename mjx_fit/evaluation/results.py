"""The result file of an experiment: what was asked, on what it ran, what was counted, and every trial."""

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import (
    Any,
    NotRequired,  # pydantic needs this one before Python 3.12
)

import numpy as np
from pydantic import TypeAdapter, ValidationError
from typing_extensions import TypedDict

from mjx_fit import files
from mjx_fit.errors import RequestError
from mjx_fit.evaluation.statistics import Row, bootstrap_mean, bootstrap_ratio, clustered_rate, wilson

ATTEMPT_METHOD = "spiral"
"""The method in the rows of the attempt experiment: it has but one, Algorithm 4."""


class AssemblyTrial(TypedDict):
    """One trial of the assembly experiment; lists run over the pegs in the order in which they were grasped.

    A peg that a human inserted (``human``) has as many attempts as were allowed. ``holes`` are the shapes of
    the holes. The rest says, for each peg and attempt, which of them was ``tried``; how likely it was
    believed to match and how far from its true place it was thought to be, before (``match_probability``,
    ``error_cm``) and after (``match_after``, ``error_after_cm``); how likely the attempt was thought to
    succeed (``chance``), and the best of those at the other empty holes (``next_best``, null where there was
    none); and the largest tared force.
    """

    trial: int
    method: str
    pegs: list[str]
    attempts: list[int]
    human: list[bool]
    holes: NotRequired[list[str]]
    tried: NotRequired[list[list[int]]]
    chance: NotRequired[list[list[float]]]
    next_best: NotRequired[list[list[float | None]]]
    match_probability: NotRequired[list[list[float]]]
    error_cm: NotRequired[list[list[float]]]
    peak_force_n: NotRequired[list[list[float | None]]]
    match_after: NotRequired[list[list[float]]]
    error_after_cm: NotRequired[list[list[float]]]


class AttemptTrial(TypedDict):
    """One attempt.

    ``pair`` is the shapes of peg and hole, ``length`` counts actions, ``error_m`` is the distance of the
    detector's estimate from the hole, ``peak_force_n`` the largest tared force.
    """

    trial: int
    pair: tuple[str, str]
    matched: bool
    inserted: bool
    valid: bool
    length: int
    peak_force_n: float | None
    error_m: float


class PositionTrial(TypedDict):
    """One trial of the position experiment: attempts in a row at one hole.

    ``error_cm`` and ``squared_mahalanobis`` are of the belief before the first and after each attempt; they
    stay as they are from the insertion on. ``inserted_at`` is the attempt that succeeded, from 1, or null;
    ``peak_force_n`` is the largest tared force of each attempt, null where there was none.
    """

    trial: int
    method: str
    pair: tuple[str, str]
    error_cm: list[float]
    squared_mahalanobis: list[float]
    inserted_at: int | None
    peak_force_n: list[float | None]


class InsertionTrial(TypedDict):
    """One trial of the insertion experiment: a draw of hole and detection under one seed of the wiggles.

    ``attempts`` are those that were made, the successful one included.
    """

    trial: int
    seed: int
    method: str
    shape: str
    attempts: int
    success: bool
    peak_force_n: list[float | None]


class CalibrationTrial(TypedDict):
    """One update from one failed attempt at the hole ``trial``, of which the first ``actions`` were read.

    ``attempt`` is its place in a sequence, from 1, ``pair`` the shapes of peg and hole, ``prior_error_cm``
    and ``error_cm`` the distance of the believed from the true position before and after,
    ``squared_mahalanobis`` and ``nll`` score the position's covariance, ``match_probability`` is h_match's,
    ``type_probability`` the filter's for each shape.
    """

    trial: int
    method: str
    attempt: int
    actions: int
    pair: tuple[str, str]
    prior_error_cm: float
    error_cm: float
    squared_mahalanobis: float
    nll: float
    match_probability: float
    type_probability: list[float]


_TRIALS = {
    "assembly": TypeAdapter(dict[str, list[AssemblyTrial]]),
    "attempt": TypeAdapter(dict[str, list[AttemptTrial]]),
    "calibration": TypeAdapter(dict[str, list[CalibrationTrial]]),
    "insertion": TypeAdapter(dict[str, list[InsertionTrial]]),
    "position": TypeAdapter(dict[str, list[PositionTrial]]),
}


@dataclass(frozen=True)
class Result:
    """A result file.

    Attributes:
        experiment: ``attempt``, ``position``, ``insertion``, ``assembly`` or ``calibration``.
        config: The resolved configuration (``config.to_tree``).
        seed: Root seed.
        engine: Engine that simulated.
        device: Device it ran on.
        versions: Version of each library that matters.
        summary: What was counted.
        trials: What it was counted from; rows such as ``AssemblyTrial``.
        request: The rest of what was asked for: methods, number of trials, the sensor by its fingerprint, and
            in what its training's configuration differs from this one.
    """

    experiment: str
    config: dict[str, Any]
    seed: int
    engine: str
    device: str
    versions: dict[str, str]
    summary: list[Row]
    trials: list[dict[str, Any]]
    request: dict[str, Any] = dataclasses.field(default_factory=dict)


def write(path: Path, result: Result) -> None:
    """Writes a result file: whole or not at all, and the same bytes for the same result."""
    lines = []
    for field in dataclasses.fields(result):
        value = _plain(getattr(result, field.name))
        if field.name in ("summary", "trials"):  # a row on a line, for people and for diff
            text = "[" + ",".join(f"\n  {json.dumps(row)}" for row in value) + "\n ]"
        else:
            text = json.dumps(value, indent=1).replace("\n", "\n ")
        lines.append(f' "{field.name}": {text}')
    files.write_text(path, "{\n" + ",\n".join(lines) + "\n}\n")


def read(path: Path) -> Result:
    """Reads a result file.

    Raises:
        RequestError: There is no such file, or it is not a result file.
    """
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RequestError(f"result: {path} cannot be read: {error.strerror}") from None
    except ValueError:
        raise RequestError(f"result: {path} is not JSON") from None
    try:
        result = TypeAdapter(Result).validate_python(tree)
        if result.experiment in _TRIALS:
            _TRIALS[result.experiment].validate_python({"trials": result.trials})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        what = f"the key {where} is missing" if first["type"] == "missing" else f"{where}: {first['msg']}"
        raise RequestError(f"result: {path} is not a result file: {what}") from None
    return result


def by_method(trials: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """The trials of each method, methods in the order in which they first appear."""
    methods: dict[str, list[dict[str, Any]]] = {}
    for trial in trials:
        methods.setdefault(trial["method"], []).append(trial)
    return methods


def summarise_assembly(trials: list[dict[str, Any]]) -> list[Row]:
    """Attempts and interventions of each method.

    ``attempts`` is the mean number of attempts that the first n pegs took together, for n = 1, 2, ... and
    for all; its n counts trials. ``intervention_rate`` is the share of all pegs that a human inserted; its n
    counts pegs. The pegs of one trial depend on each other, so both carry a bootstrap over trials. Where no
    peg or every peg was given to a human, a bootstrap knows no spread: then the interval is Wilson's for that
    many *trials*, which also bounds the rate of pegs, however the pegs of a trial depend on each other.
    ``attempts_ratio`` is the attempts of ``full`` for all pegs over those of another method, its group, in
    the trials that both have.

    Args:
        trials: Rows as in ``AssemblyTrial``.
    """
    rows, needed = [], {}
    for method, own in by_method(trials).items():
        clusters = [trial["trial"] for trial in own]
        total = np.cumsum([trial["attempts"] for trial in own], axis=1)
        needed[method] = dict(zip(clusters, total[:, -1], strict=True))
        groups = {**{str(n + 1): n for n in range(total.shape[1])}, "all": -1}
        rows += [
            Row.of(method, "attempts", group, bootstrap_mean(total[:, n], clusters), len(own))
            for group, n in groups.items()
        ]
        human = np.array([trial["human"] for trial in own])
        of_peg = np.repeat(clusters, human.shape[1]).tolist()
        rate = clustered_rate(human.ravel(), of_peg)
        rows.append(Row.of(method, "intervention_rate", "all", rate, human.size))
    for other in needed if "full" in needed else []:
        both = sorted(needed["full"].keys() & needed[other].keys())
        if other != "full" and both:
            above, below = (np.array([needed[name][i] for i in both]) for name in ("full", other))
            rows.append(Row.of("full", "attempts_ratio", other, bootstrap_ratio(above, below), len(both)))
    return rows


def summarise_attempt(trials: list[dict[str, Any]]) -> list[Row]:
    """Success rate of matched attempts, of mismatched ones, and of the matched attempts of each shape.

    Attempts whose simulation broke (``valid`` is false) are left out, so n shows them.

    Args:
        trials: Rows as in ``AttemptTrial``.
    """
    groups: dict[str, list[bool]] = {"matched": [], "mismatched": []}
    for shape in sorted({trial["pair"][0] for trial in trials if trial["matched"]}):
        groups[shape] = []
    for trial in trials:
        if not trial["valid"]:
            continue
        groups["matched" if trial["matched"] else "mismatched"].append(trial["inserted"])
        if trial["matched"]:
            groups[trial["pair"][0]].append(trial["inserted"])
    return [
        Row.of(ATTEMPT_METHOD, "success_rate", group, wilson(sum(map(bool, seen)), len(seen)), len(seen))
        for group, seen in groups.items()
        if seen
    ]


def _plain(value: Any) -> Any:
    """The value as JSON has it: NumPy's numbers as Python's, and null for what is not a number."""
    if isinstance(value, Row):
        return _plain(value.to_json())
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
