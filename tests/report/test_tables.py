"""Results as tables: what pandas reads is what the files say."""

import json

import pandas
import pytest
from places import EXPERIMENTS

from mjx_fit.cli import main

RESULTS = [
    EXPERIMENTS / name
    for name in (
        "bench/insertion.json",
        "bench/position.json",
        "bench/robustness.json",
        "paper/forge/assembly.json",
    )
]
READ = {".csv": pandas.read_csv, ".parquet": pandas.read_parquet}


def table(out, *more):
    assert main.main(["table", *map(str, RESULTS), "--out", str(out), *more]) == 0
    return READ[out.suffix](out)


@pytest.mark.parametrize("suffix", READ)
def test_a_row_for_each_metric(suffix, tmp_path):
    got = table(tmp_path / f"table{suffix}")
    told = [(path, row) for path in RESULTS for row in json.loads(path.read_text())["summary"]]
    assert len(got) == len(told)
    for name in ("method", "metric", "value", "n"):
        assert got[name].tolist() == [row[name] for _, row in told]
    assert got["group"].astype(str).tolist() == [str(row["group"]) for _, row in told]
    assert got["file"].tolist() == [path.name for path, _ in told]
    low = [row["low"] for _, row in told]
    assert [None if pandas.isna(one) else one for one in got["low"]] == low


@pytest.mark.parametrize("suffix", READ)
def test_a_row_for_each_trial(suffix, tmp_path):
    got = table(tmp_path / f"table{suffix}", "--rows", "trials")
    told = [row for path in RESULTS for row in json.loads(path.read_text())["trials"]]
    assert len(got) == len(told)
    assert got["trial"].tolist() == [row["trial"] for row in told]
    position = got[got["experiment"] == "position"]
    errors = [json.loads(cell) for cell in position["error_cm"]]
    assert errors == [row["error_cm"] for row in json.loads(RESULTS[1].read_text())["trials"]]


def test_what_is_no_result_or_no_table_is_refused(tmp_path, capsys):
    (tmp_path / "other.json").write_text("{}")
    for words, expected in (
        ([str(tmp_path / "other.json"), "--out", str(tmp_path / "t.csv")], "is not a result file"),
        (
            [str(RESULTS[0]), "--out", str(tmp_path / "t.xlsx")],
            "expected a file that ends in .csv or .parquet",
        ),
    ):
        assert main.main(["table", *words]) == 2
        assert expected in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["other.json"]
