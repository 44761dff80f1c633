"""Functions of claims against NumPy and hand calculation."""

import math

import numpy as np
import pytest

from rmpc_bench.claims.claim import Claim
from rmpc_bench.claims.evaluator import EvaluationError, Evaluator
from rmpc_bench.claims.grammar import parse, parse_expression
from rmpc_bench.claims.verdict import judge

X = [3.0, 1.0, 4.0, 1.5, 9.0]
Y = [2.0, 2.0, 2.0, 3.0, 1.0]
P = np.array([[[4.0, 1.0], [1.0, 3.0]], [[5.0, 2.0], [2.0, 6.0]], [[8.0, 0.0], [0.0, 9.0]]])


@pytest.fixture
def trials(make_trials):
    """Two methods with a metric, one matrix series, a growing and a constant scalar series."""
    rows = [("A", "P", f"{i},{j}", k, 0, P[k, i, j]) for k in range(3) for i in range(2) for j in range(2)]
    rows += [("A", "v", "", k, 0, 1 + 0.5 * k) for k in range(3)]
    rows += [("A", "c", "", 0, 0, 1.0), ("B", "P", "0", 0, 0, 1.0), ("B", "v", "", 0, 0, 1.0), ("B", "v", "", 1, 0, 1)]
    return make_trials({"mse": {"A": X, "B": Y}}, rows)


def number(text, trials):
    """Evaluate one expression to a float."""
    node = parse_expression(text)
    return Evaluator(trials, node).number(node)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("mean(mse[A])", np.mean(X)),
        ("median(mse[A])", np.median(X)),
        ("std(mse[A])", np.std(X, ddof=1)),
        ("var(mse[A])", np.var(X, ddof=1)),
        ("min(mse[A]) + max(mse[A])", 10),
        ("quantile(mse[A], 30%)", np.quantile(X, 0.3)),
        ("mean(mse[A] / mse[B])", np.mean(np.divide(X, Y))),
        ("ratio(mse[A], mse[B])", math.exp(np.mean(np.log(np.divide(X, Y))))),
        ("ratio(mean(mse[A]), 2)", np.mean(X) / 2),
        ("share(mse[A] < mse[B])", 0.4),
        ("share(1 < mse[A] <= 4)", 0.6),
        ("share(v[A] > 1.2)", 2 / 3),
        ("n_failed[A]", 0),
        ("at(v[A], 2) - last(v[A])", 0),
        ("slope(v[A])", 0.5),
        ("slope(trace(P[A]))", 5),
        ("last(det(P[A]))", 72),
        ("det(last(P[A]))", 72),
        ("max(diag(at(P[A], 1)))", 6),
        ("trace([[1, 2], [3, 4]])", 5),
        ("mean([1, 2, 6])", 3),
        ("det(3) + trace(4)", 7),
        ("min(inf)", math.inf),
    ],
)
def test_functions(trials, text, expected):
    """One number each."""
    assert number(text, trials) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("check", "finding"),
    [
        ("all(diag(P[A]) >= [4, 3])", "confirmed"),
        ("all(diag(P[A]) > [4, 3])", "not-confirmed"),
        ("P[A] <= [[8, 2], [2, 9]]", "confirmed"),
        ("at(P[A], 0) == [[4, 1], [1, 3]]", "confirmed"),
        ("all(v[A] >= c[A])", "confirmed"),
        ("all(P[A] <= 10)", "confirmed"),
        ("all(mse[A] > 0.5 < mse[B])", "inconclusive"),
        ("all(mse[A] < mse[B])", "not-confirmed"),
        ("v[A] ~ [1] + [0.5] +- 50%", "confirmed"),
        ("v[A] ~ 1.5 +- 34%", "confirmed"),
        ("v[A] ~ 1.5 +- [0.5, 0.6]", "confirmed"),
        ("v[A] ~ 1.5 +- [0.4, 0.6]", "not-confirmed"),
        ("v[A] ~ 1.5 +- 0.4", "not-confirmed"),
        ("inf ~ inf +- 1", "confirmed"),
        ("1 ~ inf +- 5%", "not-confirmed"),
    ],
)
def test_entry_by_entry(trials, check, finding):
    """Matrices, series and columns hold when all of their entries do."""
    assert judge(Claim("", "", (check,)), trials).finding == finding


def test_the_entry_that_fails_most_is_shown(trials):
    """Left and right are those of the worst sample."""
    shown = judge(Claim("", "", ("all(diag(P[A]) <= [7, 8.5])",)), trials).comparisons[0]
    assert (shown.left, shown.right, shown.holds, shown.n) == (8, 7, False, 0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("mean(mse[C])", "there is no method C"),
        ("last(Q[A])", "Q[A] is neither a metric nor a stored series"),
        ("mse[A]", "not one number"),
        ("mean(mse[A] + v[A])", "column over runs and a series over k"),
        ("last(diag(P[A]) + [1, 2, 3])", "shapes (2,) and (3,)"),
        ("last(v[A] + v[B])", "3 and 2 samples"),
        ("last(mse[A])", "needs a series over k"),
        ("at(v[A], 3)", "sample from 0 to 2"),
        ("at(v[A], 0.5)", "sample from 0 to 2"),
        ("slope(c[A])", "two samples"),
        ("det([1, 2])", "square"),
        ("quantile(mse[A], 2)", "from 0 to 1"),
        ("ratio(mse[A] - 3, mse[B])", "positive"),
        ("share(1 < 2)", "share needs"),
        ("mean([mse[A], v[A]])", "column over runs and a series over k"),
        ("mean([v[A], last(P[A])])", "entries of a list must have one shape, got () and (2, 2)"),
        ("0 / 0", "division by 0"),
        ("mean(mse[A]) / 0", "division by 0"),
        ("1 / (mean(mse[A]) - mean(mse[A]))", "not one number"),
        ("ratio(last(v[A]), last(v[A]) - 2)", "not one number"),
        ("median(mse[A] / (mse[A] - 3))", "not one number"),
        ("quantile(1 / since(v[A] - 1, 0), 0.1)", "not one number"),
        ("std(3)", "not one number"),
    ],
)
def test_reasons(trials, text, reason):
    """What the stored results cannot answer says so."""
    with pytest.raises(EvaluationError) as caught:
        number(text, trials)
    assert reason in str(caught.value)
    verdict = judge(Claim("", "", (f"{text} < 1",)), trials)
    if text != "mse[A]":
        assert (verdict.finding, bool(verdict.reason)) == ("inconclusive", True)


def test_failed_runs_leave_every_side(make_trials):
    """Means of a comparison use the runs that both methods finished."""
    trials = make_trials({"mse": {"A": [1.0, None, 3.0, 5.0], "B": [2.0, 100.0, None, 7.0]}})
    shown = judge(Claim("", "", ("mean(mse[A]) < mean(mse[B])",)), trials).comparisons[0]
    assert (shown.left, shown.right, shown.n, shown.n_excluded) == (3, 4.5, 2, 2)
    assert number("n_failed[A] + n_failed[B]", trials) == 2
    nothing = make_trials({"mse": {"A": [1.0, None], "B": [None, 1.0]}})
    verdict = judge(Claim("", "", ("mean(mse[A]) < mean(mse[B])",)), nothing)
    assert (verdict.finding, "no run" in verdict.reason) == ("inconclusive", True)


def test_an_empty_chain_of_entries_needs_no_columns(trials):
    """A check of numbers alone is evaluated too."""
    chain = parse("1 < 2")
    left, right, tolerance = Evaluator(trials, chain).sides(chain.links[0])
    assert (left.array, right, tolerance) == (1, 2, 0)
