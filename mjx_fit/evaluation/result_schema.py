"""Schema of result files, checked once on reading so that other code can rely on it."""

from collections.abc import Callable, Iterator
from typing import Annotated, Any, NotRequired

from pydantic import Field, TypeAdapter
from typing_extensions import TypedDict

from mjx_fit.config.sections.scene import MOST_TYPES, SceneConfig
from mjx_fit.evaluation import trial_rows
from mjx_fit.evaluation.trial_rows import STRICT, Name, Number, Whole
from mjx_fit.task.effort import COLUMNS
from mjx_fit.utils import bounded_json

LARGEST = 4 * 2**30
"""Largest result file, in bytes: 10^6 trials with five methods, or 10^5 assemblies."""

MOST_PART_ROWS = 65536
"""Most rows of a part that somebody may ask for."""

_Seed = Annotated[int, Field(ge=0, lt=2**32)]
_Long = Annotated[str, Field(max_length=2000)]
_Limit = Annotated[int, Field(ge=1, le=trial_rows.MAX_ATTEMPTS)]


class _Row(TypedDict):
    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    method: Name
    metric: Name
    group: Name
    value: Number
    low: Number | None
    high: Number | None
    n: Whole


class _Request(TypedDict):
    """Keys of a request that are checked; experiments have more."""

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    methods: NotRequired[list[Name]]
    trials: NotRequired[Whole]
    seeds: NotRequired[Whole]
    part_rows: NotRequired[Annotated[int, Field(ge=1, le=MOST_PART_ROWS)]]
    sensor: NotRequired[Name | dict[Name, Name] | None]
    beliefs_of: NotRequired[Name]
    policy: NotRequired[Name]
    differs_from_training: NotRequired[list[_Long]]


class _Shape(TypedDict):
    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    name: Name


class _Scene(TypedDict):
    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    shapes: NotRequired[Annotated[list[_Shape], Field(min_length=1, max_length=MOST_TYPES)]]


class _Task(TypedDict):
    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    max_attempts: NotRequired[_Limit]


class _Detector(TypedDict):
    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    kind: NotRequired[Name]


class _Config(TypedDict):
    """Keys used by a report; code that computes with a configuration reads it with ``config.from_tree``."""

    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    scene: NotRequired[_Scene]
    task: NotRequired[_Task]
    detector: NotRequired[_Detector]


class _Result(TypedDict):
    __pydantic_config__ = STRICT  # pyright: ignore[reportGeneralTypeIssues]

    experiment: Name
    config: _Config
    seed: _Seed
    engine: Name
    device: Name
    versions: dict[Name, Name]
    summary: list[_Row]
    trials: list[dict[str, Any]]
    request: NotRequired[_Request]


_SCHEMA = TypeAdapter(_Result)


def require(tree: Any) -> dict[str, Any]:
    """Check the tree of a result file and return it unchanged.

    Raises:
        ValueError: The tree is invalid; the message names the first invalid place.
    """
    bounded_json.check(_SCHEMA, tree)
    for number, row in enumerate(tree["summary"]):
        low, high = row["low"], row["high"]
        if (low is None) != (high is None) or (low is not None and low > high):
            raise ValueError(f"summary.{number}: from {low} to {high} is not an interval")
    trials = tree["trials"]
    if tree["experiment"] not in trial_rows.KINDS:
        return tree
    try:
        bounded_json.check(trial_rows.KINDS[tree["experiment"]], trials)
    except ValueError as error:
        raise ValueError(_under_trials(str(error))) from None
    asked = tree.get("request", {}).get("trials", 0)
    if tree["experiment"] == "assembly" and trials and asked > len(trials):  # a replay draws all of them
        raise ValueError(
            f"request.trials: {asked} is invalid: the file has only {len(trials)} rows of trials"
        )
    shapes = tree["config"].get("scene", {}).get("shapes")
    names = {shape["name"] for shape in shapes} if shapes else {*SceneConfig().names}
    for number, trial in enumerate(trials):
        for wrong in _CHECKS[tree["experiment"]](trial, trials[0], names):
            raise ValueError(f"trials.{number}.{wrong}")
    if tree["experiment"] == "calibration":
        _require_priors(tree)
    return tree


def _under_trials(words: str) -> str:
    start = "the key "
    return f"{start}trials.{words.removeprefix(start)}" if words.startswith(start) else f"trials.{words}"


def _unknown(column: str, found: list[str], names: set[str]) -> Iterator[str]:
    for name in found:
        if name not in names:
            shapes = ", ".join(sorted(names))
            yield f"{column}: {name[:80]!r} is invalid: expected a shape, one of {shapes}"


