"""The answer in words: every case of the design, from rows with given verdicts."""

import math
from types import SimpleNamespace

import pytest
from comparison_tables import table as trials_of

from rmpc_bench.analysis.result_rows import ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate, plain
from rmpc_bench.claims.claim import Finding
from rmpc_bench.report.answer import MOST_WORDS, answer, ranges
from rmpc_bench.types import MetricInfo

ELEVEN = Estimate(-11.1105, -15.2737, -6.74284)
NONE = Estimate()


def row(method, word, change=NONE, *, n=60, failed=0, superiority=NONE, occurred=None, mean=NONE, oracle=False):
    """Return the row of a method with a verdict."""
    is_baseline = method in ("KF", "S-MPC")
    counts = is_baseline, oracle, n - failed, failed
    values = mean, (7.4,) * 5, n - failed if occurred is None else occurred, 1.0, change, superiority
    return ResultRow(method, "", *counts, *values, word, "", {} if is_baseline else {"average": "geometric"}, {})


def better(method, *change, **others):
    return row(method, "better", Estimate(*change) if change else ELEVEN, **others)


def table(*rows, form="ratio", direction="lower", unit="", name="estimation_mse", may_not_occur=False, **others):
    keys = {"metric": name, "unit": unit, "direction": direction}
    oracles = frozenset(each.method for each in rows if each.is_oracle)
    trials = trials_of({each.method: [] for each in rows}, oracles=oracles, **keys, **others)
    return ResultTable(trials, MetricInfo(name, unit, direction), rows, form, may_not_occur)


def said(*tables, verdicts=(), **others):
    """Return the answer as a terminal shows it; it has at most 45 words and two intervals."""
    text = answer(tables, verdicts, **others)
    assert len(text.split()) <= MOST_WORDS, text
    assert text.count("[") <= 2, text
    assert text.endswith(".") and "  " not in text and text[0].isupper()
    return plain(text)


