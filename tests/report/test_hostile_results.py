"""Result files from elsewhere: read and drawn, or refused in one line."""

import json
import random
from pathlib import Path
from typing import Any

import hostile_results as hostile
import pytest

from mjx_fit.cli import main
from mjx_fit.evaluation import results
from mjx_fit.report import sections
from mjx_fit.report.page import page
from mjx_fit.report.terminal import print_summary
from mjx_fit.utils.errors import RequestError


@pytest.fixture(scope="module", params=hostile.RIGHT)
def right(request) -> dict[str, Any]:
    return hostile.right(request.param)


def put(path: Path, tree: Any) -> Path:
    path.write_text(json.dumps(tree))
    return path


def shown(path: Path) -> bool:
    """Whether a file is accepted; then everything that a report makes of it must come out."""
    try:
        result = results.read(path)
        made = sections.of_result("it", result)
    except RequestError as error:
        assert str(error).isprintable(), ascii(str(error))  # noqa: PT017
        assert len(str(error)) < 1000  # noqa: PT017
        return False
    page([made])
    print_summary(result)
    return True


def changes(right: dict[str, Any], path: Path, n: int, seed: int) -> tuple[int, int]:
    """How many of n changed files are accepted and refused."""
    rng, accepted = random.Random(seed), 0
    for number in range(n):
        tree = hostile.changed(right, rng)
        try:
            accepted += shown(put(path, tree))
        except Exception as error:
            raise AssertionError(f"change {number} of seed {seed}: {error!r}") from error
    return accepted, n - accepted


def test_results_of_ours_are_shown(right, tmp_path):
    assert shown(put(tmp_path / "r.json", right))


def test_every_committed_result_is_read():
    found = [
        path for path in hostile.EXPERIMENTS.rglob("*.json") if '\n "experiment"' in path.read_text()[:40]
    ]
    assert len(found) > 10
    for path in found:
        assert results.read(path).trials


def test_changed_results_are_shown_or_refused_in_one_line(right, tmp_path):
    """A sample; the slow test below tries a thousand."""
    _, refused = changes(right, tmp_path / "r.json", 15, seed=1)
    assert refused >= 4


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_three_hundred_changed_results_of_each_kind(right, tmp_path):
    accepted, refused = changes(right, tmp_path / "r.json", 300, seed=2)
    assert accepted >= 20
    assert refused >= 40


def test_a_report_of_a_changed_result_is_one_line_and_leaves_nothing(right, tmp_path, capsys):
    cases = {
        "pegs": [],
        "attempts": [],
        "tried": [[99]],
        "error_cm": 1e308,
        "method": "\ud800",
        "pair": ["cross"],
        "shape": "torus",
        "peak_force_n": [None] * 99,
        "inserted_at": 77,
        "type_probability": [1.0],
        "match_probability": 7.0,
        "matched": "yes",
        "human": [0, 1],
        "holes": ["cross", 3],
        "trial": 10**30,
        "length": -4,
        "squared_mahalanobis": [1.0],
    }
    for column in cases.keys() & right["trials"][0].keys():
        tree = json.loads(json.dumps(right))
        tree["trials"][1][column] = cases[column]
        path = put(tmp_path / "r.json", tree)
        capsys.readouterr()
        assert main.main(["report", str(path), "--out", str(tmp_path / "page")]) == 2, column
        said = capsys.readouterr().err.splitlines()
        assert len(said) == 1
        assert "r.json is not a result file: " in said[0], column
        assert not (tmp_path / "page").exists()


def test_a_name_in_brackets_is_no_markup(right, tmp_path, capsys):
    right = right | {
        "device": "[/red]",
        "summary": [*right["summary"], right["summary"][0] | {"group": "[/red]"}],
    }
    print_summary(results.read(put(tmp_path / "r.json", right)))
    assert "[/red]" in capsys.readouterr().out


def test_playing_a_trial_of_a_changed_result_is_one_line(tmp_path, capsys):
    tree = hostile.right("assembly")
    tree["request"]["trials"] = 10**15
    path = put(tmp_path / "r.json", tree)
    assert main.main(["render", str(path), "--out", str(tmp_path / "v.gif")]) == 2
    assert "request.trials: 1000000000000000 is invalid" in capsys.readouterr().err


HOSTILE = {
    "deep": "[" * 100_000,
    "deep objects": '{"a":' * 5000,
    "deep inside": '{"experiment": "x", "config": ' + "[" * 200 + "]" * 200 + "}",
    "NaN": '{"seed": NaN}',
    "infinite": '{"seed": -Infinity}',
    "too large": '{"seed": 1e999}',
    "digits": '{"seed": ' + "9" * 5000 + "}",
    "twice": '{"seed": 1, "seed": 2}',
    "half a pair": '{"experiment": "\\udc00"}',
    "half a pair as a key": '{"\\ud800": 1}',
    "a mark first": "\ufeff{}",
    "nothing": "",
    "a list": "[]",
    "a number": "3",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_json_that_is_hostile_is_one_line(name, tmp_path, capsys):
    path = tmp_path / "r.json"
    path.write_text(HOSTILE[name])
    assert main.main(["report", str(path), "--out", str(tmp_path / "page")]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert "r.json" in said[0]
    assert len(said[0]) < 400


def test_what_is_no_file_or_too_large_is_not_read(tmp_path, monkeypatch):
    (tmp_path / "r.json").symlink_to("/dev/zero")
    with pytest.raises(RequestError, match="not a regular file"):
        results.read(tmp_path / "r.json")
    with (tmp_path / "large.json").open("wb") as file:
        file.truncate(2**33)
    with pytest.raises(RequestError, match="it has more than 4,294,967,296 bytes"):
        results.read(tmp_path / "large.json")
