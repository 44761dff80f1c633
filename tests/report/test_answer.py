"""The answer in words: every case of the design, from rows with given verdicts."""

import math
from types import SimpleNamespace

import pandas as pd
import pytest

from rmpc_bench.analysis.result_rows import ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate, plain
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.claim import Finding
from rmpc_bench.report.answer import MOST_WORDS, answer, ranges
from rmpc_bench.types import MetricInfo

ELEVEN = Estimate(-11.1105, -15.2737, -6.74284)
NONE = Estimate()


def row(method, word, change=NONE, *, n=60, failed=0, superiority=NONE, occurred=None, mean=NONE, oracle=False):
    """Return the row of a method with a verdict."""
    return ResultRow(
        method=method,
        label="",
        is_baseline=method in ("KF", "S-MPC"),
        is_oracle=oracle,
        n=n - failed,
        n_failed=failed,
        mean=mean,
        quantiles=(7.4,) * 5,
        n_occurred=n - failed if occurred is None else occurred,
        worst=1.0,
        change=change,
        superiority=superiority,
        word=word,
        remark="",
        compared={} if method in ("KF", "S-MPC") else {"average": "geometric"},
    )


def trials_of(rows, info, **others):
    return Trials(
        name="tiny",
        methods=tuple(each.method for each in rows),
        labels={},
        metrics=(info,),
        frame=pd.DataFrame({"method": [], "run": [], "status": []}),
        series=pd.DataFrame(),
        baseline=next((each.method for each in rows if each.is_baseline), rows[0].method),
        confidence=0.95,
        relevant=0.01,
        seed=1,
        oracles=frozenset(each.method for each in rows if each.is_oracle),
        **others,
    )


def table(*rows, form="ratio", direction="lower", unit="", name="estimation_mse", may_not_occur=False, **others):
    """Return a table with these rows."""
    info = MetricInfo(name, unit, direction)
    return ResultTable(trials_of(rows, info, **others), info, rows, form, may_not_occur)


def said(*tables, verdicts=(), **others):
    """Return the answer as a terminal shows it; it has at most 45 words and two intervals."""
    text = answer(tables, verdicts, **others)
    assert len(text.split()) <= MOST_WORDS, text
    assert text.count("[") <= 2, text
    assert text.endswith(".") and "  " not in text and text[0].isupper()
    return plain(text)


KF = row("KF", "baseline")


BEST = "lowers the estimation MSE most, by 11 % [7, 15]."
WORSE, EQUAL = Estimate(9, 2, 16), Estimate(0, -0.1, 0.1)


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([row("WKF", "better", ELEVEN)], "WKF is better than KF: its estimation MSE is 11 % [7, 15] lower."),
        ([row("WKF", "worse", WORSE)], "WKF is worse than KF."),
        ([row("WKF", "equivalent", EQUAL)], "WKF is equivalent to KF."),
        (
            [row("R", "better", ELEVEN), row("RS", "better", Estimate(-4.3, -5.5, -3.0))],
            f"R and RS are better than KF. R {BEST}",
        ),
        (
            [
                row(name, word)
                for name, word in zip("ABCE", ("inconclusive", "equivalent", "worse", "worse"), strict=True)
            ]
            + [row("D", "better", ELEVEN)],
            "D is better than KF; C and E are worse than it; B is equivalent to it; A is inconclusive. D " + BEST,
        ),
        (
            [row("WKF", "inconclusive", ELEVEN, n=20), row("Sayed", "inconclusive", n=20)],
            "WKF and Sayed are inconclusive with 20 runs.",
        ),
        (
            [row("A", "better", Estimate(math.nan, math.nan, math.nan)), row("B", "better", ELEVEN)],
            f"A and B are better than KF. B {BEST}",
        ),
    ],
)
def test_few_methods_are_named(rows, text):
    """In the order of the verdicts; a missing number does not make a best."""
    assert said(table(KF, *rows)) == text


def many(**counts):
    rows = [
        row(f"{word[0].upper()}{k}", word.replace("_", " "), ELEVEN) for word, n in counts.items() for k in range(n)
    ]
    best = row("KFdir10000", "better", Estimate(-12, -20, -3))
    return [KF, *rows, best] if counts.get("better") else [KF, *rows]


def test_many_methods_are_counted():
    rows = many(better=10, equivalent=5, worse=7, inconclusive=5)
    text = said(table(*rows, row("oracle", "better", Estimate(-50, -51, -49), oracle=True)))
    assert text == (
        "Of 28 methods, 11 are better than KF, 5 equivalent, 7 worse and 5 inconclusive. "
        "Largest improvement of the estimation MSE: KFdir10000, -12 % [-20, -3]."
    )
    assert said(table(*many(worse=7))) == "Of 7 methods, 7 are worse than KF."
    assert said(table(*many(worse=1, inconclusive=7))) == "Of 8 methods, 1 is worse than KF and 7 inconclusive."
    assert said(table(*many(inconclusive=8))) == "Of 8 methods, 8 are inconclusive."


