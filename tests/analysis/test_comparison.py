"""Paired comparisons: averages, counts, superiority, verdict of a table."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from comparison_tables import table
from conftest import ROUND
from data_frames import comparison_frame
from scipy import stats

from rmpc_bench.analysis.comparison import COLUMNS, comparisons, levels
from rmpc_bench.analysis.intervals import FEW
from rmpc_bench.analysis.pairs import pairs_of, worst_finished
from rmpc_bench.analysis.superiority import POWER, runs_for_count
from rmpc_bench.types import MetricInfo

INF = math.inf
NORMAL_SCORES = stats.norm.ppf((np.arange(200) + 0.5) / 200)
"""200 numbers with mean 0, spread evenly over the normal distribution."""


def only(table):
    """Return the single row."""
    assert len(table) == 1
    return table.iloc[0]


def logs_with_interval(low, high, n=200):
    """Return log ratios whose 95 % t interval has these ends."""
    scores = NORMAL_SCORES if n == 200 else stats.norm.ppf((np.arange(n) + 0.5) / n)
    reach = stats.t.ppf(0.975, n - 1) * scores.std(ddof=1) / math.sqrt(n)
    return (low + high) / 2 + scores * (high - low) / 2 / reach


def compared(make_trials, ratios, **changes):
    """Return the row of a method whose runs have these ratios to the baseline."""
    base = np.resize([1.0, 1.7, 0.6], len(ratios))
    trials = make_trials({"mse": {"A": base * ratios, "B": base}})
    return only(comparison_frame(replace(trials, **changes)))


def test_columns_of_the_file(make_trials):
    """The thirteen of the product page first, in this order; then the rest."""
    assert ",".join(COLUMNS[:13]) == (
        "method,baseline,metric,change_pct,ci_low,ci_high,won,lost,tied,superiority,p_wilcoxon_holm,n_pairs,verdict"
    )
    [row] = comparisons(make_trials({"mse": {"A": [1.0, 2.0], "B": [2.0, 3.0]}}))
    assert list(row) == COLUMNS


def test_geometric_mean_of_the_ratios(make_trials):
    """Student t on the logs, counts, Wilcoxon on the logs; ties lie within 1 % on both sides, alike on logs."""
    rng = np.random.default_rng(0)
    b = rng.uniform(1, 3, 40)
    a = b * np.exp(rng.normal(-0.1, 0.05, 40))
    row, logs = only(comparison_frame(make_trials({"mse": {"A": a, "B": b}}))), np.log(a / b)
    interval = stats.ttest_1samp(logs, 0).confidence_interval(0.95)
    expected = 100 * np.expm1([logs.mean(), interval.low, interval.high])
    assert [row.change_pct, row.ci_low, row.ci_high] == pytest.approx(list(expected), rel=1e-9)
    assert (row.average, row.ci_level, row.verdict, row.p_wilcoxon_holm) == ("geometric", 0.95, "better", "< 0.001")
    tied = np.abs(logs) <= math.log(1.01)
    assert (row.won, row.lost, row.tied) == (sum((logs < 0) & ~tied), sum((logs > 0) & ~tied), tied.sum())
    assert row.superiority == (row.won + row.tied / 2) / 40


def test_ratio_of_the_means_has_the_interval_of_the_jackknife(make_trials):
    """Oracles: the jackknife by leaving out one run after the other, and the delta method, which is its limit.

    Delta method: var(log(mean a / mean b)) = (cv_a^2 + cv_b^2 - 2 cov / (mean a mean b)) / n, from the sample moments.
    """
    rng = np.random.default_rng(1)
    b = rng.gamma(4.0, size=60)
    a = 0.8 * b + rng.gamma(2.0, 0.1, 60)
    row = only(comparison_frame(replace(make_trials({"mse": {"A": a, "B": b}}), headline="mean")))
    cov, (mean_a, mean_b) = np.cov(a, b), (a.mean(), b.mean())
    variance = (cov[0, 0] / mean_a**2 + cov[1, 1] / mean_b**2 - 2 * cov[0, 1] / mean_a / mean_b) / 60
    left_out = [math.log(np.delete(a, i).mean() / np.delete(b, i).mean()) for i in range(60)]
    jackknife = 59 / 60 * np.sum((left_out - np.mean(left_out)) ** 2)
    log, reach = math.log(mean_a / mean_b), stats.t.ppf(0.975, 59) * math.sqrt(jackknife)
    expected = 100 * np.expm1([log, log - reach, log + reach])
    np.testing.assert_allclose([row.change_pct, row.ci_low, row.ci_high], expected, **ROUND)
    # They differ by terms of the order 1/n of the variance.
    assert jackknife == pytest.approx(variance, rel=1 / 60)
    assert row.average == "mean" and row.mean_pct == row.change_pct
    assert row.geometric_pct == pytest.approx(100 * math.expm1(np.log(a / b).mean()), rel=1e-9)
    alone = only(comparison_frame(replace(make_trials({"mse": {"A": a, "B": b}}), average="geometric")))
    assert math.isnan(alone.mean_pct) and alone.average == "geometric"


@pytest.mark.parametrize(
    ("low", "high", "word"),
    [
        (-0.12, -0.09, "better"),
        (0.02, 0.05, "worse"),
        # Reported as "detectable but small" before: the size is not known to be small.
        (math.log(0.91), math.log(0.992), "better-size-uncertain"),
        (math.log(0.924), math.log(1.0004), "inconclusive"),
        (0.002, 0.05, "worse-size-uncertain"),
        (-0.004, 0.003, "equivalent"),
        (0.002, 0.004, "equivalent"),
        (-0.02, 0.015, "inconclusive"),
    ],
)
def test_verdicts_of_the_table(make_trials, low, high, word):
    """From 200 runs whose interval has the ends given; exchanged methods exchange the words."""
    ratios = np.exp(logs_with_interval(low, high))
    row = compared(make_trials, ratios, average="geometric")
    assert row.verdict == word
    assert [row.ci_low, row.ci_high] == pytest.approx([100 * math.expm1(low), 100 * math.expm1(high)], rel=1e-9)
    other = word.replace("worse", "x").replace("better", "worse").replace("x", "better")
    assert compared(make_trials, 1 / ratios, average="geometric").verdict == other


@pytest.mark.parametrize("direction", ["lower", "higher"])
def test_direction_decides_which_side_is_better(make_trials, direction):
    """A higher score is better, with the same size."""
    base = np.linspace(1, 2, 30)
    values = {"A": base * np.exp(0.1 + 0.01 * np.resize([1, -1], 30)), "B": base}
    row = only(comparison_frame(make_trials({"m": values}, directions={"m": direction})))
    better = direction == "higher"
    assert (row.verdict, row.won, row.lost) == (("better", 30, 0) if better else ("worse", 0, 30))
    assert row.change_pct == pytest.approx(100 * math.expm1(0.1), rel=1e-9)


def test_averages_that_contradict_each_other(make_trials):
    """Most runs are better by a fifth, one in ten is ten times worse where the values are large."""
    base = np.where(np.arange(200) % 10 == 0, 20.0, 1.0)
    ratios = np.where(np.arange(200) % 10 == 0, 2.0, 0.8)
    trials = make_trials({"mse": {"A": base * ratios, "B": base}})
    row = only(comparison_frame(trials))
    assert row.geometric_high < 0 < row.mean_low and row.verdict == "depends-on-average"
    assert only(comparison_frame(replace(trials, average="geometric"))).verdict == "better"
    assert only(comparison_frame(replace(trials, average="mean"))).verdict == "worse"


def test_signed_metric_has_differences_in_its_unit(make_trials):
    """An error of -1 is as good as one of 1; 0.05 nearer to 0 is equivalent within a margin of 0.1."""
    base = np.resize([1.0, -1.0], 40)
    spread = np.resize([0.01, -0.01, -0.01, 0.01], 40)
    trials = make_trials({"e": {"A": base * 0.95 + spread, "B": base}}, directions={"e": "zero"})
    row = only(comparison_frame(trials))
    gap = np.abs(base * 0.95 + spread) - 1
    low, high = stats.ttest_1samp(gap, 0).confidence_interval(0.95)
    np.testing.assert_allclose([row.difference, row.difference_low, row.difference_high], [gap.mean(), low, high], 1e-8)
    assert np.isnan([row.change_pct, row.ci_low, row.mean_pct]).all()
    assert (row.average, row.won, row.verdict) == ("difference", 40, "better")
    row = only(comparison_frame(replace(trials, margins={"e": 0.1})))
    assert (row.won, row.tied, row.verdict) == (0, 40, "equivalent")


def test_metric_with_negative_values_is_signed(make_trials):
    """Differences in its unit, not in per cent of the baseline's mean, which may be 0."""
    a, b = np.array([0.0, 1.0, -2.0, 3.0]), np.array([-1.0, -2.0, -2.0, -3.0])
    row = only(comparison_frame(make_trials({"m": {"A": a, "B": b}})))
    interval = stats.ttest_rel(a, b).confidence_interval(0.95)
    np.testing.assert_allclose([row.difference, row.difference_low], [2.5, interval.low], 1e-8)
    assert (row.won, row.lost, row.tied) == (0, 3, 1)


