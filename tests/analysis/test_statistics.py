"""Summary, comparisons, sentences."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from rmpc_bench.analysis.statistics import comparisons, format_with_error, sentence, summary
from rmpc_bench.types import MetricInfo

INF = math.inf
MSE = MetricInfo("mse", "", "lower")


def only(table):
    """Return the single row."""
    assert len(table) == 1
    return table.iloc[0]


def test_summary_by_hand(make_trials):
    """1..5 and one failed run."""
    table = summary(make_trials({"mse": {"A": [5.0, 1.0, None, 3.0, 2.0, 4.0]}}))
    columns = "method,metric,n,n_failed,mean,se,ci_low,ci_high,median,q25,q75,min,max,did_not_occur"
    assert ",".join(table.columns) == columns
    row = only(table)
    assert (row.n, row.n_failed, row["mean"], row["median"], row.q25, row.q75) == (5, 1, 3, 3, 2, 4)
    assert (row["min"], row["max"], row.did_not_occur) == (1, 5, 0)
    assert row.se == pytest.approx(math.sqrt(2.5 / 5), rel=1e-12)
    # 2.776445105198 is the tabulated t(0.975, 4).
    assert (row.ci_low, row.ci_high) == pytest.approx((3 - 2.776445105198 * row.se, 3 + 2.776445105198 * row.se))


def test_summary_of_an_event_that_may_not_occur_has_no_mean(make_trials):
    """Share and median remain."""
    row = only(summary(make_trials({"settling": {"A": [1.0, INF, 2.0, INF, INF]}})))
    assert np.isnan([row["mean"], row.se, row.ci_low, row.ci_high]).all()
    assert (row["median"], row.q25, row["max"], row.did_not_occur, row.n) == (INF, 2, INF, 3, 5)


def test_one_run_and_no_run(make_trials):
    """No crash, no warning, no interval."""
    table = summary(make_trials({"mse": {"A": [2.0], "B": [None]}}))
    assert (table["n"].tolist(), table["n_failed"].tolist()) == ([1, 0], [0, 1])
    assert table["mean"][0] == 2
    assert table[["se", "ci_low", "ci_high"]].isna().all(axis=None)
    assert math.isnan(table["median"][1])
    for other in ([4.0], [None]):
        row = only(comparisons(make_trials({"mse": {"A": [2.0], "B": other}})))
        assert (row.word, row.n_pairs) == ("not separated", int(other != [None]))
        assert np.isnan([row.ci_low, row.ci_high]).all()
        assert "not separated" in sentence(row, MSE) or "without an interval (paired, 95 %, 1 run" in sentence(row, MSE)
    assert row.p_wilcoxon_holm == ""


def test_huge_values_do_not_warn(make_trials):
    """Runs on the way to divergence."""
    trials = make_trials({"mse": {"A": [1e300, 1e308, 1.7e308], "B": [1.0, 2.0, 1e-300]}})
    assert summary(trials)["median"][0] == 1e308
    assert only(comparisons(trials)).lost == 3


def test_comparison_of_ratios(make_trials):
    """Geometric mean with Student t on the logs, counts, Wilcoxon on the logs."""
    rng = np.random.default_rng(0)
    b = rng.uniform(1, 3, 40)
    a = b * np.exp(rng.normal(-0.1, 0.05, 40))
    table = comparisons(make_trials({"mse": {"A": a, "B": b}}))
    assert ",".join(table.columns) == (
        "method,baseline,metric,change_pct,ci_low,ci_high,won,lost,tied,superiority,p_wilcoxon_holm,n_pairs,word"
    )
    row, logs = only(table), np.log(a / b)
    interval = stats.ttest_1samp(logs, 0).confidence_interval(0.95)
    expected = 100 * np.expm1([logs.mean(), interval.low, interval.high])
    assert [row.change_pct, row.ci_low, row.ci_high] == pytest.approx(list(expected), rel=1e-9)
    tied = np.abs(a / b - 1) <= 0.01
    assert (row.won, row.lost, row.tied) == (sum((a < b) & ~tied), sum((a > b) & ~tied), tied.sum())
    assert (row.superiority, row.word, row.p_wilcoxon_holm) == (np.mean(a < b), "better", "<0.001")


@pytest.mark.parametrize(
    ("direction", "factor", "word"),
    [
        ("lower", 0.9, "better"),
        ("lower", 1.1, "worse"),
        ("higher", 0.9, "worse"),
        ("higher", 1.1, "better"),
        ("lower", 0.997, "detectable but small"),
        ("higher", 0.997, "detectable but small"),
        ("lower", 1.0, "not separated"),
    ],
)
def test_words(make_trials, direction, factor, word):
    """The whole interval beyond the relevant size, respecting the direction."""
    b = np.linspace(1, 2, 30)
    a = b * factor * (1 + 1e-3 * np.resize([1, -1], 30))
    assert only(comparisons(make_trials({"m": {"A": a, "B": b}}, directions={"m": direction}))).word == word


def test_signed_metric_is_compared_by_size(make_trials):
    """An error of -1 is as good as one of 1."""
    trials = make_trials({"e": {"A": [-1.0, 1.0, -1.1], "B": [2.0, -2.0, 2.1]}}, directions={"e": "zero"})
    row = only(comparisons(trials))
    assert (row.won, row.superiority) == (3, 1)
    assert row.change_pct == pytest.approx(100 * (np.cbrt(0.5 * 0.5 * 1.1 / 2.1) - 1))
    assert sentence(row, MetricInfo("e", "", "zero")).startswith("A lowers |e| by ")


def test_zeros_and_negatives_use_differences(make_trials):
    """Mean paired difference in per cent of the size of the baseline's mean."""
    a, b = np.array([0.0, 1.0, -2.0, 3.0]), np.array([-1.0, -2.0, -2.0, -3.0])
    row = only(comparisons(make_trials({"m": {"A": a, "B": b}})))
    interval = stats.ttest_rel(a, b).confidence_interval(0.95)
    assert row.change_pct == pytest.approx(125)
    assert [row.ci_low, row.ci_high] == pytest.approx([50 * interval.low, 50 * interval.high])
    assert (row.won, row.lost, row.tied) == (0, 3, 1)
    row = only(comparisons(make_trials({"m": {"A": [1.0, 2.0, 3.0], "B": [1.0, -1.0, 0.0]}})))
    assert math.isnan(row.change_pct)


