"""The share of states inside the reported set: solves, chi-square, hand calculation, and what is refused."""

import numpy as np
import pytest
from conftest import EXACT, ROUND, random_psd, within_stat
from metrics.estimate_records import LAYOUT, N, method, plant, trajectories
from metrics.issue_checks import no_issue, only_issue
from scipy import optimize, stats

from rmpc_bench.metrics.sets import Inside
from rmpc_bench.types import Record

NX = 3


def smallest_sum(M, P):
    """Shape around the sum of two ellipsoids with the least trace, by a search over log p."""
    m, c = np.trace(M), np.trace(P)
    found = optimize.minimize_scalar(lambda s: np.exp(-s) * m + np.exp(s) * c, bounds=(-8, 8), method="bounded")
    p = np.exp(found.x)
    return (1 + 1 / p) * M + (1 + p) * P


@pytest.mark.parametrize("per_run", [False, True])
@pytest.mark.parametrize("of", [None, "set", "gaussian", "sum"])
def test_inside_against_plain_loops(of, per_run, rng):
    """Oracle: loops with a linear solve and SciPy's quantile; the sum by a search (no state lies at its edge)."""
    block, quantile = trajectories(rng, 40, per_run=per_run), stats.chi2.ppf(0.5, NX)
    for bounds, samples in (({}, range(0, N)), ({"to": "N"}, range(0, N + 1)), ({"from_": 1.0, "to": 1.5}, (2, 3))):
        values, seen = Inside(of=of, level=0.5, **bounds).evaluate(block), set()
        for i, value in enumerate(values):
            found = 0
            for k in samples:
                P, M = (block.P[i, k], block.M[i, k]) if per_run else (block.P[k], block.M[k])
                S = smallest_sum(M, quantile * P) if of == "sum" else quantile * P if of == "gaussian" else M
                e = block.x_hat[i, k] - block.x[i, k]
                found += e @ np.linalg.solve(S, e) <= 1.0
            np.testing.assert_allclose(value, found / len(samples), **ROUND)
            seen.add(found)
        assert len(seen) > 1


def test_only_the_matrices_of_the_set_are_needed():
    """Oracle: product.md section 4: a covariance is not kept for a metric that does not need it."""
    flags = {of: Inside(of=of) for of in (None, "set", "gaussian", "sum")}
    assert {of: (made.needs_P, made.needs_M) for of, made in flags.items()} == {
        None: (True, True),
        "set": (False, True),
        "gaussian": (True, False),
        "sum": (True, True),
    }
    assert Inside().info(LAYOUT) == ("inside", "", "higher", False, "")
    assert (Inside().window(LAYOUT), Inside(name="mine").name) == ((0, N - 1), "mine")


@pytest.mark.parametrize("level", [0.5, 0.95])
@pytest.mark.parametrize("n", [1, 2, 4])
def test_a_gaussian_error_is_inside_as_often_as_the_level_says(n, level, rng):
    """Oracle: the level; errors drawn from N(0, P) by NumPy."""
    P = random_psd(rng, n)
    e = rng.multivariate_normal(np.zeros(n), P, (4000, 5))
    y = np.zeros((4000, 5, 1))
    block = Record(1.0, -e, y, np.zeros_like(e), y[:, 1:], y[0], np.tile(P, (5, 1, 1)))
    values = Inside(level=level, to="N").evaluate(block)
    assert within_stat(values, level)


def test_an_error_bounded_by_the_set_is_always_inside_the_sum_and_not_the_other_way_round(rng):
    """Oracle: points of E(0, M) plus points of E(0, c P) lie in the sum, whose points need not lie in either."""
    M, P = random_psd(rng, 2), np.diag([0.3, 0.0])
    balls = rng.standard_normal((2, 500, 3, 2))
    balls /= np.linalg.norm(balls, axis=-1, keepdims=True)
    c = stats.chi2.ppf(0.9, 2)
    e = balls[0] @ np.linalg.cholesky(M).T + balls[1] @ np.sqrt(c * P)
    y = np.zeros((500, 3, 1))
    block = Record(1.0, e, y, np.zeros_like(e), y[:, 1:], y[0], np.tile(P, (3, 1, 1)), np.tile(M, (3, 1, 1)))
    shares = {of: Inside(of=of, level=0.9).evaluate(block) for of in ("sum", "set", "gaussian")}
    np.testing.assert_array_equal(shares["sum"], np.ones(500))
    assert 0.0 < shares["set"].mean() < 1.0
    np.testing.assert_array_equal(shares["gaussian"], np.zeros(500))  # it is a segment


