"""Bias and variance of the error at the end, beside what the estimator believes: numbers by hand."""

from dataclasses import replace

import numpy as np

from rmpc_bench.report.run_tables import ensemble_markdown, ensemble_rows

TWO = {"mse": {"A": [1.0, 2.0], "B": [2.0, 3.0]}}


def moments(method, mean, variance, n):
    """Mean and covariance of e at k = 0, 1; the first sample is another one."""
    entries = [(method, "mean(e)", str(i), [99.0, value], n) for i, value in enumerate(mean)]
    for i, value in enumerate(variance):
        entries += [(method, "cov(e)", f"{i},{j}", [99.0, value if i == j else 0.25], n) for j in range(len(variance))]
    return entries


def believed(method, values):
    """Diagonal P over k."""
    P = np.diag(values)
    return [(method, "P", f"{i},{j}", [99.0, P[i, j]], 0) for i in range(len(P)) for j in range(len(P))]


def test_numbers_of_the_last_sample(make_trials, with_series):
    """The mean square is the trace of the covariance and the square of the bias: 4 + 9 + 1 + 0.25."""
    entries = moments("A", [1.0, -0.5], [4.0, 9.0], 500) + believed("A", [5.0, 6.0])
    trials = with_series(make_trials(TWO), *entries)
    [row] = ensemble_rows(trials)
    assert [*row] == ["error at the end", "bias x - x_hat", "variance", "mean square", "reported covariance", ""]
    assert [*row.values()] == ["A", "1 -0.5", "4 9", "14.25", "5 6", "from 500 runs"]
    page = ensemble_markdown(replace(trials, title="both signs")).splitlines()
    assert page[0] == "## Ensemble of the error at the end: both signs"
    heads, rule, cells = (line.strip("| ").split(" | ") for line in page[2:5])
    assert heads[:5] == [*row][:5] and set(rule) == {"---"} and cells == [*row.values()]


def test_exact_ones_win_and_a_bias_that_is_rounding_is_zero(make_trials, with_series):
    """A bias is compared with the standard deviation, so that a small one of a small error stays."""
    entries = moments("A", [1.0], [4.0], 500) + moments("A", [0.5], [2.0], 0) + moments("B", [0.0], [3.0], 20)
    rows = [[*row.values()] for row in ensemble_rows(with_series(make_trials(TWO), *entries))]
    assert rows == [["A", "0.5", "2", "2.25", "-", "exact"], ["B", "0", "3", "3", "-", "from 20 runs"]]
    entries = moments("A", [1e-17, 1e-5], [1.0, 1.0], 0) + moments("B", [1e-17], [1e-30], 0)
    rows = ensemble_rows(with_series(make_trials(TWO), *entries))
    assert [row["bias x - x_hat"] for row in rows] == ["0 1e-05", "1e-17"]


def test_oracles_are_marked_and_errors_beyond_all_bounds_shown(make_trials, with_series):
    trials = with_series(make_trials(TWO), *moments("A", [0.0], [np.inf], 0), *moments("B", [0.0], [np.nan], 0))
    rows = ensemble_rows(replace(trials, oracles=frozenset({"B"})))
    assert [row["error at the end"] for row in rows] == ["A", "B (oracle)"]
    assert [(row["variance"], row["mean square"]) for row in rows] == [("inf", "inf"), ("nan", "nan")]


def test_nothing_without_moments(make_trials, with_series):
    for trials in (make_trials(TWO), with_series(make_trials(TWO), *believed("A", [1.0]))):
        assert ensemble_rows(trials) == [] and ensemble_markdown(trials) == ""
    [row] = ensemble_rows(with_series(make_trials(TWO), *moments("B", [0.0], [1.0], 0)))
    assert row["error at the end"] == "B"