def test_failures():
    bad = row("Sage-Husa", "fails more", Estimate(37, 30, 44), n=400, failed=33)
    text = said(table(row("KF", "baseline", n=400), row("WKF", "better", ELEVEN, n=400), bad), unfinished=True)
    assert text == (
        "So far WKF is better than KF. WKF lowers the estimation MSE most, by 11 % [7, 15]. "
        "Sage-Husa fails more: 33 of its 400 runs failed, none of KF."
    )
    assert said(table(row("KF", "baseline", n=400), bad)) == (
        "Sage-Husa fails more: 33 of its 400 runs failed, none of KF."
    )
    lost = [row(f"M{k}", "fails more", n=60, failed=9 + k) for k in range(4)]
    assert said(table(KF, *lost[:1])) == "M0 fails more: 9 of its 60 runs failed, none of KF."
    assert said(table(KF, *lost[:2])).count("fails more") == 2
    assert said(table(KF, *lost[:3])) == "M0, M1 and M2 fail more than KF."
    assert said(table(KF, *lost)) == "M0, M1, M2 and 1 other fail more than KF."


def test_a_baseline_without_a_finished_run():
    text = said(table(row("KF", "baseline", n=60, failed=60), row("A", "inconclusive"), row("B", "inconclusive")))
    assert text == "A and B are inconclusive with 60 runs. Every run of KF failed."


PRINTED = [Finding.EQUAL, Finding.CLOSE, Finding.DIFFERENT]


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
        (
            [Finding.NOT_TESTABLE, Finding.NOT_CONFIRMED, Finding.CONFIRMED],
            "Statements of the paper: 1 confirmed, 1 not confirmed, 1 not testable.",
        ),
        ([Finding.CONFIRMED, Finding.NOT_TESTABLE], "The statement of the paper that was tested is confirmed."),
        (
            [Finding.DEPENDS_ON_ASSUMPTIONS] * 2,
            "Both statements of the paper that were tested are dependent on unstated assumptions.",
        ),
        (
            [Finding.DEPENDS_ON_ASSUMPTIONS, Finding.CONFIRMED_SMALLER, *PRINTED],
            "Of 5 statements of the paper, 3 are confirmed.",
        ),
        (
            [Finding.DEPENDS_ON_ASSUMPTIONS, Finding.CONFIRMED_SMALLER, Finding.EQUAL, Finding.EQUAL],
            "Statements of the paper: 1 confirmed with a smaller effect, 1 dependent on unstated assumptions, "
            "2 equal to the printed digits.",
        ),
        ([Finding.NOT_TESTABLE], ""),
    ],
)
def test_claims_come_first(findings, text):
    tables = [table(KF, row("WKF", "better", ELEVEN))]
    rest = "WKF is better than KF: its estimation MSE is 11 % [7, 15] lower."
    verdicts = [claim(each) for each in findings]
    assert said(*tables, verdicts=[*verdicts, claim(Finding.CONFIRMED, of_paper=False)]) == f"{text} {rest}".strip()


def test_claims_of_a_smoke_run_are_not_counted():
    tables = table(KF, row("WKF", "ran"), with_verdicts=False)
    assert said(tables, verdicts=[claim(Finding.CONFIRMED)]).startswith("A smoke run shows")


def test_sizes_in_other_forms():
    higher = table(row("KF", "baseline"), row("A", "better", Estimate(12, 9, 15)), direction="higher", name="gain")
    assert said(higher) == "A is better than KF: its gain is 12.0 % [9.0, 15.0] higher."
    two = table(
        KF,
        row("A", "better", Estimate(12, 9, 15)),
        row("B", "better", Estimate(7, 6, 8)),
        direction="higher",
        name="gain",
    )
    assert said(two).endswith("A raises the gain most, by 12.0 % [9.0, 15.0].")
    factor = table(KF, row("A", "better", Estimate(-99.9, -99.92, -99.88)))
    assert said(factor) == "A is better than KF: its estimation MSE is x0.0010 [0.00080, 0.0012] that of KF."
    factors = table(KF, row("A", "better", Estimate(-90, -92, -88)), row("B", "better", ELEVEN))
    assert said(factors).endswith("A has the lowest estimation MSE, x0.10 [0.080, 0.12] that of KF.")
    signed = table(
        KF,
        row("A", "better", Estimate(-0.02, -0.03, -0.01)),
        form="difference",
        direction="zero",
        unit="rad",
        name="bias",
    )
    assert said(signed) == "A is better than KF: its |bias| is 0.020 rad [0.010, 0.030] lower."
    assert said(table(KF, row("A", "better", Estimate(-5.0)))) == (
        "A is better than KF: its estimation MSE is 5.0 % lower."
    )


