"""Moments of the true state, the estimate and the error over the runs, and parts of series."""

from dataclasses import replace

import numpy as np
import pytest
from data_frames import arrays

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.claim import Claim
from rmpc_bench.claims.evaluator import EvaluationError, Evaluator
from rmpc_bench.claims.grammar import parse_expression
from rmpc_bench.claims.verdict import judge

N = 6
MEAN = np.array([[0.5 * k, -1.0 * k] for k in range(N)])
COV = np.array([[[1.0 + k, 0.5], [0.5, 2.0 + 3 * k]] for k in range(N)])
MSE = {"A": [3.0, 1.0, 4.0, 1.5], "B": [2.0, 2.0, 2.0, 3.0]}


def rows(quantity, values, n=0, method="A"):
    """Rows of a series table."""
    return [
        (method, quantity, ",".join(map(str, index)), k, n, float(value[index]))
        for k, value in enumerate(np.asarray(values))
        for index in np.ndindex(value.shape)
    ]


SERIES = [
    *rows("mean(e)", MEAN),
    *rows("mean(e)", MEAN + 100, n=500),  # the exact one counts
    *rows("cov(e)", COV),
    *rows("mean(x_hat)", 3 * MEAN, n=500),
    *rows("cov(x_hat)", -1e-18 * COV, n=500),
    *rows("P", 2 * COV),
    *rows("v", np.arange(N) ** 2.0),
    *rows("c", [7.0]),
]


@pytest.fixture
def trials(make_trials):
    """Exact moments of the error, sampled ones of the estimate, none of the true state, all of method A."""
    return make_trials({"mse": MSE}, SERIES)


def value(text, trials):
    """Evaluate one expression."""
    node = parse_expression(text)
    return Evaluator(trials, node).value(node)


def finding(check, trials):
    """Judge one check."""
    return judge(Claim("", "", (check,)), trials).finding


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("mean(e[A])", MEAN),
        ("mean(x_hat[A])", 3 * MEAN),
        ("cov(e[A])", COV),
        ("var(e[A])", [[1 + k, 2 + 3 * k] for k in range(N)]),
        ("std(e[A])", [[np.sqrt(1 + k), np.sqrt(2 + 3 * k)] for k in range(N)]),
        ("std(x_hat[A])", np.zeros((N, 2))),  # rounding has left a variance of -1e-18
        ("trace(cov(e[A]))", [3 + 4 * k for k in range(N)]),
        ("2 * mean(e[A]) + var(e[A])", [[1 + 2 * k, 2 + k] for k in range(N)]),
    ],
)
def test_moments_are_series_over_k(trials, text, expected):
    """Oracle: the tables above, in closed form."""
    found = value(text, trials)
    assert found.axis == "k"
    np.testing.assert_allclose(found.array, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("at(mean(e[A]), 4)", [2, -4]),
        ("(at(var(e[A]), 5) - at(var(e[A]), 3)) / 2", [1, 3]),
        ("slope(var(e[A]))", [1, 3]),
        ("mean(var(e[A]))", [3.5, 9.5]),  # over k, as of any series
        ("std(mean(x_hat[A]))", np.std(3 * MEAN, axis=0, ddof=1)),
        ("var(v[A])", np.var(np.arange(N) ** 2.0, ddof=1)),
        ("mean(mse[A])", 2.375),
        ("var(mse[A])", np.var(MSE["A"], ddof=1)),
    ],
)
def test_what_is_made_of_them(trials, text, expected):
    """A moment is reduced over k as any series; the same functions of columns and series are what they were."""
    np.testing.assert_allclose(value(text, trials).array, expected, rtol=1e-12)


def test_checks_of_moments(trials):
    """Entry by entry, without an interval, because no run is drawn again."""
    for check, expected in (
        ("all(var(e[A]) <= diag(P[A]))", "confirmed"),
        ("all(var(e[A]) < 0.5 * diag(P[A]))", "not-confirmed"),
        ("at(var(e[A]), 5) > [5, 16]", "confirmed"),
        ("(at(var(e[A]), 5) - at(var(e[A]), 0)) / 5 ~ [1, 3] +- 0.001", "confirmed"),
        ("at(mean(e[A]), 5) ~ [2.5, -5] +- 0.01", "confirmed"),
        ("at(mean(e[A]), 5) ~ [2.5, -5.1] +- 0.01", "not-confirmed"),
    ):
        verdict = judge(Claim("", "", (check,)), trials)
        assert verdict.finding == expected, check
        assert (verdict.comparisons[0].interval, verdict.comparisons[0].n) == (None, 0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("last(e[A])", "of the signal e[A] only moments over the runs are known: mean(e[A]), var, std or cov"),
        ("e[A]", "of the signal e[A]"),
        ("mean(2 * e[A])", "of the signal e[A]"),
        ("mean([e[A]])", "of the signal e[A]"),
        ("share(x_hat[A] < 1)", "of the signal x_hat[A]"),
        ("max(x[A])", "of the signal x[A]"),
        ("mean(x[A])", "mean(x[A]) is not there: ensemble moments need `evaluate: [runs, moments]`"),
        ("last(std(e[B]))", "std(e[B]) is not there: ensemble moments need"),
        ("cov(mse[A])", "cov needs a signal (x, x_hat, e, where no metric has the name), got mse[A]"),
        ("cov(P[A])", "cov needs a signal"),
        ("cov(mean(e[A]))", "cov needs a signal by itself, as cov(e[METHOD])"),
        ("cov([1, 2])", "cov needs a signal by itself"),
        ("mean(e[C])", "there is no method C"),
    ],
)
def test_reasons(trials, text, reason):
    """A signal elsewhere, or one without moments, says so; its verdict is inconclusive."""
    with pytest.raises(EvaluationError) as caught:
        value(text, trials)
    assert reason in str(caught.value)
    assert finding(f"{text} < 1", trials) == "inconclusive"