def test_the_sum_takes_what_there_is(rng):
    """Oracle: with M alone it is the set, with P alone the ellipsoid, bit for bit; with neither no run has a value."""
    block = trajectories(rng, 40, per_run=False)
    for kept, of in (("M", "set"), ("P", "gaussian")):
        alone = block._replace(**{name: None for name in ("P", "M") if name != kept})
        expected = Inside(of=of).evaluate(block)
        for metric in (Inside(of="sum"), Inside()):
            np.testing.assert_array_equal(metric.evaluate(alone), expected)
    for of in (None, "set", "gaussian", "sum"):
        values = Inside(of=of).evaluate(block._replace(P=None, M=None))
        np.testing.assert_array_equal(values, np.full(40, np.nan))


@pytest.mark.parametrize(
    ("e", "M", "share"),
    [
        ([2.0, 0.0], [[4.0, 0.0], [0.0, 1.0]], 1.0),  # on the edge
        ([2.0 + 1e-12, 0.0], [[4.0, 0.0], [0.0, 1.0]], 1.0),  # but for rounding
        ([2.0 + 1e-6, 0.0], [[4.0, 0.0], [0.0, 1.0]], 0.0),
        ([3.0, 3.0], [[9.0, 9.0], [9.0, 9.0]], 1.0),  # the end of a segment
        ([3.0, 3.1], [[9.0, 9.0], [9.0, 9.0]], 0.0),  # beside it
        ([0.0, 0.0], [[0.0, 0.0], [0.0, 0.0]], 1.0),  # a point
        ([1e-3, 0.0], [[0.0, 0.0], [0.0, 0.0]], 0.0),
        ([1.0, 1.0], [[9.0, 0.0], [0.0, -9.0]], 0.0),  # not a shape
        ([0.1, 0.1], [[1.0, np.nan], [np.nan, 1.0]], np.nan),
    ],
)
def test_inside_of_one_error(e, M, share):
    """Oracle: by hand."""
    x = np.tile(np.asarray(e), (1, 2, 1))
    y = np.zeros((1, 2, 1))
    block = Record(1.0, x, y, np.zeros_like(x), y[:, 1:], y[0], None, np.tile(M, (2, 1, 1)))
    np.testing.assert_allclose(Inside().evaluate(block), [share], **EXACT)


@pytest.mark.parametrize(
    ("of", "lacking", "message", "parameter"),
    [
        (None, "neither", "needs the covariance P or the set M of the estimate, which the estimator of 'neither'", ""),
        (
            "sum",
            "neither",
            "needs the covariance P or the set M of the estimate, which the estimator of 'neither'",
            "of",
        ),
        ("set", "neither", "needs the set M of the estimate, which the estimator of 'KF', 'neither' does not", "of"),
        ("gaussian", "neither", "needs the covariance P of the estimate, which the estimator of 'ESM', 'nei", "of"),
    ],
)
def test_a_method_that_reports_no_matrix_is_refused(of, lacking, message, parameter):
    """Oracle: a Kalman filter has P, a set-membership filter M, a mixed one both; a constant nothing."""
    both = {"KF": {"P": np.eye(1)}, "ESM": {"M": np.eye(1)}, "MIX": {"P": np.eye(1), "M": np.eye(1)}, lacking: {}}
    methods = tuple(method(1, name=name, **matrices) for name, matrices in both.items())
    layout = LAYOUT._replace(plant=plant(1), methods=methods)
    only_issue(Inside(of=of), layout, parameter, message)
    [issue] = Inside(of=of).check(layout)
    able = tuple(each for each in methods if f"'{each.name}'" not in issue.message)
    assert len(able) > 1
    no_issue(Inside(of=of), layout._replace(methods=able))


def test_an_estimate_of_another_length_is_refused():
    """Oracle: x_hat - x needs equal lengths."""
    layout = LAYOUT._replace(plant=plant(5), methods=(method(4, P=np.eye(4), name="S-MPC"),))
    only_issue(Inside(), layout, "", "x_hat of method 'S-MPC' has 4 components and x of the plant 5")
