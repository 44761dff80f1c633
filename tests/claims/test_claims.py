"""Every finding, its intervals and what is written of it."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from rmpc_bench.claims.claim import Claim, Finding, Stated
from rmpc_bench.claims.markdown import claims_markdown
from rmpc_bench.claims.record import claims_table
from rmpc_bench.claims.verdict import judge

INF = math.inf
LARGER = "confirmed-larger"
RNG = np.random.default_rng(11)
BASE = RNG.uniform(1, 2, 60)
NOISE = RNG.normal(0, 0.02, 60)
NOISE -= NOISE.mean()
COLUMNS = {
    "low": BASE - 0.3 + NOISE,
    "tie": BASE + 0.001 + NOISE * 1.001,
    "tie2": BASE - 0.001 - NOISE,
    "high": BASE + 0.3 - NOISE,
    "base": BASE,
}


@pytest.fixture
def trials(make_trials):
    """Methods far below, close to and far above a baseline."""
    return make_trials({"mse": COLUMNS})


def claim(*check, stated=None):
    """Return a claim with recorded finding."""
    return Claim(
        "A is more accurate", "Fig. 7", check, finding=Finding.CONFIRMED, stated=stated, assumptions=("the horizon",)
    )


def mean(method):
    """Return the text of a mean."""
    return f"mean(mse[{method}])"


@pytest.mark.parametrize(
    ("checks", "finding", "holds"),
    [
        ([f"{mean('low')} < {mean('base')} < {mean('high')}"], "confirmed", [True, True]),
        ([f"{mean('base')} > {mean('low')}"], "confirmed", [True]),
        ([f"{mean('low')} > {mean('base')}", f"{mean('base')} >= {mean('high')}"], "not-confirmed", [False, False]),
        ([f"{mean('low')} < {mean('base')}", f"{mean('high')} < {mean('base')}"], "partially-confirmed", [True, False]),
        ([f"{mean('tie')} < {mean('base')}"], "inconclusive", [None]),
        ([f"{mean('tie2')} < {mean('base')}"], "inconclusive", [None]),
        ([f"{mean('low')} < {mean('tie')} < {mean('base')}"], "inconclusive", [True, None]),
        ([f"{mean('tie')} < {mean('base')}", f"{mean('high')} < {mean('base')}"], "not-confirmed", [None, False]),
        ([f"{mean('tie')} == {mean('base')}"], "inconclusive", [None]),
        ([f"{mean('low')} == {mean('base')}"], "not-confirmed", [False]),
        ([f"{mean('tie')} ~ {mean('base')} +- 1%"], "confirmed", [True]),
        ([f"{mean('tie')} ~ {mean('base')} +- 0.0001"], "inconclusive", [None]),
        (["median(mse[low]) < median(mse[base])"], "confirmed", [True]),
        (["median(mse[tie]) < median(mse[base])"], "inconclusive", [None]),
        ([f"{mean('base')} <= {mean('base')}"], "confirmed", [True]),
        ([f"{mean('base')} < {mean('base')}"], "not-confirmed", [False]),
        (["share(mse[low] < mse[base]) >= 90%"], "confirmed", [True]),
        (["90% <= share(mse[low] < mse[base])"], "confirmed", [True]),
        (["share(mse[low] < mse[base]) >= 99%"], "inconclusive", [None]),
        (["share(mse[low] < mse[base]) == 1"], "inconclusive", [None]),
        (["share(mse[high] < mse[base]) == 1"], "not-confirmed", [False]),
        (["share(mse[high] < mse[base]) < 1"], "confirmed", [True]),
        (["max(mse[low]) < 5"], "inconclusive", [None]),
        (["max(mse[low]) > 1"], "confirmed", [True]),
        (["max(mse[low]) < 1"], "not-confirmed", [False]),
        (["min(mse[low]) > 0.1"], "inconclusive", [None]),
        (["quantile(mse[low], 0.99) < 5"], "inconclusive", [None]),
        (["quantile(mse[low], 0.9) < 5"], "confirmed", [True]),
        (["1 - share(mse[low] < mse[base]) < 1%"], "inconclusive", [None]),
        ([f"{mean('low')} < {mean('base')} < {mean('low')}"], "not-confirmed", [True, False]),
        (["share(mse[high] < mse[base]) > 50%"], "not-confirmed", [False]),
        (["ratio(mse[low], mse[base]) < 0.9"], "confirmed", [True]),
        (["1 < ratio(mse[tie], mse[base])"], "inconclusive", [None]),
        (["all(mse[low] < mse[base])"], "inconclusive", [None]),
        (["all(mse[high] < mse[base])"], "not-confirmed", [False]),
        ([], "not-testable", []),
    ],
)
def test_findings(trials, checks, finding, holds):
    """All hold, some, none, or the interval contains 0."""
    verdict = judge(claim(*checks), trials)
    assert (verdict.finding, [number.holds for number in verdict.comparisons]) == (finding, holds)
    assert (verdict.seed, verdict.n_runs, verdict.reason) == (7, 60, "")


def test_paired_intervals_are_scipys(trials):
    """Mean, share and ratio by direct calls."""
    low, base = COLUMNS["low"], COLUMNS["base"]

    def interval(check):
        return judge(claim(check), trials).comparisons[0].interval

    expected = stats.ttest_rel(low, base).confidence_interval(0.95)
    assert interval(f"{mean('low')} < {mean('base')}") == pytest.approx((expected.low, expected.high), rel=1e-9)
    expected = stats.ttest_1samp(low - 5, 0).confidence_interval(0.95)
    assert interval("mean(mse[low]) < 5") == pytest.approx((expected.low, expected.high), rel=1e-9)
    expected = stats.binomtest(60, 60).proportion_ci(0.95, method="wilson")
    assert interval("share(mse[low] < mse[base]) >= 0.5") == pytest.approx((expected.low - 0.5, 0.5))
    assert interval("0.5 <= share(mse[low] < mse[base])") == pytest.approx((-0.5, 0.5 - expected.low))
    expected = np.exp(stats.ttest_1samp(np.log(low / base), 0).confidence_interval(0.95))
    assert interval("ratio(mse[low], mse[base]) < 1") == pytest.approx(tuple(expected - 1), rel=1e-9)
    assert interval("max(mse[low]) < 5") == (low.max() - 5, INF)
    assert interval("n_failed[low] == 0") is None


def test_other_intervals_resample_the_runs(trials):
    """Oracle: scipy's paired bootstrap; two bootstraps of 1000 differ by some per cent of their width."""
    low, base = COLUMNS["low"], COLUMNS["base"]

    def against(check, statistic):
        expected = stats.bootstrap(
            (low, base), statistic, paired=True, vectorized=False, n_resamples=1000, method="percentile", rng=5
        ).confidence_interval
        width = expected.high - expected.low
        found = judge(claim(check), trials).comparisons[0].interval
        assert found == pytest.approx((expected.low, expected.high), abs=0.25 * width)

    against("median(mse[low]) < median(mse[base])", lambda a, b: np.median(a) - np.median(b))
    against("2 * mean(mse[low]) < mean(mse[base])", lambda a, b: 2 * a.mean() - b.mean())
    against("std(mse[low]) < std(mse[base])", lambda a, b: a.std(ddof=1) - b.std(ddof=1))


