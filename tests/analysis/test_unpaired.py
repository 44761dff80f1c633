"""Methods whose runs are not paired: intervals of Welch, words, levels, differences of two experiments."""

import math

import numpy as np
import pytest
from comparison_tables import table
from scipy import stats

from rmpc_bench.analysis.comparison import comparisons, levels
from rmpc_bench.analysis.improvement_difference import improvement_differences
from rmpc_bench.analysis.superiority import independent_shares

MADE = {"unpaired": True, "adjust": "none"}


def samples(n=60, *, factor=0.8, spread=0.3, seed=1):
    """Return values of a baseline and a method; some runs of the method have failed."""
    rng = np.random.default_rng(seed)
    b, a = np.exp(0.3 * rng.standard_normal(n)), factor * np.exp(spread * rng.standard_normal(n))
    a[:5] = np.nan
    return {"B": b, "A": a}


def welch(a, b, level):
    """Return difference and interval from SciPy, of the values that are there."""
    found = stats.ttest_ind(a[~np.isnan(a)], b[~np.isnan(b)], equal_var=False)
    return (np.nanmean(a) - np.nanmean(b), *found.confidence_interval(level))


@pytest.mark.parametrize("spread", [0.1, 0.3, 2.0])
def test_logs_are_compared_after_welch(spread):
    values = samples(spread=spread)
    (row,) = comparisons(table(values, **MADE))
    found = [math.log1p(row[name] / 100) for name in ("change_pct", "ci_low", "ci_high")]
    assert found == pytest.approx(welch(np.log(values["A"]), np.log(values["B"]), 0.95), rel=1e-9)
    assert row["average"] == "geometric"
    assert row["mean_pct"] == pytest.approx(100 * (np.nanmean(values["A"]) / values["B"].mean() - 1), rel=1e-9)


def test_signed_metrics_are_compared_by_their_difference():
    values = {name: np.log(each) for name, each in samples().items()}
    (row,) = comparisons(table(values, **MADE))
    found = [row[name] for name in ("difference", "difference_low", "difference_high")]
    assert found == pytest.approx(welch(values["A"], values["B"], 0.95), rel=1e-9)


def test_the_order_of_the_runs_does_not_matter_and_none_is_won():
    values, rng = samples(), np.random.default_rng(2)
    (row,) = comparisons(table(values, **MADE))
    (other,) = comparisons(table(values | {"A": rng.permutation(values["A"])}, **MADE))
    for name in row:
        if isinstance(row[name], float):
            assert row[name] == pytest.approx(other[name], rel=1e-9, nan_ok=True), name
        else:
            assert row[name] == other[name], name
    assert [row[name] for name in ("won", "lost", "tied", "n_pairs", "p_wilcoxon_holm")] == [None] * 4 + [""]
    assert all(math.isnan(row[name]) for name in ("superiority", "superiority_low", "far_worse_upper"))
    assert (row["failed_only"], row["baseline_failed_only"]) == (5, 0)


@pytest.mark.parametrize(
    ("n", "factor", "spread", "word"),
    [
        (60, 0.5, 0.3, "better"),
        (60, 2.0, 0.3, "worse"),
        (60, 0.893, 0.3, "better-size-uncertain"),
        (60, 1.0, 0.3, "inconclusive"),
        (10, 0.1, 0.3, "inconclusive"),
    ],
)
def test_words(n, factor, spread, word):
    rng = np.random.default_rng(6)
    deviations = rng.standard_normal((2, n))
    # The half width is then known: 0.3 sqrt(2 / n) t, which is 0.108 for 60 runs; the margin is 0.00995.
    deviations = stats.zscore(deviations, axis=1, ddof=1)
    b, a = np.exp(0.3 * deviations[0]), factor * np.exp(spread * deviations[1])
    (row,) = comparisons(table({"B": b, "A": a}, **MADE))
    assert row["verdict"] == word


