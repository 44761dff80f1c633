"""Findings by intervals both ways, hedges, equivalence, exact numbers, and findings joined over configurations."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from rmpc_bench.analysis.intervals import fieller, student
from rmpc_bench.claims.claim import Claim, Finding, HoldsFor, Stated, closeness, printed_number
from rmpc_bench.claims.markdown import claims_markdown
from rmpc_bench.claims.record import claims_table
from rmpc_bench.claims.verdict import judge, over_interpretations

RNG = np.random.default_rng(4)
N = 60
BASE = RNG.uniform(1, 2, N)
NOISE = RNG.normal(0, 0.05, N)
NOISE -= NOISE.mean()
SHIFTS = {"base": 0.0, "near": 0.002, "same": -0.002, "off": 0.03, "far": 0.3, "below": -0.3}


@pytest.fixture
def trials(make_trials):
    """Methods whose paired difference from the baseline has a known mean and a standard error of about 0.006."""
    rows = [("base", "P", "", k, 0, 58.2449) for k in range(3)]
    columns = {name: BASE + shift + (shift != 0) * NOISE * (1 + shift / 1e3) for name, shift in SHIFTS.items()}
    return make_trials({"mse": columns}, rows)


def mean(method):
    """Return the text of a mean."""
    return f"mean(mse[{method}])"


def judged(trials, *checks, **keys):
    """Judge a claim of these checks."""
    return judge(Claim("s", keys.pop("source", "Fig. 1"), checks, **keys), trials)


def written(verdict):
    """Return the lines of claims.md."""
    return claims_markdown([verdict], informational=False).splitlines()


@pytest.mark.parametrize(
    ("check", "holds"),
    [
        (f"{mean('same')} < {mean('base')}", None),  # the estimate agrees, the interval contains 0
        (f"{mean('near')} < {mean('base')}", None),  # the estimate disagrees, the interval contains 0
        (f"{mean('below')} < {mean('base')}", True),
        (f"{mean('far')} < {mean('base')}", False),
        (f"{mean('near')} ~ {mean('base')} +- 0.05", True),
        (f"{mean('near')} ~ {mean('base')} +- 0.01", None),  # the estimate lies inside, the interval does not
        (f"{mean('off')} ~ {mean('base')} +- 0.025", None),  # the estimate lies outside, the interval does not
        (f"{mean('far')} ~ {mean('base')} +- 0.05", False),
        (f"{mean('far')} ~ {mean('base')} +- 10%", False),
        (f"{mean('off')} ~ {mean('base')} +- 10%", True),
        ("median(mse[near]) ~ median(mse[base]) +- 50%", True),
        ("median(mse[far]) ~ median(mse[base]) +- 0.01", False),
        ("ratio(mse[near], mse[base]) ~ 1 +- 5%", True),
        ("ratio(mse[near], mse[base]) ~ 1 +- 0.1%", None),
        ("ratio(mse[far], mse[base]) ~ 1 +- 5%", False),
        # the tolerance is what another pair of methods differs by, and as uncertain
        (f"{mean('near')} ~ {mean('base')} +- abs({mean('far')} - {mean('base')})", True),
        (f"{mean('far')} ~ {mean('base')} +- abs({mean('off')} - {mean('base')})", False),
        (f"{mean('base')} == {mean('base')}", True),
        (f"{mean('near')} == {mean('base')}", None),
    ],
)
def test_intervals_decide_both_ways(trials, check, holds):
    """Held or failed only where the whole interval is; an estimate on either side of the border decides nothing."""
    [comparison] = judged(trials, check).comparisons
    assert comparison.holds is holds


def test_equivalence_is_that_of_the_interval(trials):
    """Oracle: scipy's paired interval inside the tolerance, which is also the smallest margin that is printed."""
    low, high = stats.ttest_rel(BASE + 0.002 + NOISE * (1 + 2e-6), BASE).confidence_interval(0.95)
    smallest = max(abs(low), abs(high))
    for margin, holds in ((smallest * 1.001, True), (smallest * 0.999, None)):
        [comparison] = judged(trials, f"{mean('near')} ~ {mean('base')} +- {margin:.12f}").comparisons
        assert comparison.holds is holds
        assert comparison.change == ("margin", 0.0, pytest.approx(smallest), 1.0)


