"""The H-infinity filter: limits, Simon's example, the frequency response, filterpy's recursion, its conditions."""

import warnings

import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd
from estimators.mixed_systems import random_mixed
from filterpy.hinfinity import HInfinityFilter

from rmpc_bench.estimators import h_infinity, kalman, risk_sensitive
from rmpc_bench.models.disturbance import Disturbance
from rmpc_bench.models.disturbed import with_disturbance
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import DesignError

FORMS = pytest.mark.parametrize("form", ["filter", "predictor"])


def unit_model():
    """The scalar example of Simon: A = C = Q_w = R_v = 1."""
    return LinearModel([[1.0]], [[1.0]], [[1.0]], [[1.0]], [[1.0]])


@FORMS
@pytest.mark.parametrize("use_y0", [True, False])
def test_theta_0_is_the_kalman_filter(form, use_y0, rng):
    """Oracle: kalman on a model that varies with k."""
    model, keys = random_mixed(rng, 3, 2, 9), {"x0": np.ones(3), "P0": random_psd(rng, 3)}
    keys |= {"form": form, "use_y0": use_y0}
    ours, theirs = h_infinity.design(model, 9, theta=0.0, **keys), kalman.design(model, 9, **keys)
    for name in ("K", "L"):
        # The root of P and its square are other products.
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(ours.extra["P_pred"], theirs.extra["P_pred"], rtol=1e-11, atol=1e-13)


def test_the_predictor_is_the_risk_sensitive_one(rng):
    """Oracle: risk-sensitive with the same theta and W = I."""
    m = random_model(rng, 3, 1, 2, 0.9)
    keys = {"x0": np.zeros(3), "P0": m.Q_w, "theta": 0.05, "form": "predictor"}
    ours, theirs = h_infinity.design(m, 60, **keys), risk_sensitive.design(m, 60, **keys)
    np.testing.assert_allclose(ours.K, theirs.K, **ROUND)
    np.testing.assert_allclose(ours.extra["P_pred"], theirs.extra["P_pred"], **ROUND)
    assert ours.P is None and ours.form == "predictor"


def test_simons_scalar_example():
    """Oracle: his closed form at theta = 1/3: P = (1 + 7^1/2) / 2 = 1.82288, K = (7^1/2 - 1) / 2 = 0.82288."""
    for form in ("filter", "predictor"):
        ours = h_infinity.design(unit_model(), 200, x0=np.zeros(1), P0=np.eye(1), gamma=np.sqrt(3.0), form=form)
        np.testing.assert_allclose(ours.extra["P_pred"][-1], (1.0 + np.sqrt(7.0)) / 2.0, **ROUND)
        if form == "predictor":
            np.testing.assert_allclose(ours.K[-1], (np.sqrt(7.0) - 1.0) / 2.0, **ROUND)


@pytest.mark.parametrize(("form", "bound"), [("predictor", 0.5), ("filter", 1.0)])
def test_the_two_forms_have_two_conditions(form, bound):
    """Oracle: the scalar example; P = 1 / theta solves the Riccati equation at theta = 1/2, and has no root from 1 on.

    Over N steps theta_max is above the bound of the infinite horizon, by less than 10 / N^2 here.
    """
    recursion = h_infinity.Recursion([unit_model()] * 61, np.eye(1), np.eye(1), form, True)
    assert bound <= recursion.theta_max() * (1 + 1e-7) and recursion.theta_max() < bound + 4e-3


@FORMS
@pytest.mark.parametrize("fraction", [0.3, 0.99])
def test_the_frequency_response_is_below_gamma(form, fraction, rng):
    """Oracle: the largest singular value of (w, v) -> weight (x - x_hat), noises of unit size, on 500 frequencies."""
    m, weight = random_model(rng, 3, 1, 2, 0.6), np.array([[1.0, 0.5, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.7]])
    keys = {"x0": np.zeros(3), "P0": 1e-3 * np.eye(3), "weight": weight.tolist(), "form": form}
    ours = h_infinity.design(m, 60, fraction=fraction, **keys)
    gamma, nominal = ours.extra["theta"][0] ** -0.5, kalman.design(m, 60, x0=np.zeros(3), P0=m.Q_w, form=form)
    achieved, of_kalman = (norm_of_error(m, weight, each.K[-1], each.L[-1]) for each in (ours, nominal))
    assert achieved <= gamma * (1 + 1e-9)
    if fraction > 0.9:
        assert achieved > 0.95 * gamma and of_kalman > achieved


def norm_of_error(m, weight, K, L):
    """Largest gain over the frequencies from noises of unit covariance to weight (x - x_hat)."""
    nx, ny = m.nx, m.ny
    noise = np.hstack([np.linalg.cholesky(m.Q_w), np.zeros((nx, ny))]), np.linalg.cholesky(m.R_v)
    v = np.hstack([np.zeros((ny, nx)), noise[1]])
    largest = 0.0
    for z in np.exp(1j * np.linspace(0.0, np.pi, 500)):
        prediction = np.linalg.solve(z * np.eye(nx) - m.A + K @ m.C, noise[0] - K @ v)
        error = (np.eye(nx) - L @ m.C) @ prediction - L @ v
        largest = max(largest, np.linalg.norm(weight @ error, 2))
    return largest