@pytest.mark.parametrize(
    "check",
    [
        "mean(mse[A]) - mean(mse[B]) < 0",
        "mean(mse[A]) < 1.0 * mean(mse[B])",
        "ratio(mean(mse[A]), mean(mse[B])) < 1",
        "1 - ratio(mse[A], mse[B]) > 0",
        "std(mse[A]) < std(mse[B])",
        "share(mse[A] < mse[B]) < share(mse[B] < mse[A])",
    ],
)
def test_noise_is_inconclusive_however_it_is_written(make_trials, check):
    """Two columns of one law, whose order is chance."""
    rng = np.random.default_rng(8)
    trials = make_trials({"mse": {"A": rng.normal(10, 1, 50), "B": rng.normal(10, 1, 50)}})
    assert judge(claim(check), trials).finding == "inconclusive"


def test_sizes(trials):
    """Size as stated, smaller, larger; a reduction counts by its amount."""
    change = "mean(mse[low]) - mean(mse[base])"
    for value, finding in ((-0.3, "confirmed"), (-0.5, "confirmed-smaller"), (-0.1, "confirmed-larger")):
        verdict = judge(claim("mean(mse[low]) < 10", stated=Stated(change, value, 0.01, "30 %")), trials)
        assert verdict.finding == finding
        assert verdict.sizes[0].value == pytest.approx(-0.3)
    gain = "mean(mse[high]) - mean(mse[base])"
    for value, finding in ((0.5, "confirmed-smaller"), (0.1, "confirmed-larger")):
        assert judge(claim("1 < 2", stated=Stated(gain, value, 0.01, "")), trials).finding == finding
    assert judge(claim("2 < 1", stated=Stated(gain, 9.0, 0.01, "")), trials).finding == "not-confirmed"
    missing = judge(claim("1 < 2", stated=Stated("last(P[low])", 9.0, 0.01, "")), trials)
    assert (missing.finding, "P[low]" in missing.reason) == ("inconclusive", True)