@pytest.mark.parametrize("method", ["near", "off", "far", "below"])
def test_the_smallest_relative_margin_is_the_one_that_decides(trials, method):
    """A tolerance just above it holds, one just below does not."""
    check = f"{mean(method)} ~ {mean('base')} +- %.10f%%"
    [first] = judged(trials, check % 1).comparisons
    assert first.change.kind == "relative margin"
    for factor, holds in ((1.0001, True), (0.9999, None)):
        [comparison] = judged(trials, check % (100 * factor * first.change.high)).comparisons
        assert comparison.holds is holds
    [line] = [line for line in written(judged(trials, check % 1)) if "or more" in line]
    assert f"equivalent within margins of {100 * first.change.high:.3g} % or more" in line


@pytest.mark.parametrize("template", ["mean(mse[below]) < %.12f * mean(mse[base])",
                                      "%.12f * mean(mse[base]) > mean(mse[below])",
                                      "median(mse[below]) < %.12f * median(mse[base])",
                                      "mean(mse[below]) < %.12f", "share(mse[off] < mse[base]) < %.12f"])  # fmt: skip
def test_a_threshold_of_ours_says_where_the_finding_changes(trials, template):
    """Outside the printed range the outcome is held or failed, inside it is inconclusive."""
    [first] = judged(trials, template % 0.99).comparisons
    low, high = first.change.low, first.change.high
    assert first.change.kind == ("factor" if "*" in template else "threshold") and low < high
    for value, holds in ((high * 1.0001, True), (high * 0.9999, None), (low * 1.0001, None), (low * 0.9999, False)):
        assert judged(trials, template % value).comparisons[0].holds is holds
    assert any(f"changes at {first.change.kind}s from" in line for line in written(judged(trials, template % 0.99)))


def test_borders_of_what_can_be_are_no_thresholds(trials):
    """0 of a difference, 1 of a ratio."""
    for check in ("ratio(mse[far], mse[base]) > 1", f"{mean('far')} - {mean('base')} > 0"):
        assert judged(trials, check).comparisons[0].change is None


def test_fieller_interval_and_student_interval_agree():
    """A factor is in the one exactly where the other contains 0."""
    a, b = BASE + NOISE, 2 * BASE
    low, high = fieller(a, b, 0.95)
    for factor, inside in ((low * 0.9999, False), (low * 1.0001, True), (high * 0.9999, True), (high * 1.0001, False)):
        ends = student(a - factor * b, 0.95)
        assert (ends[0] <= 0 <= ends[1]) is inside
    assert fieller(a, NOISE, 0.95) == (-math.inf, math.inf)