KF = row("KF", "baseline")
KF400, SAGE = row("KF", "baseline", n=400), row("Sage-Husa", "fails more", Estimate(37, 30, 44), n=400, failed=33)
LOST = [row(f"M{k}", "fails more", n=60, failed=9 + k) for k in range(4)]
MPC = row("S-MPC", "baseline")
R = row("R-MPC", "better", superiority=Estimate(85, 77, 91))
RS = row("RS-MPC", "better", superiority=Estimate(77, 70, 83), occurred=50)
BEST = "lowers the estimation MSE most, by 11 % [7, 15]."
FAILED = "Sage-Husa fails more: 33 of its 400 runs failed, none of KF."
GAIN, ALONE = {"direction": "higher", "name": "gain"}, {"form": "alone", "unit": "rad^2", "name": "mse"}
BIAS = {"form": "difference", "direction": "zero", "unit": "rad", "name": "bias"}
EVENT = {"form": "share", "may_not_occur": True, "name": "settling_time"}


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([KF, better("WKF")], "WKF is better than KF: its estimation MSE is 11 % [7, 15] lower."),
        ([KF, row("WKF", "worse", Estimate(9, 2, 16))], "WKF is worse than KF."),
        ([KF, row("WKF", "equivalent", Estimate(0, -0.1, 0.1))], "WKF is equivalent to KF."),
        ([KF, better("R"), better("RS", -4.3, -5.5, -3.0)], f"R and RS are better than KF. R {BEST}"),
        (
            [KF, row("A", "inconclusive"), row("B", "equivalent"), row("C", "worse"), row("E", "worse"), better("D")],
            f"D is better than KF; C and E are worse than it; B is equivalent to it; A is inconclusive. D {BEST}",
        ),
        (
            [KF, row("WKF", "inconclusive", ELEVEN, n=20), row("Sayed", "inconclusive", n=20)],
            "WKF and Sayed are inconclusive with 20 runs.",
        ),
        # A missing number does not make a best.
        ([KF, better("A", math.nan, math.nan, math.nan), better("B")], f"A and B are better than KF. B {BEST}"),
        ([KF400, SAGE], FAILED),
        ([KF400, better("WKF", n=400), SAGE], f"WKF is better than KF. WKF {BEST} {FAILED}"),
        ([KF, *LOST[:1]], "M0 fails more: 9 of its 60 runs failed, none of KF."),
        (
            [KF, *LOST[:2]],
            "M0 fails more: 9 of its 60 runs failed, none of KF. M1 fails more: 10 of its 60 runs failed, none of KF.",
        ),
        ([KF, *LOST[:3]], "M0, M1 and M2 fail more than KF."),
        ([KF, *LOST], "M0, M1, M2 and 1 other fail more than KF."),
        (
            [row("KF", "baseline", failed=60), row("A", "inconclusive"), row("B", "inconclusive")],
            "A and B are inconclusive with 60 runs. Every run of KF failed.",
        ),
        ([KF, better("A", 12, 9, 15), GAIN], "A is better than KF: its gain is 12.0 % [9.0, 15.0] higher."),
        (
            [KF, better("A", 12, 9, 15), better("B", 7, 6, 8), GAIN],
            "A and B are better than KF. A raises the gain most, by 12.0 % [9.0, 15.0].",
        ),
        (
            [KF, better("A", -99.9, -99.92, -99.88)],
            "A is better than KF: its estimation MSE is x0.0010 [0.00080, 0.0012] that of KF.",
        ),
        (
            [KF, better("A", -90, -92, -88), better("B")],
            "A and B are better than KF. A has the lowest estimation MSE, x0.10 [0.080, 0.12] that of KF.",
        ),
        (
            [KF, better("A", -0.02, -0.03, -0.01), BIAS],
            "A is better than KF: its |bias| is 0.020 rad [0.010, 0.030] lower.",
        ),
        ([KF, better("A", -5.0)], "A is better than KF: its estimation MSE is 5.0 % lower."),
        (
            [MPC._replace(n_occurred=18), R, RS, EVENT],
            "R-MPC and RS-MPC are better than S-MPC: S-MPC has no settling time in 42 of 60 runs, R-MPC in 0 of 60.",
        ),
        ([MPC, R, EVENT], "R-MPC is better than S-MPC. R-MPC is better in 85 % [77, 91] of the runs."),
        (
            [row("KF", "baseline", mean=Estimate(0.117389, 0.112445, 0.122332)), ALONE],
            "The mean MSE is 0.117 \u00b1 0.005 rad^2 for KF (60 runs).",
        ),
        ([row("KF", "baseline", n=60, failed=60), ALONE], "Every run failed."),
        ([row("KF", "not computed", n=0), ALONE], "No run is finished."),
    ],
)
def test_few_methods_are_named(rows, text):
    """In the order of the verdicts; sizes in the form of the metric, which is the last of the rows unless a ratio."""
    *rows, keys = rows if isinstance(rows[-1], dict) else [*rows, {}]
    assert said(table(*rows, **keys)) == text
    if text.endswith(FAILED):
        assert said(table(*rows), unfinished=True) == f"So far {text}"


@pytest.mark.parametrize(
    ("counts", "text"),
    [
        (
            {"better": 10, "equivalent": 5, "worse": 7, "inconclusive": 5},
            "Of 28 methods, 11 are better than KF, 5 equivalent, 7 worse and 5 inconclusive. "
            "Largest improvement of the estimation MSE: KFdir10000, -12 % [-20, -3].",
        ),
        ({"worse": 7}, "Of 7 methods, 7 are worse than KF."),
        ({"worse": 1, "inconclusive": 7}, "Of 8 methods, 1 is worse than KF and 7 inconclusive."),
        ({"inconclusive": 8}, "Of 8 methods, 8 are inconclusive."),
    ],
)
def test_many_methods_are_counted(counts, text):
    rows = [row(f"{word[0].upper()}{k}", word, ELEVEN) for word, n in counts.items() for k in range(n)]
    best = [better("KFdir10000", -12, -20, -3), better("oracle", -50, -51, -49, oracle=True)]
    assert said(table(KF, *rows, *(best if "better" in counts else ()))) == text


def test_counts_of_few_runs_have_no_size():
    """Counts may decide although the interval contains 0; such a change is no largest improvement."""
    few = [better("A", -7, -25, 1), better("B", -4, -18, 0.6)]
    assert said(table(KF, *few)) == "A and B are better than KF."
    assert said(table(KF, *few, *(row(f"C{k}", "inconclusive") for k in range(6)))) == (
        "Of 8 methods, 2 are better than KF and 6 inconclusive."
    )