def test_what_cannot_be_evaluated_is_inconclusive_with_a_reason(trials):
    """Absent series, unreadable checks; the other numbers are still shown."""
    verdict = judge(claim("last(P[low]) < 1", "1 <", f"{mean('low')} < {mean('base')}"), trials)
    assert verdict.finding == "inconclusive"
    assert "neither a metric nor a stored series" in verdict.reason
    assert "column 4" in verdict.reason
    assert [number.holds for number in verdict.comparisons] == [True]


ONE_RUN = (
    f"{mean('A')} < {mean('B')}",
    f"{mean('A')} > {mean('B')}",
    "median(mse[A]) < median(mse[B])",
    "share(mse[A] < mse[B]) > 99%",
    "share(mse[A] > mse[B]) > 99%",
    "ratio(mse[A], mse[B]) < 1",
    "quantile(mse[A], 0.9) < 5",
    "max(mse[A]) > 0",
    "all(mse[A] < mse[B])",
    "mse[A] > mse[B]",
    f"[{mean('A')}, 1] < [{mean('B')}, 2]",
)


@pytest.mark.parametrize("check", ONE_RUN)
@pytest.mark.parametrize("failed", [0, 39])
def test_one_run_decides_only_where_nothing_is_random(make_trials, check, failed):
    """Also where all other runs failed; without randomness the two numbers decide."""
    trials = make_trials({"mse": {"A": [1.0] + [None] * failed, "B": [2.0] * (1 + failed)}})
    verdict = judge(claim(check), trials)
    assert (verdict.finding, verdict.comparisons[0].n, verdict.comparisons[0].n_deciding) == ("inconclusive", 1, None)
    fixed = judge(claim(check), replace(trials, random_besides=()))
    assert fixed.finding == ("not-confirmed" if "[A] > mse[B]" in check or check == ONE_RUN[1] else "confirmed")
    assert fixed.comparisons[0].interval is None


def test_a_printed_number_is_not_compared_with_random_runs(make_trials):
    """One run has no digits that a paper could share."""
    trials = make_trials({"mse": {"A": [1.0]}})
    printed = Stated(mean("A"), 1.0, None, "", "1.00")
    assert judge(claim(stated=printed), trials).finding == "inconclusive"
    assert judge(claim(stated=printed), replace(trials, random_besides=())).finding == "equal"


@pytest.mark.parametrize(
    ("of", "computed", "stated", "finding"),
    [
        ("mean(mse[A]) / mean(mse[B])", 0.8, 0.5, "confirmed-smaller"),
        ("mean(mse[A]) / mean(mse[B])", 0.8, 0.9, "confirmed-larger"),
        ("100 * mean(mse[A]) / mean(mse[B])", 0.8, 50, "confirmed-smaller"),
        ("ratio(mse[A], mse[B])", 0.8, 0.5, "confirmed-smaller"),
        ("ratio(mse[A], mse[B])", 1.5, 1.2, "confirmed-larger"),
        ("ratio(mse[A], mse[B])", 1.5, 0.9, "confirmed-smaller"),
        ("1 - ratio(mse[A], mse[B])", 0.8, 0.5, "confirmed-smaller"),
        ("mean(mse[A]) - mean(mse[B])", 0.8, 0.0, "confirmed-larger"),
        ("mean(mse[A]) - mean(mse[B])", 1.3, -0.6, "confirmed-smaller"),
        ("mean(mse[A])", 0.8, 0.5, "confirmed-larger"),
        ("mean(mse[A]) / mean(other[B])", 0.8, 0.5, "confirmed-larger"),
    ],
)
def test_a_size_is_larger_by_its_effect(make_trials, of, computed, stated, finding):
    """By the distance from no effect: the log of a ratio, and from 0 of a difference or a level."""
    near = computed + RNG.normal(0, 1e-4, 40)
    trials = make_trials(
        {"mse": {"A": near, "B": near[::-1] / computed}, "other": {"A": near, "B": near[::-1] / computed}}
    )
    assert judge(claim("mean(mse[A]) > 0", stated=Stated(of, stated, 0.01, "")), trials).finding == finding


