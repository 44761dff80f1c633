"""Algorithm 2 and Propositions 1 and 2 on the servomechanism: accuracy, convergence and its speed.

servo.md calls 0.9897, 0.9980, 0.9995, 0.9999 the spectral radii of the linearised risk-sensitive Riccati map.  They are
those of its transition matrix Phi; the map moves covariances by Phi dP Phi', so its own radii are their squares.
"""

from functools import cache

import numpy as np
import pytest
from conftest import ROUND, servo_model

from rmpc_bench.estimators import risk_sensitive, robust_kalman
from rmpc_bench.numerics.divergence import inflate, inflate_to_radius
from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.riccati import filter_step

MODEL = servo_model()
START = {"x0": np.zeros(4), "P0": MODEL.Q_w}
RADII = [1e-3, 1e-2, 1e-1, 1.0]
PUBLISHED = dict(zip(RADII, [0.9897, 0.9980, 0.9995, 0.9999], strict=True))


@cache
def robust(c, tau=0.0):
    """The robust filter over 120 s; cached because many tests start from its end."""
    return robust_kalman.design(MODEL, 1200, c=c, tau=tau, **START)


steady_theta = cache(lambda c: risk_sensitive.steady_theta(MODEL, START["P0"], c))


def robust_map(P, c):
    """P(t+1) of the robust filter, (13)-(16)."""
    return filter_step(MODEL.A, MODEL.C, MODEL.Q_w, MODEL.R_v, inflate_to_radius(psd_sqrt(P), c).root).P_next


def risk_sensitive_map(P, theta):
    """P(t+1) of the risk-sensitive filter, (18)."""
    return filter_step(MODEL.A, MODEL.C, MODEL.Q_w, MODEL.R_v, inflate(psd_sqrt(P), theta).root).P_next


def linearised_radius(function, P):
    """Spectral radius of the derivative on symmetric matrices, by central differences of the independent entries."""
    rows, columns = np.triu_indices(4)
    J = np.zeros((10, 10))
    for j, (row, column) in enumerate(zip(rows, columns, strict=True)):
        E = np.zeros((4, 4))
        E[row, column] = E[column, row] = 1e-6 * max(abs(P[row, column]), 1e-3)
        J[:, j] = (function(P + E) - function(P - E))[rows, columns] / (2.0 * E[row, column])
    return np.abs(np.linalg.eigvals(J)).max()


def algorithm_2(lam, c, eps):
    """Algorithm 2 as printed, for eigenvalues lam; the middle of the bracket where it stops."""
    low, high = eps, 1.0 / lam[-1] - eps
    while high - low > eps:
        theta = 0.5 * (low + high)
        x = theta * lam
        left = np.sum(np.log1p(-x) + x / (1.0 - x))
        low, high = (theta, high) if left < c else (low, theta)
    return 0.5 * (low + high)


@pytest.mark.parametrize(("eps", "off", "digits"), [(1e-3, 0.08, 5e-3), (1e-4, -8e-4, 5e-5), (1e-6, -2e-5, 5e-7)])
def test_an_absolute_eps_limits_algorithm_2(eps, off, digits):
    """Oracle: servo.md 3.3: at the steady P of c = 0.1, eps = 1e-3 is 8 % off, 1e-4 0.08 %, 1e-6 2e-5."""
    P = robust(0.1).extra["P_pred"][-1]
    theta = inflate_to_radius(psd_sqrt(P), 0.1).theta
    np.testing.assert_allclose(algorithm_2(np.linalg.eigvalsh(P), 0.1, eps) / theta - 1.0, off, rtol=0, atol=digits)


def test_an_absolute_eps_has_a_unit():
    """Oracle: with noise a hundred times as strong there is no bracket left for an eps of 1e-3, for ours nothing."""
    P = robust(0.1).extra["P_pred"][-1]
    assert 1.0 / np.linalg.eigvalsh(1e4 * P)[-1] - 1e-3 < 1e-3
    np.testing.assert_allclose(
        1e4 * inflate_to_radius(psd_sqrt(1e4 * P), 0.1).theta, inflate_to_radius(psd_sqrt(P), 0.1).theta, rtol=1e-13
    )