def test_best_at_one_compares_factors(make_trials):
    """0.5 is as far from 1 as 2, and 4 is twice as far."""
    trials = make_trials({"nees": {"A": [0.5, 2.0, 1.0], "B": [2.0, 4.0, 0.5]}}, directions={"nees": "one"})
    row = only(comparison_frame(trials))
    assert (row.won, row.lost, row.tied) == (2, 0, 1)
    assert row.change_pct == pytest.approx(100 * (0.25 ** (1 / 3) - 1))


def test_zeros_leave_the_ratio_of_the_means(make_trials):
    """A count that is 0 in some runs has no geometric mean; one that is 0 in all does not differ."""
    b = np.resize([0.0, 1.0, 2.0, 3.0], 40)
    row = only(comparison_frame(make_trials({"m": {"A": 2 * b, "B": b}})))
    assert (row.average, row.verdict) == ("mean", "worse") and math.isnan(row.geometric_pct)
    assert row.change_pct == pytest.approx(100, rel=1e-9)
    row = only(comparison_frame(make_trials({"m": {"A": [0.0] * 40, "B": [0.0] * 40}})))
    assert (row.change_pct, row.tied, row.verdict) == (0.0, 40, "equivalent")


def test_an_event_that_does_not_occur(make_trials):
    """A finite value beats inf, inf ties with inf, and counts decide."""
    a = [1.0] * 22 + [INF, INF, 5.0]
    b = [INF] * 22 + [INF, 3.0, 5.001]
    row = only(comparison_frame(make_trials({"t": {"A": a, "B": b}})))
    assert np.isnan([row.change_pct, row.ci_low, row.ci_high]).all()
    assert (row.won, row.lost, row.tied, row.verdict, row.average) == (22, 1, 2, "better", "")
    assert row.superiority == pytest.approx(23 / 25)
    swapped = only(comparison_frame(make_trials({"t": {"A": b, "B": a}})))
    assert (swapped.won, swapped.lost, swapped.verdict) == (1, 22, "worse")
    finite = make_trials({"t": {"A": [1.0] * 40, "B": [2.0] * 40}})
    row = only(comparison_frame(replace(finite, metrics=(MetricInfo("t", "s", "lower", True),))))
    assert math.isnan(row.change_pct) and row.verdict == "better"