@pytest.mark.parametrize(
    ("check", "k", "n", "needed"),
    [
        ("share(mse[A] < 1) > 99%", 40, 40, 381),  # Wilson: n / (n + z^2) > 0.99
        ("quantile(mse[A], 0.99) < 1", 40, 40, 368),  # 0.99^n < 2.5 %
        ("share(mse[A] < 1) > 79.9%", 32, 40, 614656),  # z^2 p (1 - p) / 0.001^2
        ("share(mse[A] < 1) == 1", 40, 40, None),
        ("max(mse[A]) < 1", 40, 40, None),
    ],
)
def test_runs_that_would_decide_follow_from_the_estimate(make_trials, check, k, n, needed):
    """Two significant digits; no number of runs decides about the largest of all."""
    trials = make_trials({"mse": {"A": [0.5] * k + [1.5] * (n - k)}})
    [found] = judge(claim(check), trials).comparisons
    assert found.holds is None
    assert found.n_deciding is None if needed is None else found.n_deciding == pytest.approx(needed, rel=0.04)


def test_a_negative_tolerance_is_no_tolerance(trials):
    """Written or computed."""
    for tolerance in ("-0.1", "(1 - 2)", "-5%", f"({mean('low')} - {mean('high')})"):
        verdict = judge(claim(f"{mean('low')} ~ {mean('base')} +- {tolerance}"), trials)
        assert verdict.finding == "inconclusive" and "is negative" in verdict.reason


def test_what_did_not_occur(make_trials):
    """Infinite columns: no interval of the mean, one of the median, and JSON writes it as a text."""
    trials = make_trials({"t": {"A": [1.0, 2.0, INF, 3.0, 2.0, 1.0, 1.0, 1.5] * 2, "B": [INF] * 16}})
    verdicts = [
        judge(claim(check), trials)
        for check in ("median(t[A]) < median(t[B])", "mean(t[A]) <= mean(t[B])", "max(t[B]) == inf", "-inf < 0")
    ]
    assert [verdict.finding for verdict in verdicts] == ["confirmed", "confirmed", "confirmed", "confirmed"]
    assert verdicts[0].comparisons[0].interval == (-INF, -INF)
    table = claims_table(verdicts)
    assert table[0]["numbers"][0] == {
        "text": "median(t[A]) < median(t[B])",
        "at": None,
        "left": 1.75,
        "right": "inf",
        "holds": True,
        "interval": (None, None),
        "n": 16,
        "n_excluded": 0,
        "k": None,
        "entry": None,
        "change": None,
        "n_deciding": None,
        "exceptions": None,
        "below_margin": None,
    }
    assert table[3]["numbers"][0]["left"] == "-inf"


def test_median_of_few_runs_is_open(make_trials):
    """Five pairs are too few to resample; the ends are open."""
    trials = make_trials({"mse": {"A": [1.0, 2, 3, 4, 5], "B": [2.0, 3, 4, 5, 6]}})
    verdict = judge(claim("median(mse[A]) < median(mse[B])"), trials)
    assert (verdict.finding, verdict.comparisons[0].interval) == ("inconclusive", (-INF, INF))
    assert "interval of the difference [-inf, inf]" in claims_markdown([verdict], informational=False)


def test_what_the_bench_adds_stands_apart(trials):
    """Under its own heading, after what the paper says, wherever it was written."""
    statement = f"{mean('low')} < {mean('base')}"
    ours = Claim("ours", "additional result", (statement,))
    text = claims_markdown([judge(each, trials) for each in (ours, claim(statement), ours)], informational=False)
    headings = [line for line in text.splitlines() if line.startswith("#")]
    assert headings == ["# What the paper says", "## 1. A is more accurate"] + [
        "# Additional results",
        "## 2. ours",
        "## 3. ours",
    ]


def test_table_is_plain_json(trials):
    """Strict JSON, with what was recorded beside what was computed."""
    stated = Stated("ratio(mse[low], mse[base])", 0.9, 0.01, "about 10 %")
    verdict = judge(claim(f"{mean('low')} < {mean('base')}", stated=stated), trials)
    (row,) = json.loads(json.dumps(claims_table([verdict]), allow_nan=False))
    assert (row["recorded"], row["finding"], row["n_runs"], row["seed"]) == ("confirmed", "confirmed-larger", 60, 7)
    [size] = row["sizes"]
    given = {key: size[key] for key in ("of", "stated", "tolerance", "text", "finding")}
    assert given == {"of": stated.of, "stated": 0.9, "tolerance": 0.01, "text": "about 10 %", "finding": LARGER}
    logs = stats.ttest_1samp(np.log(COLUMNS["low"] / BASE), 0).confidence_interval(0.95)
    assert size["computed"] == pytest.approx(stats.gmean(COLUMNS["low"] / BASE), rel=1e-5)
    assert size["interval"] == pytest.approx(np.exp(logs), rel=1e-5)
    assert row["numbers"][0]["holds"] is True