@FORMS
def test_the_energy_of_the_error_is_bounded_over_the_horizon(form, rng):
    """Oracle: the least-squares worst case; all signals at once, x(0) included, on a model that varies."""
    model, P0, n = random_mixed(rng, 2, 1, 6), random_psd(rng, 2), 6
    ours = h_infinity.design(model, n, x0=np.zeros(2), P0=P0, fraction=0.99, form=form)
    rows, size = [], 2 + n * 2 + (n + 1)
    x, x_pred = np.zeros((2, size)), np.zeros((2, size))
    x[:, :2] = np.linalg.cholesky(P0)
    for k in range(n + 1):
        now = model.at(k)
        v = np.zeros((1, size))
        v[0, 2 + 2 * n + k] = np.sqrt(now.R_v[0, 0])
        e = now.C @ x + v - now.C @ x_pred
        L, K = ours.L[k if len(ours.L) > 1 else 0], ours.K[k]
        rows.append(x - x_pred - L @ e)
        if k < n:
            w = np.zeros((2, size))
            w[:, 2 + 2 * k : 4 + 2 * k] = np.linalg.cholesky(now.Q_w)
            x, x_pred = now.A @ x + w, now.A @ x_pred + K @ e
    gamma = ours.extra["theta"][0] ** -0.5
    achieved = np.linalg.norm(np.vstack(rows), 2)
    assert 0.9 * gamma < achieved <= gamma * (1 + 1e-9)


def test_the_design_matrix_is_filterpys(rng):
    """Oracle: filterpy's HInfinityFilter, of which only the recursion of P is right."""
    m, weight = random_model(rng, 3, 1, 2, 0.9), random_psd(rng, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = HInfinityFilter(3, 2, 1, gamma=0.05)
    theirs.F, theirs.H, theirs.W = m.A, m.C, m.Q_w
    theirs.Q, theirs.V, theirs.P = weight.T @ weight, m.R_v, np.eye(3)
    ours = h_infinity.design(m, 30, x0=np.zeros(3), P0=np.eye(3), theta=0.05, weight=weight.tolist())
    for k in range(31):
        # Inverses of matrices that are not symmetrised.
        np.testing.assert_allclose(ours.extra["P_pred"][k], theirs.P, rtol=1e-10, atol=1e-12)
        theirs.update(np.zeros((2, 1)))


@FORMS
def test_a_singular_start_and_a_disturbance_are_allowed(form, rng):
    """Oracle: the limit of regular starts."""
    model = with_disturbance(random_model(rng, 2, 1, 1, 0.8), Disturbance(at="input", drift=0.1), 20, np.zeros(2))
    keys = {"x0": np.zeros(3), "theta": 0.01, "form": form}
    zero, small = (h_infinity.design(model, 20, P0=size * np.eye(3), **keys) for size in (0.0, 1e-9))
    np.testing.assert_allclose(zero.K, small.K, atol=1e-7)  # of the size of the start


@FORMS
def test_a_theta_above_the_bound_is_a_design_error(form, rng):
    """Oracle: the first k with theta lambda_max(P) >= 1, from the recursion by explicit inverses; theta_max by it."""
    m, P0 = random_model(rng, 3, 1, 2, 0.9), 0.01 * np.eye(3)
    bound = h_infinity.Recursion([m] * 16, P0, np.eye(3), form, True).theta_max()
    keys = {"x0": np.zeros(3), "P0": P0, "form": form}
    h_infinity.design(m, 15, theta=bound * (1 - 1e-8), **keys)
    for excess in (1e-6, 0.5):
        theta, P, first = bound * (1 + excess), P0, None
        for k in range(16):
            information = np.linalg.inv(P) + (m.C.T @ np.linalg.inv(m.R_v) @ m.C if form == "filter" else 0.0)
            if first is None and np.linalg.eigvalsh(information)[0] <= theta:
                first = k
                break
            used = np.linalg.inv(P) - theta * np.eye(3) + m.C.T @ np.linalg.inv(m.R_v) @ m.C
            P = m.A @ np.linalg.inv(used) @ m.A.T + m.Q_w
        with pytest.raises(DesignError, match=rf"at k = {first}: .*theta_max = {bound:.6g}") as caught:
            h_infinity.design(m, 15, theta=theta, **keys)
        assert caught.value.parameter == "theta"
    with pytest.raises(DesignError, match=r"choose gamma > ") as caught:
        h_infinity.design(m, 15, gamma=0.9 * bound**-0.5, **keys)
    assert caught.value.parameter == "gamma"


@pytest.mark.parametrize("given", [{}, {"theta": 0.1, "gamma": 2.0}, {"gamma": 2.0, "fraction": 0.5}])
def test_exactly_one_size_is_given(given, scalar_model):
    """Oracle: the docstring."""
    with pytest.raises(DesignError, match="exactly one of theta, gamma and fraction"):
        h_infinity.design(scalar_model, 3, x0=np.zeros(1), P0=np.eye(1), **given)


def test_a_fraction_is_independent_of_units(rng):
    """Oracle: the same system with x in another unit; the remark names theta and theta_max."""
    m, scale = random_model(rng, 2, 1, 1, 0.9), 1000.0
    other = LinearModel(m.A, m.B * scale, m.C / scale, m.Q_w * scale**2, m.R_v)
    one, two = (
        h_infinity.design(each, 15, x0=np.zeros(2), P0=size * np.eye(2), fraction=0.9)
        for each, size in ((m, 1.0), (other, scale**2))
    )
    np.testing.assert_allclose(two.L, scale * one.L, rtol=1e-6)  # theta_max has eight digits
    assert "theta_max" in one.remarks[0] and "0.9" in one.remarks[0]


def test_singular_measurement_noise_is_a_design_error():
    """Oracle: the guarantee weighs v by R_v^-1."""
    model = LinearModel(np.eye(1), np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)))
    with pytest.raises(DesignError, match="R_v is singular at k = 0"):
        h_infinity.design(model, 3, x0=np.zeros(1), P0=np.eye(1), theta=0.1)