def test_undecided_names_the_runs_that_would_decide(make_trials):
    """With so many copies of the runs the interval excludes 0, with three quarters of them it does not."""
    gap = RNG.normal(0.0, 1.0, 40)
    gap += 0.2 - gap.mean()
    flat = np.cumsum(np.full(40, 1e-6))

    def comparison(times):
        columns = {"A": [*np.tile(gap, times)], "B": [*np.tile(flat, times)]}
        return judged(make_trials({"d": columns}), "mean(d[A]) > mean(d[B])").comparisons[0]

    first = comparison(1)
    assert first.holds is None and first.n_deciding > 40
    times = math.ceil(first.n_deciding / 40)
    assert comparison(times + 1).holds is True and comparison(max(1, 3 * times // 4)).holds is None
    text = written(judged(make_trials({"d": {"A": gap, "B": flat}}), "mean(d[A]) > mean(d[B])"))
    assert any(f"about {first.n_deciding:,} runs would decide" in line for line in text)


def test_statements_about_every_run(make_trials):
    """No number of runs proves them; what may be among all runs is bounded (the rule of three)."""
    trials = make_trials({"t": {"A": [1.0] * 200, "B": [2.0] * 200}})
    for check in ("max(t[A]) < 5", "share(t[A] < t[B]) == 1", "all(t[A] < t[B])", "n_failed[A] == 0", "5 > max(t[A])"):
        [comparison] = judged(trials, check).comparisons
        assert comparison.holds is (True if "n_failed" in check else None)
        assert comparison.exceptions == pytest.approx(1 - 0.05 ** (1 / 200)) == pytest.approx(3 / 200, rel=0.01)
    for check in ("max(t[A]) < min(t[B])", "mean(t[A]) < 5", "n_failed[A] > 0"):
        assert judged(trials, check).comparisons[0].exceptions is None
    assert "; at most 1.5 % of all runs are exceptions" in "\n".join(written(judged(trials, "max(t[A]) < 5")))


@pytest.mark.parametrize(
    ("checks", "holds_for", "finding"),
    [
        (("far", "below"), "any", "confirmed"),
        (("far", "off"), "any", "not-confirmed"),
        (("far", "near"), "any", "inconclusive"),
        (("far", "below"), "most", "not-confirmed"),
        (("below", "below", "far"), "most", "confirmed"),
        (("below", "near", "far"), "most", "inconclusive"),
        (("below", "far", "far", "near"), "most", "not-confirmed"),
        (("below", "far"), "all", "partially-confirmed"),
    ],
)
def test_hedges(trials, checks, holds_for, finding):
    """One case is enough for "can", more than half are needed for "usually"."""
    checks = [f"{mean(method)} < {mean('base')}" for method in checks]
    assert judged(trials, *checks, holds_for=HoldsFor(holds_for)).finding == finding


@pytest.mark.parametrize(("holds_for", "n_true", "failing", "level"), [("any", 0, 8, 0.31), ("most", 4, 4, 0.63)])
@pytest.mark.long
def test_cases_share_their_error(make_trials, holds_for, n_true, failing, level):
    """Of eight cases without any effect one "improves" in at most 2.5 % of experiments, not in 18 %."""
    rng = np.random.default_rng(12)
    names = [f"m{i}" for i in range(8)]
    checks = [f"mean(d[{name}]) < 0" for name in names]
    found = []
    shifts = np.where(np.arange(8) < n_true, -9.0, 0.0)
    for _ in range(150):
        columns = dict(zip(names, rng.normal(size=(30, 8)).T + shifts[:, None], strict=True))
        verdict = judged(make_trials({"d": columns}), *checks, holds_for=HoldsFor(holds_for))
        found.append(verdict.finding == "confirmed")
    # Three standard errors of a share of 2.5 % of 150.
    assert np.mean(found) <= 0.025 + 3 * math.sqrt(0.025 * 0.975 / 150)
    assert verdict.level == pytest.approx(0.025 / failing)
    text = "\n".join(written(verdict))
    assert f"- holds for {holds_for}: {n_true} of 8 cases hold" in text
    assert f"each at a one-sided level of {level} %" in text


ANY = HoldsFor.ANY


def test_a_can_gives_its_count(trials):
    """A finding from one case of four says so, and none is a count as well."""
    checks = [f"{mean(method)} < {mean('base')}" for method in ("far", "below", "off", "far")]
    assert judged(trials, *checks, holds_for=ANY).words == "confirmed, in 1 of 4 cases"
    assert judged(trials, checks[0], checks[2], holds_for=ANY).words == "not confirmed, in none of 2 cases"
    assert (
        judged(trials, checks[1], checks[1], checks[0], holds_for=HoldsFor.MOST).words == "confirmed, in 2 of 3 cases"
    )


LITTLE = {
    "base": BASE,
    "little": BASE * (1.0035 + NOISE / 1e3),
    "more": BASE * (1.03 + NOISE / 1e3),
    "edge": BASE * (1.0095 + NOISE / 20),
}
"""Changes by 0.35 %, 3 % and 0.95 %, the last one with an interval that reaches beyond 1 %."""


@pytest.mark.parametrize(
    ("check", "below"),
    [
        ("mean(mse[little]) > mean(mse[base])", "1 %"),
        ("mean(mse[base]) < mean(mse[little])", "1 %"),
        ("median(mse[little]) > median(mse[base])", "1 %"),
        ("mse[little] > mse[base]", ""),  # in every run, which no number of them proves
        ("mean(mse[more]) > mean(mse[base])", ""),
        ("mean(mse[edge]) > mean(mse[base])", ""),  # the estimate is below the margin, its interval is not
        ("mean(mse[little]) < mean(mse[base])", ""),  # does not hold
        ("mean(mse[little]) >= mean(mse[base])", ""),  # states no difference
        ("mean(mse[little]) < 1.5 * mean(mse[base])", ""),  # has a threshold of its own
        ("mean(mse[little]) > median(mse[base])", ""),  # two averages
        ("max(mse[little]) > max(mse[base])", ""),
        ("mean(mse[little]) > 1", ""),
        ("share(mse[little] > mse[base]) > 0.5", ""),
        ("last(P[base]) > 1", ""),
    ],
)
def test_a_direction_below_the_margin_of_relevance(make_trials, check, below):
    """Confirmed by its sign, and of a size that does not matter: the interval of the ratio is inside the margin."""
    verdict = judged(make_trials({"mse": LITTLE}, [("base", "P", "", 0, 0, 2.0)]), check)
    assert verdict.comparisons[0].below_margin == below
    words = f"{verdict.finding.sentence}{', but below the margin of relevance of 1 %' if below else ''}"
    assert verdict.words == words and f"- finding: **{words}**" in written(verdict)
    text = "\n".join(written(verdict))
    assert ("; the difference is below the margin of relevance of 1 %" in text) is bool(below)
    assert claims_table([verdict])[0]["numbers"][0]["below_margin"] == (below or None)


def test_the_margin_of_relevance_is_that_of_the_metric(make_trials):
    """A share of its own, or a number in the unit of a signed metric, for which none is given by default."""
    trials = make_trials(
        {"mse": LITTLE, "bias": {"base": NOISE, "little": NOISE * 1.001 + 0.02, "more": NOISE, "edge": NOISE}}
    )
    own = replace(trials, margins={"mse": 0.002, "bias": 0.05})
    check, signed = "mean(mse[little]) > mean(mse[base])", "mean(bias[little]) > mean(bias[base])"
    assert [judged(trials, each).words for each in (check, signed)] == [
        "confirmed, but below the margin of relevance of 1 %",
        "confirmed",
    ]
    assert [judged(own, each).words for each in (check, signed)] == [
        "confirmed",
        "confirmed, but below the margin of relevance of 0.05",
    ]
    # One difference that matters is enough for the finding; the other one is marked where it stands.
    both = judged(trials, check, "mean(mse[more]) > mean(mse[base])")
    assert both.words == "confirmed" and [each.below_margin for each in both.comparisons] == ["1 %", ""]


def test_the_cases_are_checks_at_all_points(make_trials):
    """Two checks at two points are four cases, and no interpretations."""
    table = make_trials({"d": {"A": np.arange(20.0) + 1, "B": np.arange(20.0) * 0}})
    points = [replace(table, point={"c": str(c)}, keys={"A": f"A{c}", "B": "B"}) for c in (1, 2)]
    trials = replace(table, points=tuple(points), paths=("c",))
    verdict = judged(trials, "mean(d[A]) > 0", "mean(d[A]) > 99", at=({"c": "1"}, {"c": "2"}), holds_for=ANY)
    assert (verdict.finding, verdict.cases, verdict.interpretations) == ("confirmed", (True, False, True, False), ())


@pytest.mark.parametrize(
    ("value", "printed", "finding"),
    [
        (58.2449, "58.24", "equal"),
        (58.29, "58.24", "close"),
        (59.0, "58.24", "different"),
        (5.85, "5.8", "equal"),  # a half is within the rounding of the last digit, whichever way the paper rounds it
        (5.8500001, "5.8", "close"),
        (-0.30001, "-0.30", "equal"),
        (1869.24, "1869.20", "close"),
        (62908.4, "62,908", "equal"),
        (62908.4, "62 908", "equal"),
        (4.12e6, "4.1e6", "equal"),
        (0.004, "0.00", "equal"),
        (0.04, "0.00", "different"),
        (math.inf, "1", "different"),
    ],
)
def test_printed_digits_decide(value, printed, finding):
    """By hand."""
    assert closeness(value, Stated("", float(printed_number(printed)), None, "", printed)).finding == finding


@given(st.decimals(-1000, 1000, allow_nan=False, places=3), st.integers(0, 3))
def test_a_rounded_number_is_equal(value, places):
    """Whatever the number of digits."""
    printed = str(round(value, places))
    assert closeness(float(value), Stated("", 0.0, None, "", printed)).finding == "equal"


@pytest.mark.parametrize("text", ["", "about 3", "1.2.3", "1,23", "58.2 %"])
def test_what_is_no_printed_number(text):
    """Words and signs are refused."""
    with pytest.raises(ValueError, match=r"such as '58\.24'"):
        printed_number(text)


def exact(*printed):
    """Return stated numbers of the constant series."""
    return tuple(Stated("last(P[base])", float(text), None, f"P is {text}", text) for text in printed)


@pytest.mark.parametrize(
    ("printed", "finding"),
    [
        (["58.24"], "equal"),
        (["58.3"], "close"),
        (["60"], "different"),
        (["58.24", "58.3"], "close"),
        (["58.24", "60"], "partially-confirmed"),
        (["50", "60"], "different"),
    ],
)
def test_numbers_without_monte_carlo_error(trials, printed, finding):
    """No check is needed; the relative difference is printed."""
    verdict = judged(trials, stated=exact(*printed))
    assert verdict.finding == finding and Finding(finding).is_confirmed is (finding in ("equal", "close"))
    for size in claims_table([verdict])[0]["sizes"]:
        assert size["relative_difference"] == pytest.approx(58.2449 / float(size["stated"]) - 1, rel=1e-4)


def test_a_statement_with_an_exact_number(trials):
    """What is compared decides whether it holds, the number what is said of the size."""
    check = f"{mean('below')} < {mean('base')}"
    for printed, finding in (("58.2", "confirmed"), ("70", "confirmed-smaller"), ("50", "confirmed-larger")):
        assert judged(trials, check, stated=exact(printed)).finding == finding
    assert judged(trials, f"{mean('far')} < {mean('base')}", stated=exact("58.2")).finding == "not-confirmed"


def test_exact_numbers_are_written_with_their_difference(trials):
    """And the limit of what is called close is an assumption."""
    lines = written(judged(trials, stated=exact("58.24", "58.3")))
    assert "- stated: P is 58.24; computed: `last(P[base])` is 58.24, equal to the digits printed" in lines
    assert "- stated: P is 58.3; computed: `last(P[base])` is 58.24, close by -0.095 %" in lines
    assert "  - Close means within 1 %, a limit of ours." in lines


@pytest.mark.parametrize(
    ("findings", "joined"),
    [
        (["confirmed", "confirmed"], "confirmed"),
        (["confirmed-smaller", "confirmed"], "confirmed-smaller"),
        (["confirmed", "not-confirmed"], "depends-on-assumptions"),
        (["not-confirmed", "depends-on-assumptions"], "depends-on-assumptions"),
        (["not-confirmed", "not-testable"], "not-confirmed"),
        (["confirmed", "inconclusive"], "inconclusive"),
        (["confirmed", "inconclusive", "not-confirmed"], "depends-on-assumptions"),
        (["partially-confirmed", "close"], "depends-on-assumptions"),
        # None confirms, so that nothing depends on what the paper leaves open.
        (["partially-confirmed", "not-confirmed", "partially-confirmed"], "not-confirmed"),
        (["inconclusive", "not-confirmed"], "not-confirmed"),
        (["inconclusive", "different"], "not-confirmed"),
        (["inconclusive", "partially-confirmed"], "inconclusive"),
        (["different", "different"], "different"),
        (["not-testable"], "not-testable"),
    ],
)
def test_findings_over_interpretations(findings, joined):
    """All alike: that one; it depends only where one interpretation confirms and another one does not."""
    assert over_interpretations([Finding(finding) for finding in findings]) == joined


def test_one_statement_has_one_finding(trials):
    """Joined with what another configuration records, and shown as such; the record is compared with the own one."""
    check = f"{mean('far')} < {mean('base')}"
    other = {"interpretations-fig8": Finding.DEPENDS_ON_ASSUMPTIONS}
    verdict = judged(trials, check, name="hu-large", finding=Finding.NOT_CONFIRMED, elsewhere=other)
    assert (verdict.finding, verdict.joined, verdict.differs) == ("not-confirmed", "depends-on-assumptions", False)
    lines = written(verdict)
    assert lines[4:7] == [
        "- source: Fig. 1",
        "- finding: **depends on unstated assumptions**, joined over this configuration and interpretations-fig8 "
        "(depends on unstated assumptions)",
        "- finding here: not confirmed (recorded: not confirmed)",
    ]


def test_suspected_misprints_stand_apart(trials):
    """Behind what the paper says and what this project adds."""
    check = f"{mean('below')} < {mean('base')}"
    verdicts = [
        judged(trials, check, source=source) for source in ("suspected misprint of (28)", "additional result", "p. 1")
    ]
    text = claims_markdown(verdicts, informational=False)
    headings = [line for line in text.splitlines() if line.startswith("# ")]
    assert headings == ["# What the paper says", "# Additional results", "# Suspected misprints"]


def test_grounds_and_quotations_are_written(trials):
    """Beside the interpretations that they belong to."""
    verdict = judged(trials, "1 < 2", quote="as it is", grounds={"ours": "Section 2 says so"})
    lines = written(verdict)
    assert '- quote: "as it is"' in lines and lines.index("  - ours: Section 2 says so") > 0