def test_no_run_of_any_method_has_a_value():
    never = table(row("KF", "baseline", occurred=0), row("A", "inconclusive", occurred=0), **EVENT)
    some = table(row("KF", "baseline", occurred=1), row("A", "inconclusive", occurred=0), **EVENT)
    assert said(never) == "No run of any method has a settling time."
    assert said(never, never, unfinished=True) == "So far no run of any method has a settling time at any point."
    assert said(some) == "A is inconclusive with 60 runs."
    failed = table(*(row(name, "inconclusive", failed=60) for name in ("KF", "A")), form="share")
    assert said(failed) == "Every run failed."
    lost, whole = row("KF", "baseline", n=60, failed=60), Estimate(100, 94, 100)
    text = said(table(lost, row("A", "better", superiority=whole), form="share"))
    assert text == "A is better than KF. Every run of KF failed."


PRINTED = [Finding.EQUAL, Finding.CLOSE, Finding.DIFFERENT]
MIXED, DEPENDS = [Finding.NOT_TESTABLE, Finding.NOT_CONFIRMED, Finding.CONFIRMED], Finding.DEPENDS_ON_ASSUMPTIONS


def claim(finding, of_paper=True):
    """The finding over all configurations counts, as on the page, not that of this one."""
    of = SimpleNamespace(of_paper=of_paper)
    return SimpleNamespace(finding=Finding.PARTIALLY_CONFIRMED, joined=finding, claim=of)


@pytest.mark.parametrize(
    ("findings", "text"),
    [
        ([Finding.CONFIRMED], "The statement of the paper that was tested is confirmed."),
        ([Finding.CONFIRMED] * 2, "Both statements of the paper that were tested are confirmed."),
        ([Finding.CONFIRMED] * 3, "All 3 statements of the paper that were tested are confirmed."),
        (MIXED, "Statements of the paper: 1 confirmed, 1 not confirmed, 1 not testable."),
        ([Finding.CONFIRMED, Finding.NOT_TESTABLE], "The statement of the paper that was tested is confirmed."),
        ([DEPENDS] * 2, "Both statements of the paper that were tested are dependent on unstated assumptions."),
        ([DEPENDS, Finding.CONFIRMED_SMALLER, *PRINTED], "Of 5 statements of the paper, 3 are confirmed."),
        (
            [DEPENDS, Finding.CONFIRMED_SMALLER, Finding.EQUAL, Finding.EQUAL],
            "Statements of the paper: 1 confirmed with a smaller effect, 1 dependent on unstated assumptions, "
            "2 equal to the printed digits.",
        ),
        ([Finding.NOT_TESTABLE], ""),
    ],
)
def test_claims_come_first(findings, text):
    tables = [table(KF, better("WKF"))]
    rest = "WKF is better than KF: its estimation MSE is 11 % [7, 15] lower."
    verdicts = [claim(each) for each in findings]
    assert said(*tables, verdicts=[*verdicts, claim(Finding.CONFIRMED, of_paper=False)]) == f"{text} {rest}".strip()
    smoke = table(KF, row("WKF", "ran"), with_verdicts=False)
    assert said(smoke, verdicts=verdicts).startswith("A smoke run shows")


POINTS = ["0", "0.1", "0.2", "0.3"]


@pytest.mark.parametrize(
    ("chosen", "text"),
    [
        ((0, 1, 1, 1), "from 0.1"),
        ((1, 1, 0, 0), "up to 0.1"),
        ((0, 1, 0, 0), "at 0.1"),
        ((0, 1, 1, 0), "from 0.1 to 0.2"),
        ((1, 0, 0, 1), "at 0 and at 0.3"),
        ((1, 1, 1, 1), "everywhere"),
        ((1, 0, 0, 0), "at 0"),
        ((0, 0, 0, 1), "at 0.3"),
        ((1, 0, 1, 0, 1), "at 3 of 5 points"),
    ],
)
def test_ranges(chosen, text):
    assert ranges([*POINTS, "0.4"][: len(chosen)], list(map(bool, chosen))) == text


def sweep(words, points=POINTS, path="x"):
    """Return tables of a sweep from {method: a letter per point}: b, w, e, i, f, or . without a row."""
    words_of = ("better", "worse", "equivalent", "inconclusive", "fails more", "not computed")
    names, tables = dict(zip("bweif.", words_of, strict=True)), []
    for k, point in enumerate(points):
        rows = [row(name, names[each[k]], ELEVEN, n=60 * (each[k] != ".")) for name, each in words.items()]
        first = KF if any(each.n for each in rows) else row("KF", "not computed", n=0)
        tables.append(table(first, *rows, point={path: point}, title=f"{path}={point}"))
    return tables