def test_two_methods_that_do_not_settle(make_trials):
    """Ties alone say nothing."""
    row = only(comparison_frame(make_trials({"t": {"A": [INF] * 50, "B": [INF] * 50}})))
    assert (row.tied, row.superiority, row.verdict, row.p_wilcoxon_holm) == (50, 0.5, "inconclusive", "1.000")


def test_one_rule_for_ties(make_trials):
    """30 won and 10 tied stood beside a superiority of 100 %, which counted every difference below the margin."""
    ratios = np.concatenate([np.full(30, 0.9), np.full(10, 0.995)])
    row = compared(make_trials, ratios)
    assert (row.won, row.lost, row.tied) == (30, 0, 10)
    assert row.superiority == 0.875 and row.superiority_low < 0.875 < row.superiority_high < 1
    # Alike on logs: 1 % more and the inverse, 0.990099, are tied, whatever their last digit is.
    row = compared(make_trials, np.array([1.01, 1 / 1.01, 0.99, 1.0101]))
    assert (row.won, row.lost, row.tied) == (1, 1, 2)


def test_few_untied_pairs_leave_counts(make_trials):
    """15 of 15 are better without a size; 4 of 4 and identical methods in 10 runs decide nothing."""
    ratios = np.linspace(0.7, 0.8, 15)
    assert compared(make_trials, ratios).verdict == "better"
    assert compared(make_trials, ratios[:4]).verdict == "inconclusive"
    assert compared(make_trials, np.ones(10)).verdict == "inconclusive"
    # One outlier among tied runs: the t interval would rest on it.
    assert compared(make_trials, np.concatenate([np.ones(199), [0.01]])).verdict == "inconclusive"


