import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mjx_fit.config.schema import Config, config_to_tree
from mjx_fit.evaluation import results
from mjx_fit.evaluation.results import Result, summarise_assembly, summarise_attempt
from mjx_fit.evaluation.statistics import wilson
from mjx_fit.utils.errors import RequestError

PEGS = ["cross", "square", "square"]


def trial(number: int, method: str, attempts: list[int], human: list[bool]) -> dict[str, Any]:
    return {"trial": number, "method": method, "pegs": PEGS, "attempts": attempts, "human": human}


ASSEMBLY = [
    trial(0, "full", [1, 2, 3], [False] * 3),
    trial(0, "failure_only", [4, 30, 5], [False, True, False]),
    trial(1, "full", [3, 4, 1], [False] * 3),
    trial(1, "failure_only", [30, 30, 6], [True, True, False]),
]
ATTEMPTS = [
    {"trial": i, "pair": list(pair), "matched": pair[0] == pair[1], "inserted": inserted, "valid": True,
     "length": 40, "peak_force_n": 9.5, "error_m": 0.012}
    for i, (*pair, inserted) in enumerate(
        [("cross", "cross", True), ("cross", "cross", False), ("square", "square", True),
         ("cross", "square", False), ("square", "cross", False)]
    )
]  # fmt: skip
RESULT = Result(
    experiment="assembly",
    config=config_to_tree(Config()),
    seed=3,
    request={"trials": 2},
    engine="native",
    device="cpu",
    versions={"jax": "0.10.2"},
    summary=summarise_assembly(ASSEMBLY),
    trials=ASSEMBLY,
)


def test_assembly_rows_are_the_hand_count():
    rows = {(row.method, row.metric, row.group): row for row in summarise_assembly(ASSEMBLY)}
    value = {key: row.value for key, row in rows.items()}
    assert value == {
        ("full", "attempts", "1"): 2.0,
        ("full", "attempts", "2"): 5.0,
        ("full", "attempts", "3"): 7.0,
        ("full", "attempts", "all"): 7.0,
        ("full", "intervention_rate", "all"): 0.0,
        ("failure_only", "attempts", "1"): 17.0,
        ("failure_only", "attempts", "2"): 47.0,
        ("failure_only", "attempts", "3"): 52.5,
        ("failure_only", "attempts", "all"): 52.5,
        ("failure_only", "intervention_rate", "all"): 0.5,
        ("full", "attempts_ratio", "failure_only"): 14 / 105,
    }
    assert rows["full", "attempts", "all"].n == 2
    assert rows["full", "intervention_rate", "all"].n == 6
    # With two trials a bootstrap reaches from the one to the other.
    row = rows["failure_only", "attempts", "1"]
    assert (row.low, row.high) == (4.0, 30.0)
    row = rows["failure_only", "intervention_rate", "all"]
    assert (row.low, row.high) == pytest.approx((1 / 3, 2 / 3))
    # In pairs: 6 of 39, 8 of 66, or both of them.
    row = rows["full", "attempts_ratio", "failure_only"]
    assert (row.low, row.high) == pytest.approx((8 / 66, 6 / 39))


def test_a_ratio_takes_the_trials_that_both_methods_have():
    rows = summarise_assembly([*ASSEMBLY, trial(2, "full", [9, 9, 9], [False] * 3)])
    assert [(row.value, row.n) for row in rows if row.metric == "attempts_ratio"] == [(14 / 105, 2)]


@pytest.mark.parametrize("human", [False, True])
def test_interventions_without_spread_carry_wilson_over_trials(human: bool):
    trials = [trial(i, "full", [30, 30, 30], [human] * 3) for i in range(8)]
    row = summarise_assembly(trials)[-1]
    assert (row.value, row.low, row.high) == pytest.approx(wilson(8 * human, 8))
    assert row.n == 24


def test_attempt_rows_are_the_hand_count():
    rows = {row.group: row for row in summarise_attempt(ATTEMPTS)}
    assert {group: (row.value, row.n) for group, row in rows.items()} == {
        "matched": (pytest.approx(2 / 3), 3),
        "mismatched": (0.0, 2),
        "cross": (0.5, 2),
        "square": (1.0, 1),
    }
    assert (rows["matched"].low, rows["matched"].high) == pytest.approx(wilson(2, 3)[1:])
    assert [row.group for row in summarise_attempt(ATTEMPTS[3:])] == ["mismatched"]


def test_broken_simulations_are_not_counted():
    broken = [trial | {"valid": False, "inserted": False} for trial in ATTEMPTS]
    assert summarise_attempt(ATTEMPTS + broken) == summarise_attempt(ATTEMPTS)


def test_a_file_without_a_request_can_be_read(tmp_path: Path):
    results.write(tmp_path / "a.json", RESULT)
    tree = json.loads((tmp_path / "a.json").read_text())
    del tree["request"]
    (tmp_path / "a.json").write_text(json.dumps(tree))
    assert results.read(tmp_path / "a.json") == replace(RESULT, request={})


def test_a_result_comes_back_as_it_was(tmp_path: Path):
    path = tmp_path / "new" / "assembly.json"
    results.write(path, RESULT)
    assert results.read(path) == RESULT
    first = path.read_bytes()
    results.write(path, RESULT)
    assert path.read_bytes() == first
    assert [entry.name for entry in path.parent.iterdir()] == ["assembly.json"]
    assert list(json.loads(first)) == [
        "experiment", "config", "seed", "engine", "device", "versions", "summary", "trials",
        "request",
    ]  # fmt: skip


def test_numpy_and_not_a_number_become_plain_json(tmp_path: Path):
    odd = ATTEMPTS[0] | {"inserted": np.bool_(True), "length": np.int32(7), "peak_force_n": np.float32("nan")}
    results.write(tmp_path / "a.json", replace(RESULT, experiment="attempt", summary=[], trials=[odd]))
    text = (tmp_path / "a.json").read_text()
    assert "NaN" not in text
    read = results.read(tmp_path / "a.json").trials[0]
    assert (read["inserted"], read["length"], read["peak_force_n"]) == (True, 7, None)


def broken(tmp_path: Path, change) -> Path:
    results.write(tmp_path / "r.json", RESULT)
    tree = json.loads((tmp_path / "r.json").read_text())
    change(tree)
    (tmp_path / "r.json").write_text(json.dumps(tree))
    return tmp_path / "r.json"


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda tree: tree.pop("seed"), "the key seed is missing"),
        (lambda tree: tree["summary"][1].pop("low"), "the key summary.1.low is missing"),
        (lambda tree: tree["trials"][2].pop("human"), "the key trials.2.human is missing"),
        (lambda tree: tree["trials"][0].update(attempts="many"), "trials.0.attempts"),
    ],
)
def test_what_is_not_a_result_is_named_in_one_line(tmp_path: Path, change, named: str):
    with pytest.raises(RequestError, match=named) as error:
        results.read(broken(tmp_path, change))
    assert "r.json" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [None, "{", "[]", b"\xff\xfe"])
def test_files_that_cannot_be_results(tmp_path: Path, content: str | bytes | None):
    path = tmp_path / "r.json"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(RequestError, match=r"r\.json") as error:
        results.read(path)
    assert "\n" not in str(error.value)
