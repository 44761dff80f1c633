"""The Student-t filter against its limit, the bound that it maximises, and its equations."""

import numpy as np
import pytest
from conftest import SOLVER, random_model, random_psd
from estimators import outlier_twin as twin
from scipy.optimize import minimize
from scipy.special import digamma, gammaln

from rmpc_bench.estimators import kalman
from rmpc_bench.estimators.student_kalman import design
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import DesignError


def run(estimator, y, u):
    """Estimates and covariances (runs, samples, ..)."""
    state, x_hat, P = estimator.init(len(y)), [], []
    for k in range(y.shape[1]):
        state, estimate = estimator.correct(k, state, y[:, k])
        x_hat.append(estimate.x_hat)
        P.append(np.broadcast_to(estimate.P, (len(y), *estimate.P.shape[-2:])))
        state = estimator.predict(k, state, u[:, k])
    return np.stack(x_hat, axis=1), np.stack(P, axis=1)


@pytest.fixture
def case(rng):
    """A model with three states and two outputs, its start and data."""
    model = random_model(rng, 3, 2, 2)
    start = {"x0": rng.standard_normal(3), "P0": random_psd(rng, 3)}
    return model, start, 5.0 * rng.standard_normal((4, 21, 2)), rng.standard_normal((4, 21, 2))


def test_many_degrees_of_freedom_are_the_kalman_filter(case):
    """The difference decreases as 1 / dof."""
    model, start, y, u = case
    expected, P = run(kalman.design(model, 20, **start), y, u)
    gaps = [np.abs(run(design(model, 20, **start, dof=dof), y, u)[0] - expected).max() for dof in (1e6, 1e8)]
    assert gaps[1] == pytest.approx(gaps[0] / 100.0, rel=1e-3)  # the next term of 1 / dof
    found = run(design(model, 20, **start, dof=1e16), y, u)
    np.testing.assert_allclose(found[0], expected, rtol=1e-11, atol=1e-12)  # 1 / dof, and rounding
    np.testing.assert_allclose(found[1], P, rtol=1e-11, atol=1e-13)


def test_one_iteration_is_the_kalman_filter(case):
    model, start, y, u = case
    expected, P = run(kalman.design(model, 20, **start), y, u)
    found = run(design(model, 20, **start, iterations=1), y, u)
    np.testing.assert_allclose(found[0], expected, rtol=1e-11, atol=1e-12)  # rounding over 20 steps
    np.testing.assert_allclose(found[1], P, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("iterations", [2, 10])
def test_over_time(case, iterations):
    """Oracle: the printed recursion, with inverses."""
    model, start, y, u = case
    found = run(design(model, 20, **start, dof=3.0, iterations=iterations), y, u)
    for i in range(len(y)):
        x_hat, P = twin.filtered(
            model, *start.values(), y[i], u[i], lambda *given: twin.student(*given, 3.0, iterations)
        )
        np.testing.assert_allclose(found[0][i], x_hat, rtol=1e-9, atol=1e-10)  # inverses, over 20 steps
        np.testing.assert_allclose(found[1][i], P, rtol=1e-9, atol=1e-10)


def test_it_maximises_the_variational_bound():
    """Oracle: the evidence lower bound of q(x) q(lam), normal times gamma, maximised by SciPy."""
    P, R, dof, e = 4.0, 2.0, 3.0, 6.0

    def negative_bound(z):
        x, p, a, b = z[0], *np.exp(z[1:])
        log_lam, lam = digamma(a) - np.log(b), a / b
        likelihood = 0.5 * log_lam - 0.5 * lam * ((e - x) ** 2 + p) / R
        prior = -0.5 * (x**2 + p) / P + (0.5 * dof - 1.0) * log_lam - 0.5 * dof * lam
        entropy = 0.5 * np.log(p) + a - np.log(b) + gammaln(a) + (1.0 - a) * digamma(a)
        return -(likelihood + prior + entropy)

    options = {"xatol": 1e-10, "fatol": 1e-15, "maxiter": 20000, "maxfev": 20000}
    found = minimize(negative_bound, [1.0, 0.0, 0.0, 0.0], method="Nelder-Mead", options=options)
    model = LinearModel([[1.0]], [[0.0]], [[1.0]], 1.0, R)
    filter_ = design(model, 1, x0=np.zeros(1), P0=np.array([[P]]), dof=dof, iterations=200)
    _, estimate = filter_.correct(0, filter_.init(1), np.array([[e]]))
    np.testing.assert_allclose(estimate.x_hat[0, 0], found.x[0], **SOLVER)
    np.testing.assert_allclose(estimate.P[0, 0, 0], np.exp(found.x[1]), **SOLVER)
    np.testing.assert_allclose(estimate.info["weight"][0, 0], np.exp(found.x[2] - found.x[3]), **SOLVER)


def test_ten_iterations_are_near_the_fixed_point():
    """An innovation of four standard deviations."""
    model = LinearModel([[1.0]], [[0.0]], [[1.0]], 1.0, 1.0)
    start = {"x0": np.zeros(1), "P0": np.eye(1)}
    y = np.array([[4.0 * np.sqrt(2.0)]])
    found = []
    for iterations in (10, 500):
        filter_ = design(model, 1, **start, iterations=iterations)
        found.append(filter_.correct(0, filter_.init(1), y)[1].x_hat.item())
    assert 0.0 < abs(found[0] - found[1]) < 0.01 * found[1]  # 10 iterations are few, not exact


def test_the_order_of_the_outputs_does_not_matter(case):
    """A common weight: R_v^-1 is the only matrix of the outputs."""
    model, start, y, u = case
    turned = LinearModel(model.A, model.B, model.C[::-1], model.Q_w, model.R_v[::-1, ::-1])
    expected, _ = run(design(model, 20, **start), y, u)
    found, _ = run(design(turned, 20, **start), y[:, :, ::-1].copy(), u)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-11)  # rounding over 20 steps


def test_a_singular_covariance_is_refused(case):
    model, start, *_ = case
    without = LinearModel(model.A, model.B, model.C, model.Q_w, np.diag([1.0, 0.0]))
    with pytest.raises(DesignError, match="R_v is singular"):
        design(without, 20, **start)


def test_correlated_noises_are_refused(scalar_model):
    correlated = LinearModel([[1.0]], [[1.0]], [[1.0]], 1.0, 1.0, S_wv=[[0.5]])
    with pytest.raises(DesignError, match="uncorrelated"):
        design(correlated, 5, x0=np.zeros(1), P0=np.eye(1))
    assert design(scalar_model, 5, x0=np.zeros(1), P0=np.eye(1)).form == "filter"


def test_r_v_may_be_the_covariance(case):
    """Oracle: the model with the scale matrix (dof - 2) / dof R_v; no covariance exists for dof <= 2."""
    model, start, y, u = case
    scaled = LinearModel(model.A, model.B, model.C, model.Q_w, 0.6 * model.R_v)
    ours = run(design(model, 20, **start, dof=5.0, R_v="covariance"), y, u)
    for a, b in zip(ours, run(design(scaled, 20, **start, dof=5.0), y, u), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)
    with pytest.raises(DesignError, match="above 2"):
        design(model, 20, **start, dof=2.0, R_v="covariance")