BETTER = "Better than KF in estimation MSE:"
NONE_BETTER = "No method is better than KF in estimation MSE at any point."


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            {"WKF": "ibbb", "H-inf": "ibbb", "fading": "wwbb", "R-KF": "wwwi"},
            f"{BETTER} WKF and H-inf from 0.1; fading from 0.2. Worse: R-KF up to 0.2, fading up to 0.1.",
        ),
        ({"A": "bbbb", "B": "wwww"}, f"{BETTER} A everywhere. Worse: B everywhere."),
        ({"A": "wwii"}, f"{NONE_BETTER} Worse: A up to 0.1."),
        ({"A": "iiii"}, NONE_BETTER),
        ({"A": "fffb"}, f"{BETTER} A at 0.3. Fails more: A up to 0.2."),
    ],
)
def test_a_sweep_of_a_number(words, text):
    assert said(*sweep(words)) == text


@pytest.mark.parametrize(
    ("points", "letters", "where"),
    [
        (["1", "0.1", "0.01", "0.001"], "bbww", "B from 0.1. Worse: B up to 0.01"),
        (["0.3", "0.1", "0.2"], "wbb", "B up to 0.2. Worse: B at 0.3"),
        (["5%", "20%", "10%"], "wbb", "B from 10%. Worse: B at 5%"),
    ],
)
def test_a_sweep_that_is_not_ascending(points, letters, where):
    text = said(*sweep({"B": letters}, points))
    assert text == f"Better than KF in estimation MSE: {where}."


def test_words_of_a_mean_a_count_and_runs_that_all_failed():
    """A mean has its sign; one run is no runs; several that fail more do so in the plural."""
    alone = table(row("KF", "", mean=Estimate(-1.05, -1.06, -1.04)), direction="zero", unit="rad", name="bias")
    assert said(alone) == "The mean bias is -1.050 \u00b1 0.010 rad for KF (60 runs)."
    assert said(table(KF, row("A", "inconclusive", n=1))) == "A is inconclusive with 1 run."
    failed = [row("S1", "fails more", failed=6), row("S2", "fails more", failed=6)]
    worse = [row(f"W{k}", "worse") for k in range(6)]
    assert said(table(KF, *worse, *failed)).startswith("Of 8 methods, 6 are worse than KF and 2 fail more.")
    lost = table(row("KF", "baseline", failed=60), row("A", "inconclusive", failed=60))
    assert said(lost).endswith("Every run failed.")
    one = [table(row("KF", "baseline", mean=Estimate(k, k - 0.1, k + 0.1)), form="alone") for k in (1.0, 2.0)]
    assert "is 1.00 \u00b1 0.10 at the first point, 2.00 \u00b1 0.10 at the last" in answer(one)


def test_a_sweep_of_names_and_points_without_runs():
    text = said(*sweep({"A": "bbbi", "B": "iiib"}, ["low", "mid", "high", "top"]))
    assert text == f"{BETTER} A at 3 of 4 points, B at 1 of 4."
    assert said(*sweep({"A": "bb.."}), unfinished=True) == f"So far b{BETTER[1:]} A at 2 of 2 points, 2 not computed."


@pytest.mark.parametrize("words", [1, 2, 4])
def test_at_most_45_words(words):
    """Thirty methods at twelve points, names of several words, with claims and failures."""
    rng = range(30)
    points = [f"{k / 10:g}" for k in range(12)]
    letters = "bweif"
    names = {f"method{' of a paper' * (words > 2)}{' no' * (words > 1)} {k}": k for k in rng}
    sweeps = sweep({name: [letters[(k * j) % 5] for j in range(12)] for name, k in names.items()}, points)
    verdicts = [claim(finding) for finding in Finding]
    said(*sweeps)
    said(*sweeps, verdicts=verdicts)
    said(*sweeps[:6], verdicts=verdicts, unfinished=True)
    said(sweeps[3], verdicts=verdicts)
    for n in range(1, 8):
        words_of = zip(names, ("better", "worse") * 4, strict=False)
        rows = [row(name, word, ELEVEN, n=400, failed=3) for name, word in words_of]
        said(table(KF, *rows[:n]), verdicts=verdicts, unfinished=True)
        lost = [row(name, "fails more", ELEVEN, n=400, failed=3) for name in [*names][:n]]
        said(table(KF, *lost), verdicts=verdicts, unfinished=True)
        said(table(KF, *rows[:3], *lost[3:]), verdicts=verdicts)