def _other_length(column: str, found: list, wanted: int, of: str) -> Iterator[str]:
    if len(found) != wanted:
        yield f"{column}: {len(found)} values cannot be used: {of} has {wanted}"


def _assembly(trial: dict[str, Any], first: dict[str, Any], _: set[str]) -> Iterator[str]:
    yield from _other_length("pegs", trial["pegs"], len(first["pegs"]), "the first trial")
    for column in ("attempts", "human", *(trial.keys() & {"inserted_wrongly", "pulled_out"})):
        yield from _other_length(column, trial[column], len(trial["pegs"]), "pegs")
    of_attempts = trial.keys() & {
        "tried", "chance", "next_best", "match_probability", "error_cm", "match_after", "error_after_cm",
        *COLUMNS,
    }  # fmt: skip
    for column in sorted(of_attempts):
        yield from _other_length(column, trial[column], len(trial["pegs"]), "pegs")
        for peg, (values, attempts) in enumerate(zip(trial[column], trial["attempts"], strict=False)):
            yield from _other_length(f"{column}.{peg}", values, attempts, "attempts")
    if "tried" in trial:
        most = max((hole for holes in trial["tried"] for hole in holes), default=0)
        if most >= len(trial.get("holes", trial["pegs"])):
            yield f"tried: {most} is invalid: there are {len(trial.get('holes', trial['pegs']))} holes"


def _attempt(trial: dict[str, Any], _: dict[str, Any], names: set[str]) -> Iterator[str]:
    yield from _unknown("pair", trial["pair"], names)
    if trial["matched"] != (trial["pair"][0] == trial["pair"][1]):
        yield f"matched: {trial['matched']} cannot be used: it contradicts the pair"
    if trial.get("inserted_wrongly") and (trial["matched"] or trial["inserted"]):
        yield "inserted_wrongly: True cannot be used: the pair matches, or inserted is true"


def _position(trial: dict[str, Any], first: dict[str, Any], names: set[str]) -> Iterator[str]:
    yield from _unknown("pair", trial["pair"], names)
    places = len(first["error_cm"])
    yield from _other_length("error_cm", trial["error_cm"], places, "the first trial")
    yield from _other_length("squared_mahalanobis", trial["squared_mahalanobis"], places, "error_cm")
    for column in sorted(trial.keys() & {*COLUMNS}):
        yield from _other_length(column, [None, *trial[column]], places, "error_cm")
    if (trial["inserted_at"] or 0) >= places:
        yield f"inserted_at: {trial['inserted_at']} is invalid: there are {places - 1} attempts"


def _robustness(trial: dict[str, Any], first: dict[str, Any], names: set[str]) -> Iterator[str]:
    yield from _unknown("pair", trial["pair"], names)
    places = len(first["error_cm"])
    for column in ("error_cm", "squared_mahalanobis", "match_probability"):
        yield from _other_length(column, trial[column], places, "the first trial")
    for column in sorted(trial.keys() & {*COLUMNS}):
        yield from _other_length(column, [None, *trial[column]], places, "error_cm")


def _insertion(trial: dict[str, Any], _: dict[str, Any], names: set[str]) -> Iterator[str]:
    yield from _unknown("shape", [trial["shape"]], names)
    for column in sorted(trial.keys() & {*COLUMNS}):
        yield from _other_length(column, trial[column], trial["attempts"], "attempts")


def _calibration(trial: dict[str, Any], _: dict[str, Any], names: set[str]) -> Iterator[str]:
    yield from _unknown("pair", trial["pair"], names)
    yield from _other_length("type_probability", trial["type_probability"], len(names), "scene.shapes")


_CHECKS: dict[str, Callable[[dict[str, Any], dict[str, Any], set[str]], Iterator[str]]] = {
    "assembly": _assembly,
    "attempt": _attempt,
    "calibration": _calibration,
    "insertion": _insertion,
    "position": _position,
    "robustness": _robustness,
}


def _require_priors(tree: dict[str, Any]) -> None:
    """Check that the summary has the prior's row, the reference of the other methods."""
    rows = {(row["method"], row["metric"], row["group"]) for row in tree["summary"]}
    if tree["trials"] and ("prior", "position_error_cm", "all") not in rows:
        raise ValueError("summary: the row of prior, position_error_cm, all is missing")
    if not isinstance(tree.get("request", {}).get("sensor", {}), dict):
        raise ValueError("request.sensor is invalid: expected the sensor of each method")