@pytest.mark.parametrize(("c", "tau"), [*((c, 0.0) for c in RADII), (100.0, 0.0), (0.1, 0.5), (0.1, 1.0)])
def test_proposition_1(c, tau):
    """Oracle: the statement, for c to 100 (servo.md section 1: theta_t converged for every c tried), and along tau."""
    filter_ = robust(c, tau)
    series = filter_.series()
    for name in ("P_pred", "V", "theta", "L", "K", "rho"):
        last = series[name][-1]
        np.testing.assert_allclose(series[name][-200], last, rtol=0, atol=1e-8 * np.abs(last).max())
    assert np.linalg.eigvalsh(series["P_pred"][-1])[0] > 0.0
    assert np.linalg.eigvalsh(series["V"][-1])[0] > 0.0
    assert series["theta"][-1] > 0.0
    assert series["rho"][-1] < 1.0  # A - K_bar C is Schur stable


@pytest.mark.parametrize("c", RADII)
def test_the_robust_and_the_risk_sensitive_filter_share_their_fixed_point(c):
    """Oracle: servo.md 3.4; the map of either filter leaves the other's steady covariance alone."""
    P, theta = robust(c).extra["P_pred"][-1], steady_theta(c)
    for image in (robust_map(P, c), risk_sensitive_map(P, theta)):
        np.testing.assert_allclose(image, P, rtol=0, atol=1e-11 * np.abs(P).max())


@pytest.mark.parametrize("c", RADII)
def test_the_risk_sensitive_filter_converges_slowly(c):
    """Oracle: finite differences of the map, Phi in closed form and servo.md 3.4, half a unit of the last digit."""
    P, theta = robust(c).extra["P_pred"][-1], steady_theta(c)
    Phi = (MODEL.A - robust(c).K[-1] @ MODEL.C) @ np.linalg.inv(np.eye(4) - theta * P)
    radius = np.abs(np.linalg.eigvals(Phi)).max()
    np.testing.assert_allclose(radius, PUBLISHED[c], rtol=0, atol=5e-5)
    np.testing.assert_allclose(linearised_radius(lambda P: risk_sensitive_map(P, theta), P), radius**2, rtol=1e-6)
    assert linearised_radius(lambda P: robust_map(P, c), P) < radius**2


def settled(L, L_bar):
    """Last time in seconds at which an entry of the gain is off its end by more than 1e-3 of the largest entry."""
    off = np.abs(L - L_bar).max(axis=(1, 2)) > 1e-3 * np.abs(L_bar).max()
    return 0.1 * np.flatnonzero(off)[-1]


def test_proposition_2():
    """Oracle: the statement, and servo.md section 1: 723.6 s until the gain has converged, 9.3 s for the robust one."""
    slow, L_bar = risk_sensitive.design(MODEL, 12_000, theta=steady_theta(0.1), **START), robust(0.1).L[-1]
    np.testing.assert_allclose(settled(slow.L, L_bar), 723.6, **ROUND)
    np.testing.assert_allclose(settled(robust(0.1).L, L_bar), 9.3, **ROUND)
    np.testing.assert_allclose(slow.L[-1], L_bar, rtol=1e-4)  # 0.99901^12000 = 7e-6
    series = slow.series()
    assert np.linalg.eigvalsh(series["P_pred"][-1])[0] > 0.0
    assert np.linalg.eigvalsh(series["V"][-1])[0] > 0.0
    assert series["rho"][-1] < 1.0


def test_the_information_along_the_rigid_body_limits_theta():
    """Oracle: servo.md 3.4: v = [1, 0, 20, 0], A v = v, leaves 1 - 401 theta of a measurement's information."""
    v = np.array([1.0, 0.0, 20.0, 0.0])
    np.testing.assert_allclose(MODEL.A @ v, v, atol=1e-12)
    left = [1.0 - (v @ v) * steady_theta(c) for c in RADII]
    np.testing.assert_allclose(left, [0.406, 0.030, 0.0160, 0.0152], rtol=0, atol=5e-4)
