"""Claims about the points of a sweep: which runs count, and what several interpretations come to."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from rmpc_bench.claims.claim import Claim, Stated
from rmpc_bench.claims.evaluator import EvaluationError, Evaluator
from rmpc_bench.claims.grammar import parse
from rmpc_bench.claims.markdown import claims_markdown
from rmpc_bench.claims.record import claims_table
from rmpc_bench.claims.verdict import judge

LOW, HIGH = [1.0, 1.1, 1.2, 1.1], [3.0, 3.2, 3.1, 3.3]
NEARLY_2 = [2 + 1e-7, 2 - 1e-7, 2 + 2e-7, 2 - 2e-7]
TIE = [1.0, 3.2, 2.9, 1.1]  # of which no run tells whether their mean is below 2
SIZES = {"1": LOW, "2": HIGH, "3": TIE, "4": LOW}
BELOW = "mean(mse[A]) < 2"


@pytest.fixture
def sweep(make_trials):
    """Return a function that makes a sweep over `c` from ``{value: {method: mse}}``, with a series P that is c."""

    def make(points, keys=None, pairs=None):
        tables = []
        for value, columns in points.items():
            series = [("A", "P", "", k, 0, float(value)) for k in range(3)]
            table = make_trials({"mse": columns}, series)
            point = (pairs or {}).get(value, {"c": value})
            tables.append(replace(table, point=point, keys=(keys or {}).get(value, {m: m + value for m in columns})))
        return replace(tables[0], paths=tuple(tables[0].point), points=tuple(tables), point={}, keys={})

    return make


@pytest.fixture
def trials(sweep):
    """Method A at four points, far below, above, about and again below 2; B is 2 everywhere."""
    return sweep({value: {"A": column, "B": NEARLY_2} for value, column in SIZES.items()})


def claim(*check, at=(), pooled=False, stated=None):
    """Return a claim; ``at`` is a list of values of c."""
    points = tuple({"c": value} for value in at)
    return Claim("A is small", "Fig. 8", check, at=points, pooled=pooled, stated=stated)


def test_a_term_is_about_its_point(trials):
    """Of its own one, else of the claim's; numbers may be written in any way."""
    for check, at, left in (
        ("mean(mse[A, c=2]) > 2", (), 3.15),
        ("mean(mse[A, c=2.0]) > 2", (), 3.15),
        ("mean(mse[A, c=20e-1]) > 2", ("1",), 3.15),
        ("mean(mse[A]) > 0", ("2",), 3.15),
        ("mean(mse[A]) > 0", ("1",), 1.1),
    ):
        verdict = judge(claim(check, at=at), trials)
        assert verdict.finding == "confirmed" and verdict.comparisons[0].left == pytest.approx(left)


def test_points_are_paired_by_run(trials):
    """Oracle: scipy's paired t interval; the runs of two points meet the same chance."""
    [number] = judge(claim("mean(mse[A, c=1]) < mean(mse[A, c=2])"), trials).comparisons
    expected = stats.ttest_rel(LOW, HIGH).confidence_interval(0.95)
    assert number.interval == pytest.approx((expected.low, expected.high), rel=1e-9) and number.n == 4


def test_a_path_that_a_term_leaves_open(sweep):
    """The term's own values count more than those of `at`, which fill in the others."""
    values = {"1": ("1", "x"), "2": ("1", "y"), "3": ("2", "x"), "4": ("2", "y")}
    pairs = {key: {"c": c, "d": d} for key, (c, d) in values.items()}
    trials = sweep({key: {"A": [float(key)] * 3} for key in values}, pairs=pairs)
    at = ({"c": "2", "d": "x"},)
    for term, value in (("A", 3), ("A, d=y", 4), ("A, c=1", 1), ("A, c=1, d=y", 2)):
        [number] = judge(Claim("s", "", (f"max(mse[{term}]) > 0",), at=at), trials).comparisons
        assert number.left == value


@pytest.mark.parametrize(
    ("at", "finding"),
    [
        ("1", "confirmed"),
        ("2", "not-confirmed"),
        ("3", "inconclusive"),
        ("14", "confirmed"),
        ("22", "not-confirmed"),
        ("12", "depends-on-assumptions"),
        ("21", "depends-on-assumptions"),
        ("13", "inconclusive"),
        ("23", "not-confirmed"),
        ("33", "inconclusive"),
        ("124", "depends-on-assumptions"),
    ],
)
def test_finding_over_several_interpretations(trials, at, finding):
    """All alike: that finding; it depends where one confirms and another does not; else none confirms."""
    assert judge(claim(BELOW, at=at), trials).finding == finding


def test_interpretations_of_which_a_part_holds(trials):
    """Some in one, none in the other; some in both; all in one."""
    checks = (BELOW, "mean(mse[A]) < mean(mse[B])", "mean(mse[A]) > 9")
    assert judge(claim(*checks, at="1"), trials).finding == "partially-confirmed"
    assert judge(claim(*checks, at="2"), trials).finding == "not-confirmed"
    assert judge(claim(*checks, at="14"), trials).finding == "partially-confirmed"
    assert judge(claim(*checks, at="12"), trials).finding == "not-confirmed"
    assert judge(claim(*checks[:2], "mean(mse[A]) > 0", at="12"), trials).finding == "depends-on-assumptions"