def test_a_metric_of_the_name_counts(make_trials):
    """Then e[A] is a column over runs, wherever it stands."""
    trials = make_trials({"e": MSE}, SERIES)
    assert float(value("mean(e[A])", trials).array) == 2.375
    assert float(value("max(e[A])", trials).array) == 4
    with pytest.raises(EvaluationError, match="where no metric has the name"):
        value("cov(e[A])", trials)


@pytest.fixture
def sweep(make_trials):
    """Two points, at which the error has the mean c."""
    tables = [
        replace(
            make_trials({"mse": {"A": [1.0, 2.0]}}, rows("mean(e)", [[c], [c]])),
            point={"plant.from": name},
            keys={"A": name},
        )
        for name, c in (("a", 1.0), ("b", 2.0))
    ]
    return replace(tables[0], paths=("plant.from",), points=tuple(tables), point={}, keys={})


def test_moments_at_points(sweep):
    """Named in the term or by the claim; of several points together there are none."""
    for name, c in (("a", 1.0), ("b", 2.0)):
        assert value(f"last(mean(e[A, plant.from={name}]))", sweep).array == [c]
        claim = Claim("", "", (f"all(mean(e[A]) == {c})",), at=({"plant.from": name},))
        assert judge(claim, sweep).finding == "confirmed"
    assert "may be at any of 2 points" in judge(Claim("", "", ("all(mean(e[A]) > 0)",)), sweep).reason
    pooled = judge(Claim("", "", ("all(mean(e[A]) > 0)",), pooled=True), sweep)
    assert pooled.finding == "inconclusive" and "e[A] is a series, of one of 2 points: name one" in pooled.reason


