"""The correntropy filter against its limit and the stationary points of its loss."""

import numpy as np
import pytest
from conftest import random_model, random_psd
from estimators.outlier_twin import whitener
from scipy.optimize import minimize_scalar

from rmpc_bench.estimators import kalman
from rmpc_bench.estimators.correntropy_kalman import design
from rmpc_bench.models.linear import LinearModel


def run(estimator, y, u):
    """Estimates and covariances (runs, samples, ..)."""
    state, x_hat, P = estimator.init(len(y)), [], []
    for k in range(y.shape[1]):
        state, estimate = estimator.correct(k, state, y[:, k])
        x_hat.append(estimate.x_hat)
        P.append(np.broadcast_to(estimate.P, (len(y), *estimate.P.shape[-2:])))
        state = estimator.predict(k, state, u[:, k])
    return np.stack(x_hat, axis=1), np.stack(P, axis=1)


@pytest.mark.parametrize("robust", ["measurement", "both"])
def test_a_wide_kernel_is_the_kalman_filter(robust, rng):
    model = random_model(rng, 3, 2, 2)
    start = {"x0": rng.standard_normal(3), "P0": random_psd(rng, 3)}
    y, u = 5.0 * rng.standard_normal((4, 21, 2)), rng.standard_normal((4, 21, 2))
    expected, P = run(kalman.design(model, 20, **start), y, u)
    found = run(design(model, 20, **start, sigma=1e8, robust=robust), y, u)
    np.testing.assert_allclose(found[0], expected, rtol=1e-11, atol=1e-12)  # rounding over 20 steps
    np.testing.assert_allclose(found[1], P, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("both", [False, True])
def test_estimates_are_stationary_points_of_the_loss(both, rng):
    """Oracle: the gradient of the loss -sigma^2 sum exp(-r^2 / (2 sigma^2)), written by hand."""
    sigma, sizes = 2.0, []
    for _ in range(20):
        model, x0, P0 = random_model(rng, 3, 1, 2), rng.standard_normal(3), random_psd(rng, 3)
        y = 3.0 * rng.standard_normal(2)
        filter_ = design(model, 1, x0=x0, P0=P0, sigma=sigma, robust="both" if both else "measurement")
        x = filter_.correct(0, filter_.init(1), y[None])[1].x_hat[0]
        T, T_x = whitener(model.R_v), whitener(P0)
        z, r = T_x @ (x - x0), T @ (y - model.C @ x)
        bend = np.exp(-0.5 * (z / sigma) ** 2) if both else 1.0
        parts = T_x.T @ (z * bend), (T @ model.C).T @ (r * np.exp(-0.5 * (r / sigma) ** 2))
        np.testing.assert_allclose(parts[0], parts[1], rtol=1e-7, atol=1e-7)  # the stop at 1e-11, times 1 / P
        sizes.append(np.abs(parts[0]).max())
    assert max(sizes) > 0.1


def test_one_output_moves_to_the_minimum_next_to_the_prediction():
    """Oracle: SciPy's minimum of the loss of one state between x_pred and y."""
    model = LinearModel([[1.0]], [[0.0]], [[1.0]], 1.0, 1.0)
    filter_ = design(model, 1, x0=np.zeros(1), P0=np.array([[0.5]]), sigma=2.0)
    for e in (0.5, 2.0, 4.0):
        loss = minimize_scalar(
            lambda x, e=e: x * x - 4.0 * np.exp(-((e - x) ** 2) / 8.0), bounds=(0.0, e), options={"xatol": 1e-12}
        )
        found = filter_.correct(0, filter_.init(1), np.array([[e]]))[1].x_hat.item()
        assert found == pytest.approx(loss.x, abs=1e-7)  # the loss is flat to rounding there


def test_a_measurement_far_away_has_no_effect():
    """The weight decreases to 0: redescending, unlike Huber's."""
    model = LinearModel([[1.0]], [[0.0]], [[1.0]], 1.0, 1.0)
    filter_ = design(model, 1, x0=np.zeros(1), P0=np.eye(1), sigma=2.0)
    estimate = filter_.correct(0, filter_.init(3), np.array([[10.0], [20.0], [1e6]]))[1]
    assert (np.diff(np.abs(estimate.x_hat[:, 0])) < 0.0).all() and estimate.x_hat[2, 0] == 0.0
    assert estimate.P[2, 0, 0] == 1.0 and estimate.info["weight"][2, 0] == 0.0
