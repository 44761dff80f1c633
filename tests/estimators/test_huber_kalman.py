"""Huber's filters against their limit, the closed form of one output, SciPy's minimum and filterpy."""

import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd
from estimators.outlier_twin import clipped, filtered, huber_weight, whitener
from filterpy.kalman import KalmanFilter
from scipy.optimize import brentq, minimize
from scipy.stats import norm

from rmpc_bench.estimators import kalman
from rmpc_bench.estimators.huber_kalman import decrease, design
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import DesignError

KINDS = [{}, {"robust": "both"}, {"variant": "innovation"}]


def run(estimator, y, u):
    """Estimates and covariances (runs, samples, ..)."""
    state, x_hat, P = estimator.init(len(y)), [], []
    for k in range(y.shape[1]):
        state, estimate = estimator.correct(k, state, y[:, k])
        x_hat.append(estimate.x_hat)
        P.append(np.broadcast_to(estimate.P, (len(y), *estimate.P.shape[-2:])))
        state = estimator.predict(k, state, u[:, k])
    return np.stack(x_hat, axis=1), np.stack(P, axis=1)


def first(estimator, y):
    """Estimates of y(0)."""
    return estimator.correct(0, estimator.init(len(y)), y)[1]


@pytest.mark.parametrize("keys", KINDS, ids=str)
def test_a_large_corner_is_the_kalman_filter(keys, rng):
    model = random_model(rng, 3, 2, 2)
    start = {"x0": rng.standard_normal(3), "P0": random_psd(rng, 3)}
    y, u = 5.0 * rng.standard_normal((4, 21, 2)), rng.standard_normal((4, 21, 2))
    expected, P = run(kalman.design(model, 20, **start), y, u)
    found = run(design(model, 20, **start, k=1e4, **keys), y, u)
    np.testing.assert_allclose(found[0], expected, rtol=1e-11, atol=1e-12)  # rounding over 20 steps
    np.testing.assert_allclose(found[1], P, rtol=1e-11, atol=1e-13)


def test_closed_form_of_one_output(rng):
    """x_pred + P C' clip(e / S, +-k / sqrt(R_v)); outliers of up to a million standard deviations."""
    model = random_model(rng, 3, 1, 1)
    x0, P0, k = rng.standard_normal(3), random_psd(rng, 3), 1.345
    y = rng.standard_normal((200, 1)) * 10.0 ** rng.uniform(-1.0, 6.0, (200, 1))
    e, PC, R = y - model.C @ x0, P0 @ model.C[0], model.R_v.item()
    factor = np.clip(e / (model.C[0] @ PC + R), -k / np.sqrt(R), k / np.sqrt(R))
    np.testing.assert_allclose(first(design(model, 1, x0=x0, P0=P0), y).x_hat, x0 + PC * factor, **ROUND)
    assert 20 < (np.abs(factor) < k / np.sqrt(R)).sum() < 180


def huber(r, k):
    """The loss of all components."""
    size = np.abs(r)
    return np.where(size <= k, 0.5 * r**2, k * size - 0.5 * k**2).sum()


@pytest.mark.parametrize("both", [False, True])
def test_several_outputs(both, rng):
    """Oracle: SciPy's minimum of the cost, convex and therefore the only one."""
    k = 1.0
    for _ in range(8):
        model, x0, P0 = random_model(rng, 3, 1, 2), rng.standard_normal(3), random_psd(rng, 3)
        y = rng.standard_normal(2) * 5.0
        T, T_x = whitener(model.R_v), whitener(P0)

        def cost(x, model=model, x0=x0, y=y, T=T, T_x=T_x):
            z = T_x @ (x - x0)
            return (huber(z, k) if both else 0.5 * z @ z) + huber(T @ (y - model.C @ x), k)

        found = minimize(cost, x0, method="BFGS", options={"gtol": 1e-10})
        polished = minimize(cost, found.x, method="Nelder-Mead", options={"xatol": 1e-11, "fatol": 1e-16})
        estimate = first(design(model, 1, x0=x0, P0=P0, k=k, robust="both" if both else "measurement"), y[None])
        # The cost is flat to rounding within 1e-8; reweighting stops at 1e-11 of a residual.
        np.testing.assert_allclose(estimate.x_hat[0], polished.x, rtol=1e-6, atol=2e-6)
        assert cost(estimate.x_hat[0]) <= polished.fun + 1e-12