def test_a_statement_that_no_interpretation_confirms(trials):
    """It depends on nothing that is open: the words say that none confirms it, on the page as in claims.md."""
    verdict = judge(claim("mean(mse[A]) > 4", at="123"), trials)
    words = "not confirmed: confirmed under none of 3 interpretations"
    assert (verdict.finding, verdict.words, verdict.joined_words) == ("not-confirmed", words, words)
    text = claims_markdown([verdict], informational=False)
    assert f"- finding: **{words}**\n" in text and "unstated assumptions" not in text
    assert claims_table([verdict])[0]["words"] == words
    open_ones = judge(claim(BELOW, "mean(mse[A]) > 0", at="33"), trials)
    assert open_ones.words == "inconclusive: confirmed under none of 2 interpretations"
    # Where all confirm there is nothing to count.
    assert judge(claim(BELOW, at="14"), trials).words == "confirmed"


def test_interpretations_name_their_points(trials):
    """In the table and in the text; a single one at the end."""
    verdict = judge(claim(BELOW, at="12"), trials)
    assert [(number.at, number.holds) for number in verdict.comparisons] == [("c=1", True), ("c=2", False)]
    [row] = json.loads(json.dumps(claims_table([verdict]), allow_nan=False))
    assert row["at"] == [{"c": "1"}, {"c": "2"}] and [number["at"] for number in row["numbers"]] == ["c=1", "c=2"]
    text = claims_markdown([verdict], informational=False)
    words = "depends on unstated assumptions: confirmed under 1 of 2 interpretations"
    assert f"- finding: **{words}**\n" in text and row["words"] == words
    assert f"- `{BELOW}` at c=1: holds; 1.10 and 2.00" in text and f"- `{BELOW}` at c=2: does not hold; 3.15" in text
    one = judge(claim(BELOW, at="1"), trials)
    assert claims_table([one])[0]["numbers"][0]["at"] is None
    text = claims_markdown([one], informational=False)
    assert f"- `{BELOW}`: holds" in text and "- 4 runs, seed 7, at c=1\n" in text


def test_all_points_together(trials):
    """Oracle: scipy's t interval of the means of four runs, at however many points each of them is seen."""
    verdict = judge(claim(BELOW, "mean(mse[A]) < mean(mse[B])", "share(mse[A] < mse[B]) > 0.5", pooled=True), trials)
    runs = [value for column in SIZES.values() for value in column]
    mean = np.mean(list(SIZES.values()), axis=0) - 2
    expected = stats.t.interval(0.95, 3, loc=mean.mean(), scale=stats.sem(mean))
    for number in verdict.comparisons[:2]:
        assert (number.left, number.n) == (pytest.approx(sum(runs) / 16), 16)
        assert number.interval == pytest.approx(expected) and number.holds is None
    assert verdict.comparisons[2].left == 10 / 16
    assert claims_table([verdict])[0]["at"] == "all"
    assert "all points of the sweep together" in claims_markdown([verdict], informational=False)


def test_the_unit_is_the_run(sweep):
    """Seeing the same runs at two points makes the interval no narrower than seeing them once."""
    rng = np.random.default_rng(3)
    columns = {"A": rng.normal(1.0, 0.5, 20).tolist(), "B": rng.normal(1.3, 0.5, 20).tolist()}
    check = "ratio(mean(mse[A]), mean(mse[B])) < 1"
    twice = judge(claim(check, pooled=True), sweep({"1": columns, "2": columns})).comparisons[0]
    once = judge(claim(check, at="1"), sweep({"1": columns, "2": columns})).comparisons[0]
    assert (twice.n, once.n) == (40, 20)
    assert twice.interval == pytest.approx(once.interval, rel=1e-12)


def test_a_part_of_the_points_together(sweep):
    """A term that names one path of two takes all points on it."""
    values = {"1": ("1", "x"), "2": ("1", "y"), "3": ("2", "x"), "4": ("2", "y")}
    pairs = {key: {"c": c, "d": d} for key, (c, d) in values.items()}
    trials = sweep({key: {"A": [float(key)] * 3} for key in values}, pairs=pairs)
    [number] = judge(claim("max(mse[A, d=x]) < max(mse[A, d=y])", pooled=True), trials).comparisons
    assert (number.left, number.right, number.holds, number.n) == (3, 4, None, 6)


def test_failed_runs_at_points(sweep):
    """Counted at the point of the term, or at all; excluded from means, with their partner."""
    trials = sweep({"1": {"A": [1.0, None, 1.0], "B": [2.0, 2.0, 2.0]}, "2": {"A": [None, 3.0, None], "B": [5.0] * 3}})
    for check, pooled in (
        ("n_failed[A, c=1] == 1", False),
        ("n_failed[A, c=2] == 2", False),
        ("n_failed[A] == 3", True),
        ("n_failed[B] == 0", True),
    ):
        assert judge(claim(check, pooled=pooled), trials).finding == "confirmed"
    [number] = judge(claim("mean(mse[A, c=1]) < mean(mse[B, c=2])"), trials).comparisons
    assert (number.n, number.n_excluded, number.left, number.right) == (2, 1, 1.0, 5.0)
    [number] = judge(claim("mean(mse[A]) < mean(mse[B])", pooled=True), trials).comparisons
    assert (number.n, number.n_excluded, number.left, number.right) == (3, 3, 5 / 3, 3.0)


