import math

import numpy as np
import pytest

from mjx_fit.evaluation.statistics import Interval, Row, bootstrap_mean, bootstrap_means, wilson

Z = 1.959963984540054


@pytest.mark.parametrize(("k", "n"), [(0, 8), (8, 8), (1, 8), (34, 100), (11, 500)])
def test_wilson_is_the_closed_form(k: int, n: int):
    p = k / n
    centre = (p + Z**2 / (2 * n)) / (1 + Z**2 / n)
    half = Z / (1 + Z**2 / n) * math.sqrt(p * (1 - p) / n + Z**2 / (4 * n**2))
    assert wilson(k, n) == pytest.approx((p, centre - half, centre + half), abs=1e-12)


def test_bootstrap_of_independent_values_agrees_with_the_normal_interval():
    values = np.random.default_rng(0).normal(3.0, 2.0, 400)
    half = Z * values.std(ddof=1) / 20
    mean, low, high = bootstrap_mean(values, range(400))
    assert mean == pytest.approx(values.mean())
    assert (low, high) == pytest.approx((mean - half, mean + half), abs=0.1 * half)


def test_bootstrap_covers_the_mean_of_dependent_observations():
    rng = np.random.default_rng(1)
    clusters = np.repeat(np.arange(40), 5)
    covered = naive = 0
    for trial in range(120):
        values = rng.normal(size=40)[clusters] + 0.5 * rng.normal(size=200)
        _, low, high = bootstrap_mean(values, clusters.tolist(), seed=trial)
        _, naive_low, naive_high = bootstrap_mean(values, range(200), seed=trial)
        covered += low <= 0 <= high
        naive += naive_low <= 0 <= naive_high
    assert 0.88 <= covered / 120 <= 0.99
    assert naive / 120 < 0.75  # what it would be if clusters were ignored


def test_bootstrap_weighs_observations_not_clusters():
    mean, low, high = bootstrap_mean(np.array([1.0, 1.0, 1.0, 5.0]), [7, 7, 7, 9])
    assert (mean, low, high) == (2.0, 1.0, 5.0)


def test_columns_share_their_draws_and_the_seed_decides():
    values = np.random.default_rng(2).normal(size=(30, 1))
    mean, low, high = bootstrap_means(np.hstack([values, 2 * values]), np.arange(30))
    assert np.allclose([2 * mean[0], 2 * low[0], 2 * high[0]], [mean[1], low[1], high[1]])
    again = bootstrap_means(values, np.arange(30))
    assert low[0] == pytest.approx(again[1][0])
    assert bootstrap_means(values, np.arange(30), seed=1)[1][0] != again[1][0]


def test_equal_values_have_no_spread_and_one_cluster_has_no_interval():
    value, low, high = bootstrap_mean(np.full(8, 0.1), range(8))
    assert (low, high) == pytest.approx((0.1, 0.1))
    assert low <= value <= high
    alone = bootstrap_mean(np.array([1.0, 2.0]), [0, 0])
    row = Row.of("full", "attempts", "all", alone, 1)
    names = {"method": "full", "metric": "attempts", "group": "all"}
    assert row.to_json() == {**names, "value": 1.5, "low": None, "high": None, "n": 1}
    assert Row.of("full", "attempts", "1", Interval(1.0, 0.5, 2.0), 3).low == 0.5