def test_covariance_is_that_of_the_weights(rng):
    """Oracle: filterpy with R_v over min(1, k / |r|)."""
    model, x0, P0, k = random_model(rng, 3, 1, 2), np.zeros(3), random_psd(rng, 3), 1.0
    for y in 4.0 * rng.standard_normal((6, 2)):
        estimate = first(design(model, 1, x0=x0, P0=P0, k=k), y[None])
        T = whitener(model.R_v)
        w = huber_weight(T @ (y - model.C @ estimate.x_hat[0]), k)
        theirs = KalmanFilter(dim_x=3, dim_z=2)
        theirs.x, theirs.P, theirs.H = x0, P0, model.C
        theirs.update(y, R=np.linalg.inv(T) @ np.diag(1.0 / w) @ np.linalg.inv(T).T)
        np.testing.assert_allclose(estimate.x_hat[0], theirs.x, rtol=1e-10, atol=1e-11)  # two inverses
        np.testing.assert_allclose(estimate.P[0], theirs.P, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(estimate.info["weight"][0], w, rtol=1e-10)


def test_clipped_innovation_over_time(rng):
    """Oracle: the printed formulas; P depends on the missing measurements only."""
    model = random_model(rng, 3, 2, 2)
    start = {"x0": rng.standard_normal(3), "P0": random_psd(rng, 3)}
    y, u = 5.0 * rng.standard_normal((4, 21, 2)), rng.standard_normal((4, 21, 2))
    found = run(design(model, 20, **start, variant="innovation", k=1.0, eps=0.1), y, u)
    kept = 0.9 * (1.0 - 2.0 * norm.cdf(-1.0))
    for i in range(len(y)):
        x_hat, P = filtered(model, *start.values(), y[i], u[i], lambda *given: clipped(*given, 1.0, kept))
        np.testing.assert_allclose(found[0][i], x_hat, rtol=1e-9, atol=1e-10)  # inverses, over 20 steps
        np.testing.assert_allclose(found[1][i], P, rtol=1e-9, atol=1e-10)
    np.testing.assert_array_equal(found[1][0], found[1][1])


@pytest.mark.parametrize("k", [0.5, 1.345, 3.0])
def test_share_for_which_the_corner_is_minimax(k):
    """Oracle: eps from Huber's equation 2 phi(k) / k - 2 Phi(-k) = eps / (1 - eps) by root finding."""
    gap = 2.0 * norm.pdf(k) / k - 2.0 * norm.cdf(-k)
    eps = brentq(lambda share: share / (1.0 - share) - gap, 0.0, 1.0 - 1e-9, xtol=1e-15)
    np.testing.assert_allclose(decrease(k), (1.0 - eps) * (1.0 - 2.0 * norm.cdf(-k)), rtol=1e-11)  # the root
    np.testing.assert_allclose(decrease(k, 0.05), 0.95 * (1.0 - 2.0 * norm.cdf(-k)), **ROUND)


def test_the_order_of_correlated_outputs_matters():
    """As the module says: whitening by the Cholesky factor is a choice; with a diagonal R_v it is none."""
    C, y = np.array([[1.0, 0.0], [0.5, 1.0]]), np.array([[3.0, -4.0]])
    start, moved = {"x0": np.zeros(2), "P0": np.eye(2)}, {}
    for name, R in (("correlated", np.array([[1.0, 0.8], [0.8, 1.0]])), ("independent", np.eye(2))):
        model = LinearModel(np.eye(2), np.zeros((2, 1)), C, np.eye(2), R)
        turned = LinearModel(np.eye(2), np.zeros((2, 1)), C[::-1], np.eye(2), R[::-1, ::-1])
        x_hat = first(design(model, 1, **start), y).x_hat
        moved[name] = np.abs(first(design(turned, 1, **start), y[:, ::-1].copy()).x_hat - x_hat).max()
    assert moved["correlated"] > 0.1 and moved["independent"] < 1e-14


def test_keys_of_the_other_variant_are_refused(scalar_model):
    start = {"x0": np.zeros(1), "P0": np.eye(1)}
    with pytest.raises(DesignError, match="needs `variant: regression`") as caught:
        design(scalar_model, 5, **start, variant="innovation", robust="both")
    assert caught.value.parameter == "robust"
    with pytest.raises(DesignError, match="belongs to `variant: innovation`") as caught:
        design(scalar_model, 5, **start, eps=0.1)
    assert caught.value.parameter == "eps"
