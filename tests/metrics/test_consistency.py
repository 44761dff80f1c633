"""The normalised estimation error against plain loops, closed forms and consistent filters."""

import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd, within_stat
from metrics.estimate_records import LAYOUT, NX, trajectories

from rmpc_bench.config_file import factories
from rmpc_bench.metrics.consistency import Nees
from rmpc_bench.metrics.estimation import EstimationMse
from rmpc_bench.metrics.tracking import Mse
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import Record


@pytest.mark.parametrize("per_run", [False, True])
def test_nees_against_plain_loops(per_run, rng):
    """Oracle: loops over runs and samples with a linear solve (condition 10: 1e-12 is far from its rounding)."""
    block = trajectories(rng, per_run=per_run)
    for bounds, samples in (({}, range(0, 6)), ({"to": "N"}, range(0, 7)), ({"from_": 1.0, "to": 1.5}, range(2, 4))):
        for i, value in enumerate(Nees(**bounds).evaluate(block)):
            total = 0.0
            for k in samples:
                e = block.x_hat[i, k] - block.x[i, k]
                total += e @ np.linalg.solve(block.P[i, k] if per_run else block.P[k], e) / NX
            np.testing.assert_allclose(value, total / len(samples), **ROUND)


def test_nees_has_no_unit_and_needs_P():
    """Oracle: product.md section 7; no other metric needs it."""
    metric = Nees()
    assert metric.info(LAYOUT) == ("nees", "", "one", False, "")
    others = [Mse(), Mse(of="estimate"), EstimationMse()]
    assert metric.needs_P and not any(other.needs_P for other in others)


def filtered(model, x0, P0, rng, runs, n_steps):
    """Runs of a model and the Kalman filter designed for it, step by step."""
    estimator = factories.estimator("kalman", model, n_steps=n_steps, x0=x0, P0=P0)
    x = rng.multivariate_normal(x0, P0, runs, method="svd")
    state, xs, x_hats = estimator.init(runs), [], []
    for k in range(n_steps + 1):
        v = rng.multivariate_normal(np.zeros(len(model.C)), model.R_v, runs)
        state, estimate = estimator.correct(k, state, x @ model.C.T + v)
        xs.append(x)
        x_hats.append(estimate.x_hat)
        u = rng.standard_normal((runs, model.B.shape[1]))
        state = estimator.predict(k, state, u)
        w = rng.multivariate_normal(np.zeros(model.nx), model.Q_w, runs, method="svd")
        x = x @ model.A.T + u @ model.B.T + w
    y = np.zeros((runs, n_steps + 1, 1))
    x, x_hat = np.stack(xs, axis=1), np.stack(x_hats, axis=1)
    return Record(1.0, x, y, x_hat, np.zeros((runs, n_steps, 1)), y[0], estimator.P)


def test_a_scalar_filter_that_is_consistent_has_nees_one(scalar_model, rng):
    """Oracle: its error over its own deviation is standard normal; twice the covariance gives half."""
    block = filtered(scalar_model, np.zeros(1), np.eye(1), rng, 2000, 30)
    values = Nees().evaluate(block)
    assert within_stat(values, 1.0)
    doubled = Nees().evaluate(block._replace(P=2.0 * block.P))
    np.testing.assert_allclose(doubled, values / 2.0, **ROUND)


def test_a_filter_of_three_states_that_is_consistent_has_nees_one(rng):
    """Oracle: the mean of chi-square with three degrees of freedom is 3."""
    model = random_model(rng)
    block = filtered(model, np.ones(3), 4.0 * np.eye(3), rng, 2000, 20)
    assert within_stat(Nees().evaluate(block), 1.0)


