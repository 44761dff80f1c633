"""Normalised squares of errors and their chi-square band, against direct computation and simulation."""

import numpy as np
import pytest
from conftest import ROUND
from scipy import stats

from rmpc_bench.analysis.estimation_errors import ErrorMoments, average_of_moments, chi_square_band
from rmpc_bench.metrics.consistency import Nees
from rmpc_bench.numerics.error_size import normalised_squares
from rmpc_bench.types import Record


def covariance(rng, n):
    """A positive definite matrix with very different variances."""
    root = rng.standard_normal((n, n)) * 10.0 ** rng.integers(-4, 4, n)[:, None]
    return root @ root.T


def test_values_are_those_of_a_linear_solver(rng):
    """Oracle: numpy.linalg.solve, one error at a time."""
    for n in (1, 2, 4):
        P = np.array([covariance(rng, n) for _ in range(6)])
        e = np.array([np.linalg.cholesky(P[k]) @ rng.standard_normal(n) for k in range(6)])
        found = normalised_squares(e, P)
        wanted = [e[k] @ np.linalg.solve(P[k], e[k]) for k in range(6)]
        np.testing.assert_allclose(found.values, wanted, rtol=1e-6)
        assert (found.freedom == n).all()


def test_same_numbers_as_the_metric(rng):
    """Oracle: the metric `nees` over the whole run, with a singular P as well."""
    x, x_hat = rng.standard_normal((3, 8, 2)), rng.standard_normal((3, 8, 2))
    x_hat[:, :, 1] = x[:, :, 1]
    P = np.broadcast_to(np.diag([2.0, 0.0]), (8, 2, 2))
    record = replace_record(x, x_hat, P)
    wanted = Nees(to="N").evaluate(record)
    found = normalised_squares(x_hat - x, P)
    np.testing.assert_allclose(found.values.mean(axis=1) / 2, wanted, **ROUND)
    assert (found.freedom == 1).all()


def replace_record(x, x_hat, P):
    """A record of several runs."""
    record = Record.of_run(x=x[0], x_hat=x_hat[0])
    return record._replace(x=x, x_hat=x_hat, P=P, y=x[:, :, :1])


def test_an_error_outside_of_the_range_is_infinite():
    """A coordinate without variance, a direction without variance, and a P that is not finite."""
    P = np.array([np.diag([1.0, 0.0]), [[1.0, 1.0], [1.0, 1.0]], [[np.nan, 0.0], [0.0, 1.0]]])
    found = normalised_squares(np.array([[2.0, 1.0], [1.0, -1.0], [1.0, 1.0]]), P)
    assert list(found.values[:2]) == [np.inf, np.inf] and np.isnan(found.values[2])
    inside = normalised_squares(np.array([[2.0, 0.0], [3.0, 3.0]]), P[:2])
    np.testing.assert_allclose(inside.values, [4.0, 9.0], **ROUND)
    assert list(inside.freedom) == [1, 1]


def test_moments_give_the_average_over_the_runs(rng):
    """Oracle: the mean of the values of the single runs."""
    P = np.array([covariance(rng, 3) for _ in range(5)])
    e = np.einsum("kij,rkj->rki", np.linalg.cholesky(P), rng.standard_normal((40, 5, 3)) + 0.4)
    cov = np.array([np.cov(e[:, k].T) for k in range(5)])
    moments = ErrorMoments(e.mean(axis=0), cov, 40)
    wanted = normalised_squares(e, P).values.mean(axis=0)
    np.testing.assert_allclose(moments.squares(P).values, wanted, rtol=1e-6)


def test_exact_moments_of_a_consistent_filter():
    """Expected e' P^-1 e = n where P is the covariance, and 2 n where it is half of it."""
    cov = np.array([[[2.0, 0.5], [0.5, 1.0]]])
    mean = np.zeros((1, 2))
    np.testing.assert_allclose(average_of_moments(mean, cov, cov).values, [2.0], **ROUND)
    np.testing.assert_allclose(average_of_moments(mean, cov, cov / 2).values, [4.0], **ROUND)
    assert average_of_moments(mean, cov, np.diag([1.0, 0.0])[None]).values[0] == np.inf


@pytest.mark.parametrize(("runs", "n", "level"), [(1, 2, 0.95), (50, 3, 0.95), (10, 1, 0.8)])
def test_band_by_simulation(runs, n, level, rng):
    """Oracle: 40 000 averages of squares of Gaussian vectors; and the quantiles of scipy.stats."""
    low, high = chi_square_band(np.array([runs * n]), level)
    averages = (rng.standard_normal((40000, runs * n)) ** 2).mean(axis=1)
    assert np.mean((averages < low) | (averages > high)) == pytest.approx(1 - level, abs=0.01)
    wanted = stats.chi2.ppf([(1 - level) / 2, (1 + level) / 2], runs * n) / (runs * n)
    np.testing.assert_allclose([low[0], high[0]], wanted, rtol=1e-9)
    assert np.isnan(chi_square_band(np.array([0]), level)).all()