def test_a_series_of_several_points_together_is_none(sweep):
    """The first one would stand for all of them."""
    points = tuple(
        replace(table, over_time=[each._replace(quantity="P") for each in table.over_time]) for table in sweep.points
    )
    verdict = judge(Claim("", "", ("all(P[A] > 0)",), pooled=True), replace(sweep, points=points))
    assert "P[A] is a series, of one of 2 points" in verdict.reason


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("since(v[A], 3)", [9, 16, 25]),
        ("upto(v[A], 2)", [0, 1, 4]),
        ("since(v[A], 0)", [0, 1, 4, 9, 16, 25]),
        ("upto(since(v[A], 2), 4)", [4, 9, 16]),  # sample 4 of the series, not of what is left
        ("since(upto(v[A], 4), 2)", [4, 9, 16]),
        ("since(since(v[A], 2), 4)", [16, 25]),
        ("since(v[A], 4) + since(var(e[A]), 4)", [[21, 30], [31, 42]]),
        ("since(v[A], 4) - c[A]", [9, 18]),  # which is the same at all k
        ("2 * since(abs(v[A]), 4)", [32, 50]),
        ("since(c[A], 0) + v[A]", [7, 8, 11, 16, 23, 32]),
        ("trace(since(cov(e[A]), 4))", [19, 23]),
    ],
)
def test_parts_of_series(trials, text, expected):
    """Oracle: squares, by hand."""
    found = value(text, trials)
    assert found.axis == "k"
    np.testing.assert_array_equal(found.array, expected)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("at(since(v[A], 3), 4)", 16),
        ("last(upto(v[A], 3))", 9),
        ("max(upto(v[A], 2))", 4),
        ("mean(since(v[A], 4))", 20.5),
        ("slope(since(v[A], 4))", 9),
        ("share(since(v[A], 3) > 10)", 2 / 3),
        ("mean(det(since(P[A], 1)))", np.linalg.det(2 * COV[1:]).mean()),
        ("mean(trace(since(P[A], 1)))", (2 * (3 + 4 * np.arange(1, N))).mean()),
        ("max(det(upto(P[A], 2)))", 4 * (3 * 8 - 0.25)),
        ("mean(entry(var(e[A]), 1))", (2 + 3 * np.arange(N)).mean()),
        ("mean(entry(since(std(e[A]), 2), 0))", np.sqrt(1 + np.arange(2, N)).mean()),
        ("share(0 < since(v[A], 3) < since(trace(cov(e[A])), 3))", 2 / 3),
    ],
)
def test_numbers_of_parts(trials, text, expected):
    """As of any series; samples keep their number."""
    assert float(value(text, trials).array) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("since(v[A], 6)", "since needs a sample from 0 to 5"),
        ("upto(v[A], 1.5)", "upto needs a sample from 0 to 5"),
        ("upto(v[A], -1)", "upto needs a sample from 0 to 5"),
        ("since(v[A], inf)", "since needs a sample from 0 to 5"),
        ("since(v[A], 0/inf - 1)", "since needs a sample from 0 to 5"),
        ("since(v[A], [1, 2])", "since needs a sample from 0 to 5"),
        ("at(since(v[A], 3), 2)", "at needs a sample from 3 to 5"),
        ("since(mse[A], 0)", "since needs a series over k"),
        ("upto(3, 0)", "upto needs a series over k"),
        ("since(v[A], 3) + v[A]", "series of 3 and 6 samples (k = 3 to 5 and 0 to 5)"),
        ("since(v[A], 3) + upto(v[A], 2)", "series of 3 and 3 samples (k = 3 to 5 and 0 to 2)"),
        ("upto(v[A], 0) + v[A]", "series of 1 and 6 samples"),  # the first sample does not stand for all
        ("share(since(v[A], 3) > 1 < upto(v[A], 2))", "series of 3 and 3 samples"),
        ("since(v[A], 3) + mse[A]", "column over runs and a series over k"),
    ],
)
def test_parts_that_are_none(trials, text, reason):
    """Beyond the ends, of what has no samples, or of other samples."""
    with pytest.raises(EvaluationError) as caught:
        value(text, trials)
    assert reason in str(caught.value)


def test_series_are_read_once(trials, monkeypatch):
    """Not in each of the 1000 resamples of an interval: the table may have 100 000 rows."""
    calls, read = [], Trials.matrix_series
    monkeypatch.setattr(Trials, "matrix_series", lambda *given: calls.append(given[1:]) or read(*given))
    many = replace(trials, columns=arrays(trials.frame.loc[trials.frame.index.repeat(5)].assign(run=[*range(20)] * 2)))
    check = "2 * mean(mse[A]) < last(trace(P[A])) + last(trace(P[A]))"
    [number] = judge(Claim("", "", (check,)), many).comparisons
    assert number.interval is not None and np.isfinite(number.interval).all()
    assert calls == [("P", "A")]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("entry(mean(e[A]), 1)", MEAN[:, 1]),
        ("entry(last(mean(e[A])), 0)", MEAN[-1, 0]),
        ("entry([4, 5, 6], 2)", 6.0),
        ("entry([mse[A], mse[B]], 1)", MSE["B"]),
        ("entry(entry([[1, 2], [3, 4]], 0), 1)", 2.0),
        ("entry(entry(cov(e[A]), 1), 0)", COV[:, 1, 0]),
    ],
)
def test_one_entry_of_a_vector_or_matrix(trials, text, expected):
    """Oracle: NumPy's indexing."""
    np.testing.assert_array_equal(value(text, trials).array, expected)


@pytest.mark.parametrize("text", ["entry(mean(e[A]), 2)", "entry(cov(e[A]), 2)", "entry(3, 0)", "entry([1, 2], 0.5)"])
def test_an_entry_that_is_not_there(trials, text):
    """The message says how places count."""
    with pytest.raises(EvaluationError, match="counts from 0"):
        value(text, trials)


@pytest.mark.parametrize("text", ["at(c[A], 3)", "mean(since(c[A], 4))", "mean(upto(c[A], 2))", "last(c[A])"])
def test_what_does_not_change_is_there_at_every_k(trials, text):
    """Oracle: by hand; such a series is stored once."""
    assert value(text, trials).array == 7.0


@pytest.mark.parametrize(("largest", "bounded"), [("max(v[A])", True), ("max(mse[A])", False)])
def test_an_extreme_of_a_series_is_a_number_an_extreme_of_runs_is_unbounded(trials, largest, bounded):
    """Oracle: a mean over runs against a number has an interval; no run shows the largest of all runs."""
    (number,) = judge(Claim("", "", (f"mean(mse[A]) < {largest}",)), trials).comparisons
    assert np.isfinite(number.interval).all() == bounded