def test_an_event_that_does_not_occur(make_trials):
    """A finite value beats inf, inf ties with inf, and the word comes from the counts."""
    a = [1.0] * 12 + [INF, INF, 5.0]
    b = [INF] * 12 + [INF, 3.0, 5.001]
    row = only(comparisons(make_trials({"t": {"A": a, "B": b}})))
    assert np.isnan([row.change_pct, row.ci_low, row.ci_high]).all()
    assert (row.won, row.lost, row.tied, row.word) == (12, 1, 2, "better")
    assert row.superiority == pytest.approx(13.5 / 15)
    assert sentence(row, MetricInfo("t", "s", "lower")) == (
        "A is better than B in t (paired, 95 %, 15 runs; better in 12, tied in 2)."
    )
    swapped = only(comparisons(make_trials({"t": {"A": b, "B": a}})))
    assert (swapped.won, swapped.lost, swapped.word) == (1, 12, "worse")


def test_two_methods_that_do_not_settle_are_not_separated(make_trials):
    """No strict win on either side says nothing."""
    row = only(comparisons(make_trials({"t": {"A": [INF] * 50, "B": [INF] * 50}})))
    assert (row.tied, row.superiority, row.word, row.p_wilcoxon_holm) == (50, 0.5, "not separated", "1.000")


