import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import bootstrap, permutation_test

from mjx_fit.evaluation.statistics import (
    Interval,
    Row,
    bootstrap_mean,
    bootstrap_means,
    bootstrap_ratio,
    clustered_rate,
    holm,
    sign_flip,
    wilson,
)

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


def test_bootstrap_of_means_and_ratios_is_scipys():
    rng = np.random.default_rng(3)
    hard = rng.uniform(5, 30, 100)  # the same trial is hard for both
    one, other = hard * rng.uniform(0.3, 0.5, 100), hard * rng.uniform(0.8, 1.2, 100)

    def scipys(data, statistic):
        found = bootstrap(data, statistic, paired=True, method="percentile", n_resamples=2000, rng=rng)
        return found.confidence_interval

    mean = bootstrap_mean(one, range(100))
    assert mean[1:] == pytest.approx(tuple(scipys((one,), np.mean)), rel=0.02)
    ratio = bootstrap_ratio(one, other)
    expected = scipys((one, other), lambda a, b, axis: a.mean(axis) / b.mean(axis))
    assert ratio.value == pytest.approx(one.mean() / other.mean())
    assert ratio[1:] == pytest.approx(tuple(expected), rel=0.01)
    # Pairs that were torn apart would make it several times as wide.
    torn = scipys((one, rng.permutation(other)), lambda a, b, axis: a.mean(axis) / b.mean(axis))
    assert ratio.high - ratio.low < 0.5 * (torn.high - torn.low)


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


@pytest.mark.parametrize("seed", range(4))
def test_sign_flip_is_scipys_permutation_test(seed):
    """Twelve pairs: SciPy goes through all 4096 sign patterns."""
    differences = np.random.default_rng(seed).normal(0.4, 1, 12)
    zeros = np.zeros(12)
    exact = permutation_test(
        (differences, zeros), lambda a, b: np.mean(a - b), permutation_type="samples", n_resamples=5000
    ).pvalue
    got = sign_flip(differences, np.arange(12))
    assert got == pytest.approx(exact, abs=0.01)
    together = sign_flip(np.repeat(differences, 3), np.repeat(np.arange(12), 3))
    assert together == got


def test_a_method_against_itself_is_found_different_as_often_as_the_level_says(monkeypatch):
    """Attempts as they come, half of the draws hard; a thousand experiments of 60 draws and 3 seeds."""
    monkeypatch.setattr("mjx_fit.evaluation.statistics.FLIPS", 999)
    rng = np.random.default_rng(0)
    draws, seeds, rejected = 60, 3, 0
    for experiment in range(1000):
        chance = rng.choice([0.2, 0.8], size=(draws, 1))
        one, other = (np.minimum(rng.geometric(chance, (draws, seeds)), 11) for _ in range(2))
        difference = (one - other).ravel()
        rejected += sign_flip(difference, np.repeat(np.arange(draws), seeds), seed=experiment) < 0.05
    assert 30 <= rejected <= 70


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holm_rejects_what_its_steps_reject(p_values):
    adjusted = holm(p_values)
    for level in (0.01, 0.05, 0.3):
        # Step down: the smallest against level / m, the next against level / (m - 1), until one fails.
        rejected, m = set(), len(p_values)
        for step, i in enumerate(sorted(range(m), key=lambda i: p_values[i])):
            if p_values[i] * (m - step) > level:
                break
            rejected.add(i)
        assert {i for i in range(m) if adjusted[i] <= level} == rejected
    assert all(a >= p for a, p in zip(adjusted, p_values, strict=True))


@given(value=st.floats(-1e3, 1e3), n=st.integers(2, 60))
def test_an_interval_holds_its_mean_whatever_rounding_does(value, n):
    mean, low, high = bootstrap_mean(np.full(n, value), range(n))
    assert low <= mean <= high
    assert high - low <= 1e-12 * abs(value)


def test_a_rate_without_spread_is_wilsons_over_clusters():
    clusters = [0, 0, 0, 4, 4, 9]
    assert clustered_rate(np.ones(6, bool), clusters) == wilson(3, 3)
    assert clustered_rate(np.zeros(6, bool), clusters) == wilson(0, 3)
    assert (wilson(3, 3).value, wilson(0, 3).value) == (1, 0)
    some = np.array([True, True, False, True, False, False])
    assert clustered_rate(some, clusters) == bootstrap_mean(some, clusters)


def test_sign_flip_counts_the_pattern_that_was_seen():
    """Of 60 draws alike no other pattern of 20,000 goes as far; of one draw every pattern does, as it does
    where draws cancel out."""
    assert sign_flip(np.full(60, 0.7), range(60)) == 1 / 20_001
    assert sign_flip(np.array([0.3, 0.4]), [5, 5]) == 1
    assert sign_flip(np.array([0.1, 0.2, -0.3]), range(3)) == 1
