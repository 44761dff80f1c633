"""Intervals of claims from resamples: many of them together, and of very many runs."""

import math

import numpy as np
import pytest
from scipy import stats

from rmpc_bench.analysis.intervals import mean_interval
from rmpc_bench.claims import spread
from rmpc_bench.claims.claim import Claim, Finding
from rmpc_bench.claims.verdict import judge


def interval(trials, check):
    """Interval of the only comparison of a claim."""
    claim = Claim("A is more accurate", "Fig. 7", (check,), finding=Finding.CONFIRMED, stated=None, assumptions=("a",))
    return judge(claim, trials).comparisons[0].interval


@pytest.mark.parametrize(
    "check",
    [
        "median(mse[A]) < median(mse[B])",
        "quantile(mse[A], 0.9) < 2 * median(mse[B]) - 0.1",
        "median(mse[A]) ~ 1 +- 10%",
        "-median(mse[A]) < 0",
        "ratio(mean(mse[A]), mean(mse[B])) < 1",
        "std(mse[A]) / mean(mse[A]) < max(mse[B]) - min(mse[A])",
        "share(mse[A] < median(mse[A]) < mse[B]) < ratio(mse[A], mse[B])",
    ],
)
@pytest.mark.parametrize("n", [10, 61, 1500])
def test_together_as_one_by_one(make_trials, monkeypatch, check, n):
    """The same bits, also where some runs failed and where blocks of resamples end."""
    rng = np.random.default_rng(3)
    columns = {"A": [None, *rng.lognormal(0, 0.1, n)], "B": [*rng.lognormal(0.1, 0.2, n), None]}
    trials = make_trials({"mse": columns})
    monkeypatch.setattr(spread, "_TOGETHER", 300 * n + 1)
    found = interval(trials, check)
    monkeypatch.setattr(spread, "_is_by_columns", lambda link, evaluator: False)
    assert found == interval(trials, check)


def test_very_many_runs(make_trials, monkeypatch):
    """Resamples of fewer runs, scaled, give the interval of all runs: here that of the normal law of a median."""
    rng = np.random.default_rng(4)
    n, shift = 4000, 0.05
    trials = make_trials({"mse": {"A": rng.normal(1, 0.1, n), "B": rng.normal(1 + shift, 0.2, n)}})
    check = "median(mse[A]) < median(mse[B])"
    whole = interval(trials, check)
    monkeypatch.setattr(spread, "MOST_DRAWN", 1000)
    low, high = interval(trials, check)
    se = math.sqrt(math.pi / 2 * (0.1**2 + 0.2**2) / n)
    reach = stats.norm.ppf(0.975) * se
    # 1000 resamples know the ends of an interval to 5 % of its width.
    assert high - low == pytest.approx(2 * reach, rel=0.15)
    assert (low, high) == pytest.approx(whole, abs=0.3 * reach)
    assert low < np.median(trials.column("mse", "A")) - np.median(trials.column("mse", "B")) < high


def test_an_event_that_occurs_in_few_of_many_runs(make_trials, monkeypatch):
    """A median that is infinite has nothing to scale."""
    monkeypatch.setattr(spread, "MOST_DRAWN", 100)
    trials = make_trials({"mse": {"A": np.r_[np.full(250, 1.0), np.full(50, np.inf)], "B": np.full(300, np.inf)}})
    assert interval(trials, "median(mse[A]) < median(mse[B])") == (-math.inf, -math.inf)


def test_the_best_of_several_is_favoured_by_chance(make_trials):
    """Three means: their intervals hold together, that of their minimum from the smallest end to the smallest end."""
    values = 10 + np.random.default_rng(5).normal(size=(3, 20))
    trials = make_trials({"mse": dict(zip("ABC", values, strict=True))})
    reach = stats.t.ppf(1 - 0.025 / 3, 19) * stats.sem(values, axis=1)
    lows, highs = values.mean(axis=1) - reach, values.mean(axis=1) + reach
    means = "[mean(mse[A]), mean(mse[B]), mean(mse[C])]"
    expected = lows.min() - 9, highs.min() - 9
    assert interval(trials, f"min({means}) < 9") == pytest.approx(expected)
    expected = lows.max() - highs.min(), highs.max() - lows.min()
    assert interval(trials, f"max({means}) > min({means})") == pytest.approx(expected)


def test_a_part_of_a_rare_share(make_trials):
    """Fewer than ten hits: the exact intervals of both shares, whose corners bound the difference."""
    trials = make_trials({"mse": {"A": [9.0] * 1 + [1.0] * 59, "B": [1.0] * 50 + [9.0] * 10}})
    low, high = interval(trials, "share(mse[A] > 5) < 0.5 * share(mse[B] > 5)")
    end = stats.binomtest(1, 60).proportion_ci(0.95).high
    assert high >= end - 0.5 * 10 / 60 and low < 0


@pytest.mark.parametrize(("n", "holds"), [(100, "inconclusive"), (200, "confirmed")])
def test_equal_shares(make_trials, n, holds):
    """No pair differs: each side has at most the share of an event that did not occur; zeros alone are no share."""
    hits = [1.0] * (n // 4) + [0.0] * (3 * n // 4)
    trials = make_trials({"mse": {"A": hits, "B": hits, "C": [0.0] * n, "D": [0.0] * n}})
    low, high = interval(trials, "mean(mse[A]) ~ mean(mse[B]) +- 0.02")
    z = stats.norm.ppf(0.975)
    assert (low, high) == pytest.approx((-z * z / (n + z * z), z * z / (n + z * z)), rel=1e-6)
    claim = Claim("s", "Fig. 7", ("mean(mse[A]) ~ mean(mse[B]) +- 0.02",), finding=Finding.CONFIRMED)
    assert judge(claim, trials).finding.value == holds
    assert interval(trials, "mean(mse[C]) ~ mean(mse[D]) +- 0.02") == (-math.inf, math.inf)


def test_an_absolute_value_and_a_smooth_function_beside_a_number(make_trials):
    """The interval of d for two sides, folded at 0; a number repeats without hiding anything."""
    a, b = np.random.default_rng(10).normal(3, 1, (2, 60))
    trials = make_trials({"mse": {"A": a, "B": b, "C": b + 2}})
    low, high = stats.ttest_rel(a, b).confidence_interval(0.975)
    assert low < 0 < high
    assert interval(trials, "abs(mean(mse[A]) - mean(mse[B])) < 0.1") == pytest.approx((-0.1, max(-low, high) - 0.1))
    ends = stats.ttest_rel(a, b + 2).confidence_interval(0.975)
    found = interval(trials, "abs(mean(mse[A]) - mean(mse[C])) > 1")
    assert found == pytest.approx((-ends.high - 1, -ends.low - 1))
    low, high = interval(trials, "std(mse[A]) < 2")
    assert -2 < low < np.std(a, ddof=1) - 2 < high < 0


def test_a_ratio_of_skewed_means(make_trials):
    """Beside a divisor that hardly varies it is the interval of the mean above it, longer tail included."""
    a = np.exp(np.random.default_rng(9).normal(size=40))
    trials = make_trials({"mse": {"A": a, "B": 5 + 1e-6 * np.sin(np.arange(40))}})
    low, high = mean_interval(a, 0.95, 7)
    plain = stats.ttest_1samp(a, 0).confidence_interval(0.95)
    found = interval(trials, "mean(mse[A]) / mean(mse[B]) < 1")
    assert found[1] > plain.high / 5 - 1 + 1e-3
    assert found == pytest.approx((low / 5 - 1, high / 5 - 1), abs=0.01)