def test_an_event():
    rows = [
        row("S-MPC", "baseline", occurred=18),
        row("R-MPC", "better", superiority=Estimate(85, 77, 91)),
        row("RS-MPC", "better", superiority=Estimate(77, 70, 83), occurred=50),
    ]
    event = {"form": "share", "may_not_occur": True, "name": "settling_time"}
    assert said(table(*rows, **event)) == (
        "R-MPC and RS-MPC are better than S-MPC: S-MPC has no settling time in 42 of 60 runs, R-MPC in 0 of 60."
    )
    same = [row("S-MPC", "baseline"), rows[1]]
    assert said(table(*same, **event)) == ("R-MPC is better than S-MPC. R-MPC is better in 85 % [77, 91] of the runs.")


def test_one_method_alone():
    means = {"mean": Estimate(0.117389, 0.112445, 0.122332)}
    only = table(row("KF", "baseline", **means), form="alone", unit="rad^2", name="mse")
    assert said(only) == "The mean MSE is 0.117 \u00b1 0.005 rad^2 for KF (60 runs)."
    assert said(table(row("KF", "baseline", n=60, failed=60), form="alone")) == "Every run failed."
    assert said(table(row("KF", "not computed", n=0), form="alone")) == "No run is finished."


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
    ],
)
def test_ranges(chosen, text):
    assert ranges(POINTS, list(map(bool, chosen))) == text


def test_more_ranges_are_counted():
    assert ranges(["0", "1", "2", "3", "4"], [True, False, True, False, True]) == "at 3 of 5 points"


def sweep(words, points=POINTS, path="x"):
    """Return tables of a sweep from {method: a letter per point}: b, w, e, i, f, or . without a row."""
    words_of = ("better", "worse", "equivalent", "inconclusive", "fails more", "not computed")
    names = dict(zip("bweif.", words_of, strict=True))
    return [
        table(
            KF if any(letters[k] != "." for letters in words.values()) else row("KF", "not computed", n=0),
            *(row(name, names[letters[k]], ELEVEN, n=60 * (letters[k] != ".")) for name, letters in words.items()),
            point={path: point},
            title=f"{path}={point}",
        )
        for k, point in enumerate(points)
    ]


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
    """Its points are in the order of their numbers, which may be per cent."""
    text = said(*sweep({"B": letters}, points))
    assert text == f"Better than KF in estimation MSE: {where}."


def test_words_of_a_mean_a_count_and_runs_that_all_failed():
    """A mean has its sign; one run is no runs; several that fail more do so in the plural."""
    alone = table(row("KF", "", mean=Estimate(-1.05, -1.06, -1.04)), direction="zero", unit="rad", name="bias")
    assert said(alone) == "The mean bias is -1.050 \u00b1 0.010 rad for KF (60 runs)."
    assert said(table(KF, row("A", "inconclusive", n=1))) == "A is inconclusive with 1 run."
    failed = [row("S1", "fails more", failed=6), row("S2", "fails more", failed=6)]
    assert said(table(*many(worse=6), *failed)).startswith("Of 8 methods, 6 are worse than KF and 2 fail more.")
    lost = table(row("KF", "baseline", failed=60), row("A", "inconclusive", failed=60))
    assert said(lost).endswith("Every run failed.")
    one = [table(row("KF", "baseline", mean=Estimate(k, k - 0.1, k + 0.1)), form="alone") for k in (1.0, 2.0)]
    assert "is 1.00 \u00b1 0.10 at the first point, 2.00 \u00b1 0.10 at the last" in answer(one)


def test_a_sweep_of_names_and_points_without_runs():
    text = said(*sweep({"A": "bbbi", "B": "iiib"}, ["low", "mid", "high", "top"]))
    assert text == f"{BETTER} A at 3 of 4 points, B at 1 of 4."
    text = said(*sweep({"A": "bb.."}), unfinished=True)
    assert text == f"So far b{BETTER[1:]} A at 2 of 2 points, 2 not computed."


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
        rows = [
            row(name, word, ELEVEN, n=400, failed=3) for name, word in zip(names, ("better", "worse") * 4, strict=False)
        ]
        said(table(KF, *rows[:n]), verdicts=verdicts, unfinished=True)
        lost = [row(name, "fails more", ELEVEN, n=400, failed=3) for name in [*names][:n]]
        said(table(KF, *lost), verdicts=verdicts, unfinished=True)
        said(table(KF, *rows[:3], *lost[3:]), verdicts=verdicts)