def test_equal_samples_and_samples_of_one_run():
    rng = np.random.default_rng(3)
    b = np.exp(0.01 * rng.standard_normal(300))
    (row,) = comparisons(table({"B": b, "A": rng.permutation(b)}, **MADE))
    assert row["verdict"] == "equivalent"
    for values in ({"B": [1.0, 1.0], "A": [2.0, 2.0]}, {"B": [1.0], "A": [2.0]}):
        (row,) = comparisons(table(values, **MADE))
        assert row["change_pct"] == pytest.approx(100.0)
        assert row["verdict"] == "inconclusive"
    (row,) = comparisons(table({"B": [1.0, 2.0], "A": [np.nan] * 2}, **MADE))
    assert math.isnan(row["change_pct"])


def test_more_failed_runs_decide():
    values = samples(200, factor=0.5)
    values["A"][:40] = np.nan
    (row,) = comparisons(table(values, **MADE))
    assert row["verdict"] == "fails-more"
    low, high = independent_shares((40, 0), (200, 200), 0.95)
    assert (row["failed_low"], row["failed_high"]) == pytest.approx((low, high))


def test_the_interval_of_two_independent_shares_is_that_of_its_paper():
    found = independent_shares((56, 48), (70, 80), 0.95)
    assert [round(end, 4) for end in found] == [0.0524, 0.3339]
    assert [round(end, 4) for end in independent_shares((9, 3), (10, 10), 0.95)] == [0.1705, 0.8090]


def test_levels_are_those_of_bonferroni_and_hold_together():
    rng, wrong, n_sets = np.random.default_rng(5), 0, 400
    for number in range(n_sets):
        values = {name: np.exp(0.3 * rng.standard_normal(40)) for name in "BACD"}
        trials = table(values, seed=number, **MADE)
        of = levels(trials)
        assert of.held == pytest.approx(1 - 0.05 / 3)
        wrong += any(row["ci_low"] > 0 or row["ci_high"] < 0 for row in comparisons(trials, of))
    # Three standard errors of the number of wrong sets.
    assert wrong <= 0.05 * n_sets + 3 * math.sqrt(0.05 * 0.95 * n_sets)


def test_about_so_many_runs_decide():
    values = samples(80, factor=0.95, seed=4)
    values["A"][:5] = 0.95
    (row,) = comparisons(table(values, **MADE))
    assert row["verdict"] == "inconclusive"
    logs = {name: np.log(each) for name, each in values.items()}
    variance = sum(float(np.var(each, ddof=1)) for each in logs.values())
    z = stats.norm.ppf(0.975) + stats.norm.ppf(0.8)
    wanted = z**2 * variance / float(logs["A"].mean() - logs["B"].mean()) ** 2
    assert row["runs_for_direction"] == math.ceil(wanted)


def test_improvements_are_compared_by_four_samples():
    one, other = samples(seed=1), samples(seed=9, factor=0.6, n=90)
    pair = [(table(one, **MADE), table(other, seed=8, **MADE))]
    (found,) = improvement_differences(pair, "A", pair[0][0].metrics[0], paired=False, is_primary=True)
    logs = [np.log(each[~np.isnan(each)]) for each in (one["A"], one["B"], other["A"], other["B"])]
    squares = np.array([np.var(each, ddof=1) / len(each) for each in logs])
    df = squares.sum() ** 2 / (squares**2 / [len(each) - 1 for each in logs]).sum()
    gap = logs[0].mean() - logs[1].mean() - logs[2].mean() + logs[3].mean()
    ends = gap + np.array([0, -1, 1]) * stats.t.ppf(0.975, df) * math.sqrt(squares.sum())
    assert np.log(found.averages[0].ratio) == pytest.approx(ends, rel=1e-9)
    assert found.verdict == "worse"
    assert math.isnan(found.superiority_a)
    assert (found.n_a, found.n_b, found.failed_a) == (55, 85, 5)
