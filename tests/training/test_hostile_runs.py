"""Files next to a checkpoint in a run's folder: empty, torn or planted."""

import json

import numpy as np
import pytest
from synthetic import make_episodes

from mjx_fit.cli import main
from mjx_fit.evaluation import parts
from mjx_fit.report.figures.style import picture
from mjx_fit.report.figures.training_run import read_metrics, training_curve
from mjx_fit.training.compatibility import require_new
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError

BROKEN = [
    "", "{", "[]", "3", "null", '"text"', "[" * 10_000, '{"data": 1}', '{"data": "\\ud800"}',
    '{"first_hole": 3}', '{"first_hole": {"sequence": 0}}',
    '{"first_hole": {"sequence": 0, "pos_world": [1]}}',
    '{"first_hole": {"sequence": "0", "pos_world": ["a", 1]}}', '{"data": NaN}', '{"data": "a", "data": "b"}',
    '{"first_hole": {"sequence": 0, "pos_world": [1e300, 0]}}',
]  # fmt: skip


@pytest.mark.parametrize("text", BROKEN)
def test_a_run_that_does_not_say_what_it_saw_is_one_line(text, tmp_path):
    """Held-out data could be what it was trained on."""
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(RequestError, match=r"run\.json cannot be used: it is damaged") as error:
        require_new(tmp_path, make_episodes(4, 2, min_length=1), "fingerprint")
    assert str(error.value).isprintable()


@pytest.mark.parametrize("text", [*BROKEN, None])
def test_a_report_of_a_run_needs_no_run_json(text, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "metrics.jsonl").write_text(
        '{"epoch": 0, "nll": 1, "val_nll": NaN, "prior_nll": 2.0}\n'
    )
    if text is not None:
        (tmp_path / "run" / "run.json").write_text(text)
    (tmp_path / "run" / "config.yaml").write_bytes(b"\x00\x1b[2J\xff")
    assert main.main(["report", str(tmp_path / "run"), "--out", str(tmp_path / "page")]) == 0
    assert "\x1b" not in (tmp_path / "page" / "index.html").read_text()


LINE = json.dumps({"epoch": 0, "nll": 1.0, "val_nll": 0.5, "prior_nll": 2.0})


@pytest.mark.parametrize("end", ["", "\n", '\n{"epoch": 1, "n', "\n{", '\n{"epoch": 1, "nll": NaN}', "\r\n"])
def test_metrics_of_a_run_that_was_killed_are_read(end, tmp_path):
    (tmp_path / "metrics.jsonl").write_text(LINE + end)
    rows = read_metrics(tmp_path / "metrics.jsonl")
    assert rows[0]["val_nll"] == 0.5
    assert "<svg" in picture("it", "", lambda: training_curve(rows)).svg


@pytest.mark.parametrize(
    "line",
    [
        "{", "3", "[]", "{}", '{"epoch": "x"}', '{"epoch": -1}', '{"epoch": 1e999}', '{"epoch": 1.5}',
        '{"epoch": 1, "nll": "low"}', '{"epoch": 1, "nll": [1]}', '{"epoch": 1, "nll": 1e300}',
        '{"epoch": 1, "val_nll": true}', "[" * 10_000,
        '{"epoch": ' + "9" * 5000 + "}", '{"epoch": 1, "epoch": 2}',
        '{"epoch": 1, "x": "' + "y" * 100_000 + '"}', "\ufeff{}",
    ],
)  # fmt: skip
def test_metrics_that_are_none_are_one_line(line, tmp_path):
    (tmp_path / "metrics.jsonl").write_text(f"{line}\n{LINE}\n")
    with pytest.raises(RequestError, match=r"metrics\.jsonl line 1 is not a record") as error:
        read_metrics(tmp_path / "metrics.jsonl")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_metrics_that_are_no_text_or_no_file_are_one_line(tmp_path):
    (tmp_path / "metrics.jsonl").write_bytes(b"\xff\xfe")
    (tmp_path / "endless.jsonl").symlink_to("/dev/zero")
    for name in ("metrics.jsonl", "endless.jsonl", "nowhere.jsonl"):
        with pytest.raises(RequestError, match="cannot be read"):
            read_metrics(tmp_path / name)


def test_large_files_that_are_none_of_ours_are_passed_over(tmp_path):
    """A folder may hold other people's JSON."""
    (tmp_path / "in").mkdir()
    with (tmp_path / "in" / "large.json").open("wb") as file:
        file.truncate(2**34)
    assert main.main(["report", str(tmp_path / "in"), "--out", str(tmp_path / "page")]) == 2


@pytest.mark.parametrize("text", ["", "[" * 10_000, "{", '[{"a": NaN}]', "\ufeff[]"])
def test_a_part_that_is_none_is_worked_out_again(text, tmp_path):
    (tmp_path / "part.json").write_text(text)
    assert parts._read(tmp_path / "part.json") is None


def test_a_run_of_earlier_versions_may_name_no_hole(tmp_path):
    data = make_episodes(4, 2, min_length=1)
    require_new(tmp_path, data, "fingerprint")
    (tmp_path / "run.json").write_text('{"seed": 0, "data": "other"}')
    require_new(tmp_path, data, "fingerprint")
    hole = [round(float(x), 7) for x in np.asarray(data.rollout.truth.hole_pos_world)[0]]
    (tmp_path / "run.json").write_text(json.dumps({"first_hole": {"sequence": 0, "pos_world": hole}}))
    with pytest.raises(RequestError, match="holes that the run was trained at"):
        require_new(tmp_path, data, "fingerprint")


def test_this_test_sees_the_weights_that_ship():
    weights = resources.folder("weights")
    assert len(read_metrics(weights / "metrics.jsonl")) > 10
