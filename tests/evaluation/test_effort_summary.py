"""Summary of seconds and newtons: numbers by hand, medians against sorting, older files."""

import math

import numpy as np
import pytest

from mjx_fit.evaluation import assembly, attempt, insertion, result_schema
from mjx_fit.evaluation.effort_summary import summarise_effort
from mjx_fit.evaluation.statistics import bootstrap_median
from mjx_fit.task.effort import COLUMNS


def trial(number: int, seconds: list[float], success: bool = True, method: str = "full") -> dict:
    """One insertion trial whose forces are as many newtons as its attempts have seconds."""
    return {
        "trial": number, "seed": 0, "method": method, "shape": "cross", "attempts": len(seconds),
        "success": success, "seconds": seconds, "contact_s": [s / 2 for s in seconds],
        "peak_force_n": [*seconds], "over_20n_s": [0.06 for _ in seconds], "impulse_ns": [*seconds],
        "move_seconds": 0.5,
    }  # fmt: skip


def by_group(rows) -> dict:
    return {(row.metric, row.group): row for row in rows}


def test_seconds_and_newtons_of_trials():
    trials = [trial(0, [4.0]), trial(1, [10.0, 8.0]), trial(2, [10.0, 10.0, 10.0], success=False)]
    rows = by_group(summarise_effort("full", trials, success=[one["success"] for one in trials]))
    assert rows["seconds", "all"].value == pytest.approx((4 + 18 + 30) / 3)
    assert ("seconds", "median") not in rows  # its interval reaches the trial that failed
    assert rows["in_by_5s", "all"].value == pytest.approx(1 / 3)
    assert rows["in_by_10s", "all"].value == pytest.approx(1 / 3)
    assert rows["in_by_30s", "all"].value == pytest.approx(2 / 3)
    assert rows["peak_force_n", "all"].value == pytest.approx((4 + 10 + 10) / 3)
    assert rows["peak_force_n", "median"].value == 10
    assert rows["over_20n_share", "all"].value == pytest.approx(2 / 3)  # 0.06, 0.12 and 0.18 s
    assert rows["mean_force_n", "all"].value == pytest.approx(2)
    assert rows["impulse_ns", "all"].value == pytest.approx((4 + 18 + 30) / 3)
    assert rows["move_seconds", "all"].value == 0.5


def test_a_median_is_that_of_the_sorted_values_and_counts_failures_as_endless():
    rng = np.random.default_rng(0)
    values = rng.exponential(size=301)
    got = bootstrap_median(values, range(301))
    assert got.value == np.sort(values)[150]
    drawn = [np.sort(rng.choice(values, 301))[150] for _ in range(4000)]
    low, high = np.quantile(drawn, [0.025, 0.975])
    assert (got.low, got.high) == (pytest.approx(low, abs=0.03), pytest.approx(high, abs=0.03))
    endless = np.where(np.arange(301) < 160, np.inf, values)
    assert math.isinf(bootstrap_median(endless, range(301)).value)


def test_a_median_resamples_whole_clusters():
    values, clusters = np.repeat([1.0, 2.0, 3.0], 50), np.repeat([0, 1, 2], 50)
    assert bootstrap_median(values, clusters.tolist()) == (2, 1, 3)
    assert np.isnan(bootstrap_median(values, [0] * 150)[1:]).all()


def test_a_method_that_saves_seconds_is_seen_in_pairs():
    trials = [trial(i, [2.0 + i % 3]) for i in range(40)]
    trials += [trial(i, [7.0 + i % 3], method="no_update") for i in range(40)]
    rows = by_group(insertion.summarise(trials))
    assert rows["seconds_saved", "no_update"].value == pytest.approx(5)
    assert rows["seconds_p_value", "no_update"].value < 0.001
    assert rows["attempts_saved", "no_update"].value == 0


def test_files_without_these_columns_are_summarised_as_before():
    old = [
        {k: v for k, v in trial(i, [2.0]).items() if k in {"peak_force_n"} or k not in COLUMNS}
        for i in range(3)
    ]
    found = {row.metric for row in insertion.summarise(old)}
    assert "peak_force_n" in found
    assert not found & {"seconds", "in_by_5s", "over_20n_share", "mean_force_n", "seconds_saved"}
    assert summarise_effort("full", []) == []


def test_an_unknown_force_counts_as_none():
    broken = trial(0, [10.0]) | {name: [None] for name in COLUMNS if name != "seconds"}
    rows = by_group(summarise_effort("full", [broken], success=[False]))
    assert all(np.isfinite(row.value) for row in rows.values())
    assert rows["peak_force_n", "all"].value == 0


def test_an_assembly_adds_up_its_pegs_and_counts_those_in_time():
    one = {
        "trial": 0, "method": "full", "pegs": ["cross", "square"], "attempts": [1, 2], "human": [False, True],
        "seconds": [[4.0], [10.0, 10.0]], "contact_s": [[3.0], [9.0, 9.0]], "over_20n_s": [[0.0], [0.0, 0.2]],
        "peak_force_n": [[12.0], [9.0, 31.0]], "impulse_ns": [[9.0], [50.0, 40.0]], "move_seconds": 2.0,
    }  # fmt: skip
    rows = by_group(assembly.summarise([one, one | {"trial": 1}]))
    assert rows["seconds", "all"].value == 24
    assert rows["peak_force_n", "all"].value == 31
    assert rows["mean_force_n", "all"].value == pytest.approx(99 / 21)
    assert (rows["in_by_5s", "all"].value, rows["in_by_5s", "all"].n) == (0.5, 4)
    assert rows["in_by_30s", "all"].value == 0.5  # a human put the other one in


def test_single_attempts_are_split_by_match_and_diverged_ones_left_out():
    def one(number: int, matched: bool, valid: bool = True) -> dict:
        pair = ["cross", "cross" if matched else "square"]
        kept = trial(number, [3.0 + 4 * matched])
        return {"pair": pair, "matched": matched, "inserted": matched, "valid": valid, "length": 30} | {
            name: kept[name] for name in ("trial", "move_seconds", *COLUMNS)
        }

    rows = by_group(attempt.summarise([one(0, True), one(1, False), one(2, False, valid=False)]))
    assert rows["seconds", "matched"].value == 7
    assert rows["seconds", "mismatched"].value == 3
    assert rows["in_by_10s", "matched"].value == 1
    assert ("in_by_10s", "mismatched") not in rows


@pytest.mark.parametrize("column", COLUMNS)
def test_a_column_of_another_length_is_refused(column):
    tree = {
        "experiment": "insertion", "config": {}, "seed": 0, "engine": "native", "device": "cpu",
        "versions": {}, "summary": [], "trials": [trial(0, [1.0, 2.0])],
    }  # fmt: skip
    result_schema.require(tree)
    tree["trials"][0][column] = [1.0]
    with pytest.raises(ValueError, match=rf"^trials\.0\.{column}: 1 values cannot be used: attempts has 2"):
        result_schema.require(tree)


def test_a_peg_that_takes_exactly_the_limit_is_in_by_it():
    """Also where the sum of tenths is a rounding error above it; a tenth of a second more is too late."""
    trials = [
        trial(i, seconds) for i, seconds in enumerate([[0.1] * 50, [5.1], [10.0], [10.1], [30.0], [30.1]])
    ]
    assert sum([0.1] * 50) != 5
    rows = by_group(summarise_effort("full", trials, success=[True] * 6))
    assert [rows[f"in_by_{limit}s", "all"].value * 6 for limit in (5, 10, 30)] == pytest.approx([1, 3, 5])