def test_failures_are_no_advantage(make_trials):
    """A method that fails in the hardest tenth of the runs and is better in the others fails more."""
    base = np.linspace(1.0, 10.0, 100)
    a = [*(0.95 * base[:90] * np.resize([1.01, 0.99], 90)), *[None] * 10]
    row = only(comparison_frame(make_trials({"mse": {"A": a, "B": base}})))
    assert row.ci_high < 0 and row.verdict == "fails-more"
    assert (row.won, row.lost, row.tied, row.n_pairs) == (90, 10, 0, 90)
    assert (row.failed_only, row.baseline_failed_only) == (10, 0) and row.failed_low > 0
    # Exchanged, the method that never fails is not called worse for the runs that the other one finished.
    assert only(comparison_frame(make_trials({"mse": {"B": base, "A": a}}))).verdict == "inconclusive"


@pytest.mark.parametrize("direction", ["lower", "higher", "zero", "one"])
def test_a_failed_run_is_never_a_tie(direction):
    """B fails in the 2 runs of 100 that are hardest for A, the worst finished ones, and is better elsewhere."""
    words = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        a = np.exp((0.1 if direction == "zero" else 0.6) * rng.normal(size=100) + 2)
        b = 0.97 * a * np.exp(0.03 * rng.normal(size=100))
        b[np.argsort(a)[-2:]] = np.nan
        values = {"A": 1 / a, "B": 1 / b} if direction == "higher" else {"A": a, "B": b}
        words.append(only(comparison_frame(table(values, direction=direction))).verdict)
    assert words == ["inconclusive"] * 10


@pytest.mark.parametrize(
    ("direction", "signed"), [("lower", False), ("higher", False), ("lower", True), ("zero", True)]
)
def test_a_failed_run_counts_as_worse_than_its_partner(direction, signed):
    """By a factor of 10, or twice the largest distance; as the worst finished run where that is worse still."""
    rng = np.random.default_rng(5)
    values = {name: rng.normal(size=30) if signed else np.exp(rng.normal(size=30)) for name in "ABC"}
    values["B"][[3, 7]] = values["A"][[7, 8]] = values["C"][[7, 8]] = np.nan
    trials = table(values, direction=direction)
    pairs = pairs_of(trials, "B", trials.metrics[0])
    counted = pairs.counted(worst_finished(trials, trials.metrics[0]))
    size = [np.abs(column) if direction == "zero" else column for column in values.values()]
    worst = np.nanmin(np.concatenate(size)) if direction == "higher" else np.nanmax(np.concatenate(size))
    step = 2 * np.nanmax(np.abs(size[:2]))
    for own, other, run, found in ((size[1], size[0], 3, counted.a), (size[0], size[1], 8, counted.b)):
        beyond = other[run] + step if signed else other[run] / 10 if direction == "higher" else 10 * other[run]
        assert np.isnan(own[run])
        assert found[run] == pytest.approx((min if direction == "higher" else max)(beyond, worst))
    assert counted.a[7] == counted.b[7] == worst
    assert (counted.scores[[3, 7, 8]] == [-1, 0, 1]).all() and (counted.scores == pairs.scores).all()


def test_a_failed_run_is_worse_than_a_partner_of_zero():
    """Where all values are 0, a factor and the largest distance would leave a tie."""
    for direction, value in [("lower", 0.0), ("higher", 0.0), ("zero", 0.0), ("zero", 2.0), ("lower", -1.0)]:
        values = {"A": np.full(30, value), "B": np.full(30, value)}
        values["B"][4] = np.nan
        trials = table(values, direction=direction)
        counted = pairs_of(trials, "B", trials.metrics[0]).counted(worst_finished(trials, trials.metrics[0]))
        assert (counted.a[4] < counted.b[4]) == (direction == "higher") and counted.a[4] != counted.b[4]