def test_series_at_points(trials):
    """Each point has its own."""
    for value in SIZES:
        verdict = judge(claim(f"last(P[A, c={value}]) == {value}", f"all(P[A] >= {value})", at=value), trials)
        assert verdict.finding == "confirmed"
    assert judge(claim("last(P[A]) < 1.5", at="12"), trials).finding == "depends-on-assumptions"


def test_the_stated_size_is_that_of_the_first_interpretation(trials):
    """Ours, that is; the others only say whether the statement holds there, too."""
    stated = Stated("mean(mse[A])", 1.1, 0.01, "1.1")
    for at, finding, size in (
        ("14", "confirmed", 1.1),
        ("3", "confirmed", 2.05),  # four runs fit 1.1 as well
        ("21", "confirmed-larger", 3.15),
        ("12", "confirmed", 1.1),
    ):
        verdict = judge(claim("mean(mse[A]) > 0", at=at, stated=stated), trials)
        assert (verdict.finding, verdict.sizes[0].value) == (finding, pytest.approx(size))


def test_a_method_that_does_not_depend_needs_no_point(sweep):
    """Its trials are the same at all points; those of the other could be any."""
    points = {value: {"A": LOW, "B": [float(value)] * 4} for value in ("1", "2")}
    keys = {value: {"A": "same", "B": value} for value in points}
    trials = sweep(points, keys=keys)
    assert judge(claim(BELOW), trials).comparisons[0].n == 4
    verdict = judge(claim("mean(mse[B]) < 9"), trials)
    assert verdict.finding == "inconclusive" and "mse[B] may be at any of 2 points" in verdict.reason


def test_what_is_not_there_is_inconclusive(trials, sweep):
    """A point whose runs are not stored yet, or a method that has none anywhere; the others still show."""
    verdict = judge(claim(BELOW, at="19"), trials)
    assert verdict.finding in ("inconclusive", "depends-on-assumptions")
    assert verdict.reason == f"{BELOW}: there is no point c=9" and len(verdict.comparisons) == 1
    assert "there is no method X" in judge(claim("mean(mse[X]) < 1", at="1"), trials).reason
    part = sweep({"1": {"A": LOW}, "2": {"B": LOW}})
    assert judge(claim(BELOW, at="2"), part).reason == f"{BELOW}: there is no method A"


def test_terms_of_different_numbers_of_runs(trials):
    """Four of one point are not compared with sixteen of all."""
    with pytest.raises(EvaluationError, match="different numbers of runs"):
        Evaluator(trials, parse("mean(mse[A, c=1]) < mean(mse[B])"), pooled=True)


def test_one_run_of_many_points(sweep):
    """Where nothing is random the points are the sample: a share of them."""
    trials = sweep({str(i): {"A": [float(i)], "B": [5.0]} for i in range(1, 11)})
    trials = replace(trials, points=tuple(replace(point, random_besides=()) for point in trials.points))
    verdict = judge(claim("share(mse[A] <= mse[B]) == 50%", "max(mse[A]) == 10", pooled=True), trials)
    assert verdict.finding == "confirmed" and verdict.n_runs == 1
    assert "- 1 run, seed 7" in claims_markdown([verdict], informational=False)


def test_which_interpretations_give_a_finding(trials):
    """Below the finding stands where it is found and where it is not; the point's name is enough where it has one."""
    verdict = judge(claim(BELOW, at=["1", "2", "4"]), trials)
    assert verdict.finding == "depends-on-assumptions"
    assert verdict.interpretations == (("c=1", "confirmed"), ("c=2", "not-confirmed"), ("c=4", "confirmed"))
    lines = claims_markdown([verdict], informational=False).splitlines()
    assert "- confirmed at: c=1; c=4" in lines and "- not confirmed at: c=2" in lines
    assert claims_table([verdict])[0]["interpretations"][1] == {
        "at": "c=2",
        "finding": "not-confirmed",
        "ground": None,
    }
    named = replace(claim(BELOW), at=({"name": "ours", "c": "1"}, {"name": "theirs", "c": "2"}))
    assert [at for at, _ in judge(named, trials).interpretations] == ["ours, c=1", "theirs, c=2"]


def test_a_series_and_a_column_at_points_with_different_runs(sweep):
    """The runs are those of the column, however many there are where the series is."""
    trials = sweep({"1": {"A": LOW[:3]}, "2": {"A": HIGH}})
    number = judge(claim("last(P[A, c=1]) < mean(mse[A, c=2])"), trials).comparisons[0]
    assert (number.left, number.right, number.n) == (1.0, pytest.approx(3.15), 4)