def test_holm_runs_across_methods_of_one_metric(make_trials):
    """Two methods double the smaller p, and a failed run loses its pair."""
    rng = np.random.default_rng(5)
    s = rng.uniform(1, 2, 12)
    a, b = s * np.exp(rng.normal(-0.05, 0.1, 12)), s * np.exp(rng.normal(-0.02, 0.1, 12))
    broken = [*a[:-1], None]
    table = comparisons(make_trials({"mse": {"A": broken, "B": b, "S": s}}))
    p = [stats.wilcoxon(np.log(x / y)).pvalue for x, y in ((a[:-1], s[:-1]), (b, s))]
    small, large = min(p), max(p)
    adjusted = {small: min(1, 2 * small), large: min(1, max(2 * small, large))}
    assert table["p_wilcoxon_holm"].tolist() == [f"{adjusted[value]:.3f}" for value in p]
    assert table["n_pairs"].tolist() == [11, 12]


def test_baseline_alone(make_trials):
    """Nothing to compare is an empty table with its columns."""
    table = comparisons(make_trials({"mse": {"A": [1.0, 2.0]}}))
    assert table.empty
    assert table.columns[0] == "method"


def row_of(**changes):
    """Return a row of comparisons.csv."""
    row = {"method": "R-MPC1", "baseline": "S-MPC", "change_pct": -10.2, "ci_low": -11.3, "ci_high": -9.0, "won": 195}
    row |= {"lost": 5, "tied": 0, "n_pairs": 200, "word": "better"}
    return pd.Series(row | changes)


def test_sentences():
    """Pasteable, with no more digits than the interval supports."""
    assert sentence(row_of(), MSE) == (
        "R-MPC1 lowers mse by 10.2 % [9.0, 11.3] against S-MPC (paired, 95 %, 200 runs; better in 195)."
    )
    small = row_of(change_pct=0.31234, ci_low=0.2512, ci_high=0.3789, word="detectable but small", tied=180, won=0)
    assert sentence(small, MSE, confidence=0.9) == (
        "R-MPC1 raises mse by 0.312 % [0.251, 0.379] against S-MPC, detectable but small "
        "(paired, 90 %, 200 runs; better in 0, tied in 180)."
    )
    unclear = row_of(change_pct=1.0, ci_low=-4.0, ci_high=6.0, word="not separated")
    assert sentence(unclear, MSE).startswith("R-MPC1 is not separated from S-MPC in mse: +1.0 % [-4.0, +6.0] (")


@pytest.mark.parametrize(
    ("value", "se", "text"),
    [
        (0.11861, 0.00149, "0.1186(15)"),
        (0.10541, 0.00071, "0.1054(7)"),
        (-0.10541, 0.00071, "-0.1054(7)"),
        (12.3456, 0.0997, "12.35(10)"),
        (323.5, 12.1, "324(12)"),
        (3235.0, 470.0, "3200(500)"),
        (1.23456e-7, 4.1e-9, "1.23(4)e-07"),
        (1.23456e8, 2.0e6, "1.235(20)e+08"),
        (0.0, 0.5, "0.0(5)"),
        (2.0, 0.0, "2"),
        (1 / 3, math.nan, "0.3333"),
        (INF, math.nan, "inf"),
        (math.nan, 1.0, "-"),
    ],
)
def test_format_with_error(value, se, text):
    """The bracket is the error of the last digits."""
    assert format_with_error(value, se) == text


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 10))
def test_format_keeps_value_within_its_error(value, se):
    """Rounding moves a value by at most half of its error."""
    body = format_with_error(value, se)
    shown = float(body[: body.index("(")] + body[body.index(")") + 1 :])
    assert abs(shown - value) <= 0.5 * se * 1.001


def test_best_at_one_compares_ratios(make_trials):
    """Oracle: |log| by hand; 0.5 is as far from 1 as 2, and 4 is twice as far."""
    trials = make_trials({"nees": {"A": [0.5, 2.0, 1.0], "B": [2.0, 4.0, 0.5]}}, directions={"nees": "one"})
    (row,) = comparisons(trials).to_dict("records")
    assert (row["won"], row["lost"], row["tied"]) == (2, 0, 1)
    assert " in |log nees|: " in sentence(row, MetricInfo("nees", "", "one"))