def test_one_failure_that_changes_nothing(make_trials):
    """A single failed run of 200 does not decide against a method that is better by half."""
    base = np.resize([1.0, 1.7, 0.6], 200)
    a = [None, *(0.5 * base * np.exp(0.1 * NORMAL_SCORES))[1:]]
    assert only(comparison_frame(make_trials({"mse": {"A": a, "B": base}}))).verdict == "better"
    both = [None, *base[1:]]
    row = only(comparison_frame(make_trials({"mse": {"A": a, "B": both}})))
    assert (row.verdict, row.tied, row.failed_only) == ("better", 1, 0)


def test_verdict_of_the_primary_metric_only(make_trials):
    """From intervals that hold together; other metrics have intervals one by one and no word."""
    rng = np.random.default_rng(3)
    noise = {name: np.exp(rng.normal(0, 0.1, 60)) for name in "ABCD"}
    trials = make_trials({"mse": noise, "power": noise})
    table, of = comparison_frame(trials), levels(trials)
    assert 0.975 < of.held <= 1 - 0.05 / 3 and of.plain == 0.95
    assert set(table["ci_level"][table["metric"] == "mse"]) == {of.held}
    assert set(table["ci_level"][table["metric"] == "power"]) == {0.95}
    assert (table["verdict"][table["metric"] == "power"] == "").all()
    other = comparison_frame(replace(trials, primary="power"))
    assert (other["verdict"][other["metric"] == "mse"] == "").all() and (other["verdict"] != "").sum() == 3


def test_points_of_a_sweep_are_one_family(make_trials):
    """The same runs at two points: the level rises, though not to that of four methods."""
    rng = np.random.default_rng(4)
    tables = [make_trials({"mse": {n: np.exp(rng.normal(0, 0.1, 80)) for n in "ABC"}}) for _ in range(2)]
    sweep = replace(tables[0], points=tuple(tables))
    assert levels(tables[0]).held < levels(sweep).held <= 1 - 0.05 / 4
    assert levels(replace(tables[0], points=(tables[0], tables[0]))).held == pytest.approx(levels(tables[0]).held)


def test_a_later_look_has_wider_intervals(make_trials):
    """At the second one alpha / 6; the first is as without looks."""
    ratios = np.exp(logs_with_interval(-0.05, -0.012))
    first, second = (compared(make_trials, ratios, look=look, average="geometric") for look in (1, 2))
    assert (first.verdict, second.verdict) == ("better", "better-size-uncertain")
    assert (first.look, second.look) == (1, 2) and second.ci_level == pytest.approx(1 - 0.05 / 6)


def test_runs_that_would_decide(make_trials):
    """By hand: sd 0.10 of the logs and a margin of log 1.01 need (1.960 + 1.282)^2 (0.1 / 0.00995)^2 runs."""
    scores = NORMAL_SCORES / NORMAL_SCORES.std(ddof=1)
    row = compared(make_trials, np.exp(0.004 + 0.1 * scores), average="geometric")
    assert row.verdict == "inconclusive"
    assert row.runs_for_equivalence == pytest.approx(1061, abs=1)
    assert row.runs_for_direction == pytest.approx((1.95996 + 0.84162) ** 2 * 625, abs=2)
    assert compared(make_trials, np.exp(-0.5 + 0.1 * scores)).isna()["runs_for_direction"]


@pytest.mark.parametrize("won", [1, 3, 4, 5])
def test_few_runs_that_are_all_won_need_so_many_as_the_sign_test(make_trials, won):
    """2 / 2^5 exceeds 5 % and 2 / 2^6 does not, whatever the spread of so few runs says."""
    row = compared(make_trials, np.linspace(0.3, 0.8, won))
    assert row.verdict == "inconclusive"
    assert row.runs_for_direction == 6 and row.isna()["runs_for_equivalence"]
    assert compared(make_trials, np.linspace(0.3, 0.8, 6)).verdict == "better"


