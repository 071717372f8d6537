"""Result of an experiment: request, provenance, summary and all trials."""

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from mjx_fit.evaluation import result_schema
from mjx_fit.evaluation.statistics import Row, bootstrap_mean, bootstrap_ratio, clustered_rate, wilson
from mjx_fit.utils import bounded_json, files
from mjx_fit.utils.errors import RequestError

ATTEMPT_METHOD = "spiral"
"""Method name in the rows of the attempt experiment, whose only method is Algorithm 4."""


@dataclass(frozen=True)
class Result:
    """Content of a result file.

    Attributes:
        experiment: ``attempt``, ``position``, ``insertion``, ``assembly`` or ``calibration``.
        config: Resolved configuration (``config.to_tree``).
        seed: Root seed.
        engine: Name of the simulation engine.
        device: Device of the computation.
        versions: Versions of the relevant libraries.
        summary: Metrics with their intervals.
        trials: Trials that the summary is computed from; rows as in ``trial_rows``.
        request: Other parts of the request: methods, number of trials, fingerprint of the sensor, and the
            differences between its training configuration and this one.
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
    """Write a result file atomically; the same result gives the same bytes."""
    lines = []
    for field in dataclasses.fields(result):
        value = _plain(getattr(result, field.name))
        if field.name in ("summary", "trials"):  # one row per line, readable and diffable
            text = "[" + ",".join(f"\n  {json.dumps(row)}" for row in value) + "\n ]"
        else:
            text = json.dumps(value, indent=1).replace("\n", "\n ")
        lines.append(f' "{field.name}": {text}')
    files.write_text(path, "{\n" + ",\n".join(lines) + "\n}\n")


def read(path: Path) -> Result:
    """Read a result file.

    Raises:
        RequestError: The file does not exist or is not a result file.
    """
    try:
        tree = result_schema.require(bounded_json.read(path, result_schema.LARGEST))
    except OSError as error:
        raise RequestError(f"result: {path} cannot be read: {error.strerror}") from None
    except json.JSONDecodeError:
        raise RequestError(f"result: {path} is not JSON") from None
    except ValueError as error:
        raise RequestError(f"result: {path} is not a result file: {error}") from None
    known = {field.name: tree[field.name] for field in dataclasses.fields(Result) if field.name in tree}
    known["summary"] = [_row(row) for row in tree["summary"]]
    return Result(**known)


def _row(tree: dict[str, Any]) -> Row:
    """Convert a row of a summary; integers are accepted as floats."""
    value, low, high = (None if tree[end] is None else float(tree[end]) for end in ("value", "low", "high"))
    assert value is not None
    return Row(tree["method"], tree["metric"], tree["group"], value, low, high, tree["n"])


def number_in(group: str, prefix: str) -> int | None:
    """Return the number after a prefix in the name of a group; None if there is no such number."""
    digits = group.removeprefix(prefix)
    named = group.startswith(prefix) and digits.isascii() and digits.isdecimal() and len(digits) <= 6
    return int(digits) if named else None


def by_method(trials: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Return the trials of each method; methods keep their order of first appearance."""
    methods: dict[str, list[dict[str, Any]]] = {}
    for trial in trials:
        methods.setdefault(trial["method"], []).append(trial)
    return methods


