"""Levels that hold together."""

import itertools

import numpy as np
import pytest
from scipy import stats

from rmpc_bench.analysis.intervals import bootstrap_t, mean_interval, skewness, student
from rmpc_bench.analysis.levels import MANY, held_level


def test_all_sign_patterns_of_few_runs():
    """Oracle: the largest |t| over all 2^9 sign patterns by a plain loop."""
    x = np.random.default_rng(2).normal(size=(9, 3))
    x[:, 2] = 0.7 * x[:, 0] + 0.3 * x[:, 2]
    r = x - x.mean(axis=0)
    largest = []
    for signs in itertools.product([1, -1], repeat=9):
        flipped = r * np.array(signs)[:, None]
        largest.append(np.abs(stats.ttest_1samp(flipped, 0).statistic).max())
    critical = np.quantile(largest, 0.95)
    p = 2 * stats.t.sf(critical, 8)
    # The p value interpolates between patterns where the statistic does, but not linearly in it.
    assert held_level(x, 0.95, seed=1) == pytest.approx(1 - p, abs=2e-3)


def test_limits():
    """One comparison, and copies of it, keep the level; independent ones have nearly that of Sidak."""
    x = np.random.default_rng(3).normal(size=(300, 8))
    assert held_level(x[:, :1], 0.95, seed=1) == 0.95
    # The quantile of 4096 patterns has a standard error of 0.0034.
    assert held_level(np.repeat(x[:, :1], 8, axis=1), 0.95, seed=1) == pytest.approx(0.95, abs=0.012)
    assert 1 - held_level(x, 0.95, seed=1) == pytest.approx(1 - 0.95 ** (1 / 8), abs=0.0015)
    assert held_level(x, 0.95, seed=1) == held_level(x, 0.95, seed=1)


def test_missing_pairs_and_no_spread():
    """NaN leaves a run out; equal methods cannot be wrong by chance."""
    x = np.random.default_rng(4).normal(size=(40, 3))
    x[:, 1] = 0.0
    x[5:9, 2] = np.nan
    assert 0.95 < held_level(x, 0.95, seed=1) <= 0.975
    assert held_level(x[:, :2], 0.95, seed=1) == 0.95
    assert held_level(np.full((3, 2), np.nan), 0.95, seed=1) == 0.95


def test_equal_methods_show_a_direction_in_five_per_cent():
    """Eight equal methods against a common baseline, 400 experiments of 60 runs; one by one it is a quarter of them."""
    rng, wrong, plain, n = np.random.default_rng(5), 0, 0, 400
    for seed in range(n):
        runs = rng.normal(size=(60, 9))
        x = runs[:, 1:] - runs[:, :1]
        p = 2 * stats.t.sf(np.abs(stats.ttest_1samp(x, 0).statistic).max(), 59)
        wrong += p < 1 - held_level(x, 0.95, seed)
        plain += p < 0.05
    assert wrong / n <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / n)
    assert plain / n > 0.15


def test_bootstrap_t_of_a_skewed_sample():
    """The end on the side of the long tail lies farther out than that of the t interval, and the seed decides."""
    values = np.random.default_rng(6).lognormal(0, 1.6, 60)
    assert skewness(values) > 2 and skewness(-values) == -skewness(values)
    low, high = bootstrap_t(values, 0.95, seed=1)
    t = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert high > t.high and low > t.low
    found = mean_interval(values, 0.95, seed=1)
    assert found == (t.low, high) != mean_interval(values, 0.95, seed=2)
    normal = np.random.default_rng(7).normal(size=60)
    assert abs(skewness(normal)) < 0.5
    t = stats.ttest_1samp(normal, 0).confidence_interval(0.95)
    assert mean_interval(normal, 0.95, seed=1) == pytest.approx((t.low, t.high), rel=1e-12)


def test_bootstrap_t_of_a_normal_sample_is_near_student():
    """Oracle: Student's t, which is exact here; of 40 samples the mean ratio of the widths counts."""
    rng, ratios = np.random.default_rng(8), []
    for seed in range(40):
        values = rng.normal(size=80)
        low, high = bootstrap_t(values, 0.95, seed)
        t = stats.ttest_1samp(values, 0).confidence_interval(0.95)
        ratios.append((high - low) / (t.high - t.low))
    # About 3 % wide each; five standard errors of the mean of 40.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.025)


def test_many_runs_have_the_level_of_their_normal_limit(rng):
    """The level from normal numbers is that of sign flips, for correlated comparisons and a repeated one."""
    common = rng.standard_normal((MANY, 1))
    values = common + rng.standard_normal((MANY, 4)) * [0.3, 1.0, 1.0, 3.0]
    values = np.concatenate([values, values[:, :1]], axis=1)
    many, few = held_level(values, 0.95, seed=1), held_level(values[:-1], 0.95, seed=1)
    # 16384 and 4096 patterns: the standard error of the level is about 0.05 * sqrt(0.05 * 0.95 / 4096) / 0.05.
    assert many == pytest.approx(few, abs=5 * 0.0035 * 0.3)
    assert 0.95 < many < 1 - 0.05 / 5


def test_bootstrap_t_of_values_that_differ_by_rounding():
    """199 equal ratios and one outlier: a third of the resamples have no spread but for rounding, or none at all."""
    base = np.random.default_rng(0).lognormal(0.0, 0.3, 200)
    values = np.log(base * 0.5) - np.log(base)
    assert skewness(values) == 0
    values[0] = 1.0
    assert bootstrap_t(values, 0.95, seed=1) == student(values, 0.95)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_long_tail_is_longer_than_students(sign):
    """Oracle: the Cornish-Fisher term by scipy, with the skewness larger by its standard error from 20 values on."""
    for n, spread in ((12, 0.0), (40, np.sqrt(6 * 40 * 39 / (38 * 41 * 43)))):
        values = next(
            x for seed in range(99) if 0.5 < stats.skew(x := np.random.default_rng(seed).normal(size=n) ** 2) < 1
        )
        t, se = stats.t.ppf(0.995, n - 1), stats.sem(values)
        low, high = student(values, 0.99)
        longer = (stats.skew(values, bias=False) + spread) * (1 + 2 * t**2) / (6 * np.sqrt(n)) * se
        expected = sorted([sign * low, sign * (high + longer)])
        assert mean_interval(sign * values, 0.99, seed=1) == pytest.approx(expected, rel=1e-9)


def test_skewed_differences_are_seldom_wrong():
    """Exp(1) with mean 0 and 20 runs at the level that eight methods have: Student's misses it in 2.6 %."""
    rng, n = np.random.default_rng(35), 400
    samples = rng.exponential(size=(n, 20)) - 1
    level = 1 - 0.05 / 8
    plain = np.mean([student(x, level)[1] < 0 for x in samples])
    wrong = np.mean([not low <= 0 <= high for low, high in (mean_interval(x, level, seed=1) for x in samples)])
    # Three standard errors above the 0.9 % of 15,000 samples without bootstrap-t.
    assert wrong < 0.009 + 3 * np.sqrt(0.009 / n) and plain > 0.013