@pytest.mark.parametrize(("won", "lost", "tied"), [(4, 0, 0), (0, 2, 4), (5, 1, 0), (6, 1, 3), (3, 2, 0), (0, 0, 9)])
def test_runs_that_a_count_needs(won, lost, tied):
    """The first number whose sign test rejects with a chance of 80 %, by brute force over all counts."""

    def power(m):
        rejected = [k for k in range(m + 1) if k > m / 2 and stats.binomtest(k, m).pvalue < 0.05]
        return sum(stats.binom.pmf(k, m, max(won, lost) / (won + lost)) for k in rejected)

    found = runs_for_count(won, lost, tied, 0.95)
    expected = [m for m in range(won + lost + 1, FEW if won + lost else 0) if power(m) >= POWER]
    if not expected:
        assert math.isnan(found)
    else:
        # The score interval may ask for more than the sign test, never for less.
        assert found == expected[0] + round(expected[0] * tied / (won + lost))


def test_no_number_below_that_of_the_pairs_that_a_word_needs(make_trials):
    """Ten equal runs are equivalent from 20 on; three won of five decide by their average from 20 untied runs on."""
    row = compared(make_trials, np.ones(10))
    assert row.isna()["runs_for_direction"] and row.runs_for_equivalence == 20
    row = compared(make_trials, np.array([0.5, 0.5, 0.5, 1.2, 1.2]))
    assert row.verdict == "inconclusive" and row.runs_for_direction == 20


def test_holm_runs_across_methods_of_one_metric(make_trials):
    """Two methods double the smaller p, and a failed run loses its pair."""
    rng = np.random.default_rng(5)
    s = rng.uniform(1, 2, 12)
    a, b = s * np.exp(rng.normal(-0.05, 0.1, 12)), s * np.exp(rng.normal(-0.02, 0.1, 12))
    broken = [*a[:-1], None]
    table = comparison_frame(make_trials({"mse": {"A": broken, "B": b, "S": s}}))
    p = [stats.wilcoxon(np.log(x / y)).pvalue for x, y in ((a[:-1], s[:-1]), (b, s))]
    small, large = min(p), max(p)
    adjusted = {small: min(1, 2 * small), large: min(1, max(2 * small, large))}
    assert table["p_wilcoxon_holm"].tolist() == [f"{adjusted[value]:.3f}" for value in p]
    assert table["n_pairs"].tolist() == [11, 12]


def test_one_run_no_run_and_huge_values(make_trials):
    """No crash, no warning, no verdict."""
    for other in ([4.0], [None]):
        row = only(comparison_frame(make_trials({"mse": {"A": [2.0], "B": other}})))
        assert (row.verdict, row.n_pairs) == ("inconclusive", int(other != [None]))
        assert np.isnan([row.ci_low, row.ci_high]).all()
    assert row.p_wilcoxon_holm == ""
    huge = make_trials({"mse": {"A": [1e300, 1e308, 1.7e308], "B": [1.0, 2.0, 1e-300]}})
    assert only(comparison_frame(huge)).lost == 3
    table = comparison_frame(make_trials({"mse": {"A": [1.0, 2.0]}}))
    assert table.empty and table.columns[0] == "method"


def test_pairs_that_rarely_differ_have_no_interval(make_trials):
    """One pair of fifty differs: a third of such experiments see none, with an interval of width 0."""
    b = np.linspace(1.0, 2.0, 50)
    row = only(comparison_frame(make_trials({"m": {"A": [*b[:-1], 6.0], "B": b}})))
    assert row.change_pct > 0 and np.isnan([row.ci_low, row.ci_high, row.mean_low, row.mean_high]).all()
    row = only(comparison_frame(make_trials({"m": {"A": [*b[:25], *(1.1 * b[25:])], "B": b}})))
    assert row.ci_low < row.change_pct < row.ci_high
    few = only(comparison_frame(make_trials({"m": {"A": [1.1, 2.3, 3.1], "B": [1.0, 2.0, 3.0]}})))
    assert few.ci_low < few.change_pct < few.ci_high


def test_no_number_of_runs_where_the_average_is_rounding(make_trials):
    """An average of 1e-17 would need 1e30 runs, more than an integer holds."""
    noise = np.random.default_rng(8).lognormal(0.0, 0.05, 40)
    noise /= np.exp(np.log(noise).mean())
    base = np.random.default_rng(9).lognormal(0.0, 0.3, 40)
    (row,) = comparison_frame(make_trials({"mse": {"A": base * noise, "B": base}})).to_dict("records")
    assert row["verdict"] == "inconclusive" and abs(row["change_pct"]) < 1e-12
    assert pd.isna(row["runs_for_direction"])