def summarise_assembly(trials: list[dict[str, Any]]) -> list[Row]:
    """Compute attempts and interventions of each method.

    ``attempts`` is the mean cumulative number of attempts for the first n pegs, for n = 1, 2, ... and for
    all; its n counts trials. ``intervention_rate`` is the share of all pegs that a human inserted; its n
    counts pegs. The pegs of one trial are dependent, so both use a bootstrap over trials. A rate of 0 or 1
    has no spread under a bootstrap: its interval is Wilson's for that many *trials*, which also bounds the
    rate of pegs under any dependence within a trial. ``inserted_wrongly`` is the share of all pegs that the
    robot put into holes of another type, computed in the same way and omitted if no trial of any method has
    such a peg; ``pulled_out``, likewise, is the mean number of times that a peg was pulled out again.
    ``attempts_ratio`` is the ratio of the attempts of ``full`` for all pegs to those of another
    method, its group, in the trials that both have.

    Args:
        trials: Rows as in ``trial_rows.AssemblyTrial``.
    """
    rows, needed = [], {}
    wrongly, pulled = (any(name in trial for trial in trials) for name in ("inserted_wrongly", "pulled_out"))
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
        if wrongly:
            rate = clustered_rate(pegs_inserted_wrongly(own).ravel(), of_peg)
            rows.append(Row.of(method, "inserted_wrongly", "all", rate, human.size))
        if pulled:
            times = np.array([np.mean(trial.get("pulled_out", 0.0)) for trial in own])
            rows.append(Row.of(method, "pulled_out", "all", bootstrap_mean(times, clusters), human.size))
    for other in needed if "full" in needed else []:
        both = sorted(needed["full"].keys() & needed[other].keys())
        if other != "full" and both:
            above, below = (np.array([needed[name][i] for i in both]) for name in ("full", other))
            rows.append(Row.of("full", "attempts_ratio", other, bootstrap_ratio(above, below), len(both)))
    return rows


def pegs_inserted_wrongly(trials: list[dict[str, Any]]) -> Bool[np.ndarray, "trials pegs"]:
    """Return the mask of pegs that the robot put into holes of another type."""
    none = [False] * len(trials[0]["human"])
    return np.array([trial.get("inserted_wrongly", none) for trial in trials], bool)


def summarise_attempt(trials: list[dict[str, Any]], method: str = ATTEMPT_METHOD) -> list[Row]:
    """Compute the success rate of matched attempts, mismatched attempts, and matched attempts by shape.

    ``inserted_wrongly`` is the share of mismatched attempts that inserted the peg. It has the group
    ``mismatched`` and one for each pair with such an insertion, for example ``small in big``: the α of that
    pair. It is omitted if there is no such insertion, as where no peg fits another type's hole.

    Attempts with a diverged simulation (``valid`` is false) are excluded and reduce n.

    Args:
        trials: Rows as in ``trial_rows.AttemptTrial``.
        method: Name of the policy.
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
    return _rates(method, "success_rate", groups) + _rates(
        method, "inserted_wrongly", _inserted_wrongly(trials)
    )


def summarise_sensed(trials: list[dict[str, Any]], method: str) -> list[Row]:
    """Compare the insertions that a robot measured with the true ones, in holes of any type.

    ``sensed_precision`` is the share of true ones among those that it measured, ``sensed_recall`` the share
    of measured ones among the true ones. Without ``task.success: sensed`` there are no rows.

    Args:
        trials: Rows as in ``trial_rows.AttemptTrial``.
        method: Name of the policy.
    """
    valid = [trial for trial in trials if trial["valid"] and "sensed" in trial]
    pairs = [(trial["sensed"], trial["inserted"] or trial.get("inserted_wrongly", False)) for trial in valid]
    precision = {"all": [inserted for sensed, inserted in pairs if sensed]}
    recall = {"all": [sensed for sensed, inserted in pairs if inserted]}
    return _rates(method, "sensed_precision", precision) + _rates(method, "sensed_recall", recall)


def _inserted_wrongly(trials: list[dict[str, Any]]) -> dict[str, list[bool]]:
    """Return whether each valid mismatched attempt inserted the peg, for all and for each such pair."""
    groups: dict[str, list[bool]] = {"mismatched": []}
    for trial in trials:
        if trial["valid"] and not trial["matched"]:
            wrongly = trial.get("inserted_wrongly", False)
            groups["mismatched"].append(wrongly)
            groups.setdefault("{} in {}".format(*trial["pair"]), []).append(wrongly)
    return {group: seen for group, seen in groups.items() if any(seen)}


def _rates(method: str, metric: str, groups: dict[str, list[bool]]) -> list[Row]:
    return [
        Row.of(method, metric, group, wilson(sum(map(bool, seen)), len(seen)), len(seen))
        for group, seen in groups.items()
        if seen
    ]


def _plain(value: Any) -> Any:
    """Convert a value for JSON: NumPy numbers become Python numbers, non-finite ones null."""
    if isinstance(value, Row):
        return _plain(value.to_json())
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