def test_nees_of_a_singular_consistent_filter_is_its_rank_over_nx(rng):
    """Oracle: a plane that holds the first state and the noise and that A maps into itself; the error stays in it."""
    T = np.array([[1.0, 0.0], [0.3, 1.0], [0.7, -2.0]])  # columns span the plane
    onto = T @ np.linalg.pinv(T)
    A = T @ np.array([[0.9, 0.2], [-0.2, 0.8]]) @ np.linalg.pinv(T) + 0.5 * (np.eye(3) - onto)
    d = T @ np.array([[1.0], [2.0]])
    model = LinearModel(A, np.zeros((3, 1)), [[1.0, 0.0, 1.0]], 0.3 * d @ d.T, [[1.0]])
    block = filtered(model, np.zeros(3), T @ T.T, rng, 2000, 20)
    values = Nees().evaluate(block)
    assert np.isfinite(values).all()
    assert within_stat(values, 2.0 / 3.0)


def one_sample(e, P, x=None):
    """NEES of one run with one error at both samples."""
    x = np.zeros(len(e)) if x is None else np.asarray(x, dtype=float)
    x = np.tile(x, (1, 2, 1))
    y = np.zeros((1, 2, 1))
    P = np.tile(np.asarray(P, dtype=float), (2, 1, 1))
    block = Record(1.0, x, y, x + np.asarray(e, dtype=float), np.zeros((1, 1, 1)), y[0], P)
    return Nees().evaluate(block)[0]


@pytest.mark.parametrize(
    ("e", "P", "value"),
    [
        ([1.0, 2.0], [[4.0, 0.0], [0.0, 1.0]], (0.25 + 4.0) / 2),
        ([3.0, 3.0], [[9.0, 9.0], [9.0, 9.0]], 1.0 / 2),  # along the only direction
        ([3.0, 3.1], [[9.0, 9.0], [9.0, 9.0]], np.inf),  # beside it
        ([3.0, 3.0 + 1e-12], [[9.0, 9.0], [9.0, 9.0]], 1.0 / 2),  # but for rounding
        ([2.0, 0.0], [[4.0, 0.0], [0.0, 0.0]], 1.0 / 2),
        ([2.0, 1e-3], [[4.0, 0.0], [0.0, 0.0]], np.inf),
        ([0.0, 0.0], [[0.0, 0.0], [0.0, 0.0]], 0.0),
        ([0.0, 1.0], [[0.0, 0.0], [0.0, 0.0]], np.inf),
        ([1e-6, 1e6], [[1e-12, 0.0], [0.0, 1e12]], 1.0),  # no coordinate is small beside another one
        ([1.0, 1.0], [[1.0, 0.0], [0.0, -1.0]], np.inf),  # not a covariance
        ([1.0, 1.0], [[1.0, 0.0], [0.0, np.nan]], np.nan),
        ([1.0, 1.0], [[1.0, np.nan], [np.nan, 0.0]], np.nan),
        ([1.0, np.nan], [[1.0, 0.0], [0.0, 0.0]], np.nan),
    ],
)
def test_nees_of_one_error(e, P, value):
    """Oracle: by hand."""
    np.testing.assert_allclose(one_sample(e, P), value, **ROUND)


def test_rounding_of_a_certain_coordinate_is_no_error():
    """Oracle: 1e-10 beside 1e6 is rounding of doubles, beside 1e-3 it is not."""
    P = [[1.0, 0.0], [0.0, 0.0]]
    assert one_sample([1.0, 1e-10], P, x=[0.0, 1e6]) == pytest.approx(0.5, rel=1e-12)
    assert one_sample([1.0, 1e-10], P, x=[0.0, 1e-3]) == np.inf


def test_units_of_the_coordinates_do_not_matter(rng):
    """Oracle: x -> D x leaves the number as it is, singular covariances included."""
    for rank in (3, 2, 1):
        P = random_psd(rng, 3, rank=rank)
        e = P @ rng.standard_normal(3)
        D = np.diag([1e-7, 1.0, 1e7])
        value = one_sample(e, P)
        np.testing.assert_allclose(value, e @ np.linalg.pinv(P, rcond=1e-12, hermitian=True) @ e / 3, rtol=1e-9)
        np.testing.assert_allclose(one_sample(D @ e, D @ P @ D), value, rtol=1e-9)  # of P's condition, not of a solver