def test_markdown(make_trials):
    """Sentence, source, findings, numbers with interval, n, seed, stated, assumptions; digits the runs support."""
    trials = make_trials({"mse": {"A": [1.0, 1.1, 1.2, None], "B": [2.0, 2.14, 2.19, 3.0]}})
    verdicts = [
        judge(claim("mean(mse[A]) < mean(mse[B])", stated="half"), trials),
        judge(Claim("second\nline", "p. 3", ("last(P[A]) < 1",), stated=Stated("1 / 3", 0.3, 0.1, "a third")), trials),
    ]
    text = claims_markdown(verdicts, informational=False)
    assert text == (
        "# What the paper says\n\n"
        "## 1. A is more accurate\n\n"
        "- source: Fig. 7\n"
        "- finding: **confirmed** (recorded: confirmed)\n"
        "- `mean(mse[A]) < mean(mse[B])`: holds; 1.100 and 2.110, interval of the difference [-1.076, -0.944], n = 3, "
        "1 run excluded (failed or not computed)\n"
        "- 4 runs, seed 7\n"
        "- stated: half\n"
        "- assumptions:\n  - the horizon\n\n"
        "## 2. second line\n\n"
        "- source: p. 3\n"
        "- finding: **inconclusive**\n"
        "- not evaluated: last(P[A]) < 1: P[A] is neither a metric nor a stored series\n"
        "- 4 runs, seed 7\n"
        "- stated: a third; computed: `1 / 3` is 0.3333\n"
    )
    informational = claims_markdown(verdicts, informational=True)
    assert "the configuration was modified or did not run at full size" in informational
    assert not any(word in informational.lower() for word in ("wrong", "refuted", "significant", "score"))


@pytest.mark.parametrize(
    ("check", "finding"),
    [
        ("mean(t[A]) < 2.5", "inconclusive"),  # two runs with the same count
        ("mean(t[A]) / mean(t[B]) < 1", "inconclusive"),
        ("mean(t[A]) < mean(t[B])", "inconclusive"),
        ("mean(t[A] + 0.25) < 2.5", "inconclusive"),  # two runs with the same value
    ],
)
def test_the_same_count_in_few_runs(make_trials, check, finding):
    assert judge(claim(check), make_trials({"t": {"A": [2.0, 2.0], "B": [3.0, 3.0]}})).finding == finding


def test_equality_is_not_proven_by_runs(make_trials):
    """Events that coincide in 20 runs may differ in one of eight; a difference contradicts equality."""
    trials = make_trials({"t": {"A": [1.0, 3.0] * 10, "B": [1.5, 3.6] * 10}})
    assert judge(claim("share(t[A] > 2) == share(t[B] > 2)"), trials).finding == "inconclusive"
    assert judge(claim("mean(t[A]) == mean(t[B])"), trials).finding == "not-confirmed"
    for values in (BASE[:20], [1.0] * 20):
        same = make_trials({"t": {"A": values, "B": values}})
        for sign in ("== mean(t[B])", "<= mean(t[B])", "~ mean(t[B]) +- 1%", "<= 1.1 * mean(t[B])"):
            assert judge(claim(f"mean(t[A]) {sign}"), same).finding == "inconclusive"
        assert judge(claim("median(t[A]) <= median(t[B])"), same).finding == "inconclusive"
        assert judge(claim("ratio(t[A], t[B]) ~ 1 +- 1%"), same).finding == "inconclusive"


def test_shares_that_differ_in_one_direction_only(make_trials):
    """Two of 20 runs are in one event alone: neither order is decided, as resamples without them tie."""
    trials = make_trials({"t": {"A": [3.0] * 8 + [1.0] * 12, "B": [3.0] * 6 + [1.0] * 14}})
    for check in ("share(t[A] > 2) < share(t[B] > 2)", "share(t[B] > 2) <= share(t[A] > 2)"):
        assert judge(claim(check), trials).finding == "inconclusive"
