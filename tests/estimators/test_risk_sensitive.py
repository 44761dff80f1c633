"""The risk-sensitive filter: limits, the tie to the robust filter, and where it is not defined."""

import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd
from scipy.linalg import expm

from rmpc_bench.estimators import kalman, risk_sensitive, robust_kalman
from rmpc_bench.estimators.risk_sensitive import Radius
from rmpc_bench.types import DesignError

THETA_BAR = 0.00245384
"""servo.md section 1, robust filter at c = 0.1."""


@pytest.mark.parametrize(("nx", "ny"), [(1, 1), (3, 2)])
def test_a_small_theta_is_the_kalman_filter(nx, ny, rng):
    """Oracle: theta -> 0 is Kalman, at first order: a tenth of theta is a tenth of the distance."""
    m = random_model(rng, nx, 1, ny)
    start = {"x0": np.zeros(nx), "P0": m.Q_w}
    L = kalman.design(m, 30, **start).L
    off = [np.abs(risk_sensitive.design(m, 30, theta=theta, **start).L - L).max() for theta in (1e-6, 1e-5, 1e-4)]
    assert off[0] < 1e-4
    np.testing.assert_allclose([off[1] / off[0], off[2] / off[1]], 10.0, rtol=0.02)


@pytest.mark.parametrize("c", [1e-4, 1e-2, 0.5])
def test_theta_from_a_radius_gives_the_robust_filters_steady_gains(c, rng):
    """Oracle: at the robust filter's fixed point its theta is constant, so that both have the same fixed point."""
    m = random_model(rng, 3, 1, 2, 0.9)
    start = {"x0": np.zeros(3), "P0": m.Q_w}
    robust = robust_kalman.design(m, 600, c=c, **start)
    ours = risk_sensitive.design(m, 600, theta_from=Radius(c), **start)
    np.testing.assert_allclose(ours.extra["theta"], robust.extra["theta"][-1], rtol=1e-11)
    np.testing.assert_allclose(ours.L[-1], robust.L[-1], rtol=1e-9)
    np.testing.assert_allclose(ours.P[-1], robust.P[-1], rtol=1e-9)


def test_on_the_servo_the_published_numbers_come_out(servo):
    """Oracle: servo.md section 1: theta_bar to 8 decimals, L at 5 s and 20 s to 4."""
    ours = risk_sensitive.design(servo, 200, x0=np.zeros(4), P0=servo.Q_w, theta_from=Radius(0.1))
    np.testing.assert_allclose(ours.extra["theta"], THETA_BAR, rtol=0, atol=5e-9)
    np.testing.assert_allclose(ours.L[50, :, 0], [0.2196, -0.2593, 0.1048, 1.5702], rtol=0, atol=5.05e-5)
    np.testing.assert_allclose(ours.L[200, :, 0], [0.2485, -0.1774, 0.7600, 1.4878], rtol=0, atol=5.05e-5)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 10.0])
def test_moderate_starts_are_defined(servo, scale):
    """Oracle: P_0 up to 10 I is fine: theta lambda_max(P_t) stays below 1, so that V_t is positive definite."""
    filter_ = risk_sensitive.design(servo, 300, x0=np.zeros(4), P0=scale * np.eye(4), theta=THETA_BAR)
    largest = np.linalg.eigvalsh(filter_.extra["P_pred"])[:, -1]
    assert (THETA_BAR * largest < 1.0).all()
    assert (np.linalg.eigvalsh(filter_.extra["V"]) > 0.0).all()


@pytest.mark.parametrize(("scale", "k"), [(100.0, 3), (400.0, 1), (500.0, 0)])
def test_a_large_start_is_a_design_error_at_its_first_step(servo, scale, k):
    """Oracle: servo.md 3.4: undefined from t = 3, 1 and 0 on."""
    with pytest.raises(DesignError, match=rf"step k = {k} .*not below 1.*smaller theta"):
        risk_sensitive.design(servo, 300, x0=np.zeros(4), P0=scale * np.eye(4), theta=THETA_BAR)


def test_at_tau_1_a_large_start_is_defined_until_it_overflows(servo):
    """Oracle: (19) survives P_0 = 100 I and 400 I and comes to its steady gain, and overflows from 500 I on.

    The numbers of 400 I are those of 800 digits (mpmath).  V(2) is 7e28, which a covariance in doubles does not bear;
    its root has a rounding error of 0.06, of which the sums of one processor leave more than those of another.
    """
    start = {"x0": np.zeros(4), "theta": THETA_BAR, "tau": 1.0}
    survivor = risk_sensitive.design(servo, 3000, P0=100.0 * np.eye(4), **start)
    usual = risk_sensitive.design(servo, 3000, P0=servo.Q_w, **start)
    np.testing.assert_allclose(survivor.L[-1], usual.L[-1], rtol=1e-9)
    assert survivor.series()["rho"][-1] < 1.0
    larger = risk_sensitive.design(servo, 8, P0=400.0 * np.eye(4), **start).extra["P_pred"]
    sizes = [400.0, 1223.0, 23080.0, 8813.0, 1565.0, 449.3, 192.0, 122.8]
    np.testing.assert_allclose(np.linalg.norm(larger[:8], 2, axis=(1, 2)), sizes, rtol=1e-2)
    for scale, k in ((500.0, 2), (1e10, 0)):
        with pytest.raises(DesignError, match=rf"step k = {k} .*overflows.*smaller theta"):
            risk_sensitive.design(servo, 300, P0=scale * np.eye(4), **start)


def test_tau_1_is_19(rng):
    """Oracle: V = F exp(theta F'F) F' with the Cholesky factor, by SciPy, and the rest of Theorem 2 written out."""
    m, theta, P = random_model(rng, 3, 1, 2), 0.2, random_psd(rng, 3)
    ours = risk_sensitive.design(m, 10, x0=np.zeros(3), P0=P, theta=theta, tau=1.0)
    for k in range(11):
        F = np.linalg.cholesky(P)
        V = F @ expm(theta * F.T @ F) @ F.T
        S = m.C @ V @ m.C.T + m.R_v
        L = V @ m.C.T @ np.linalg.inv(S)
        np.testing.assert_allclose(ours.extra["V"][k], V, atol=1e-10)
        np.testing.assert_allclose(ours.L[k], L, atol=1e-10)
        P = m.A @ V @ m.A.T - m.A @ L @ S @ L.T @ m.A.T + m.Q_w


@pytest.mark.parametrize("tau", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("kl", ["printed", "half"])
def test_theta_from_reads_the_radius_as_the_robust_filter_does(kl, tau, rng):
    """Oracle: the robust filter with the same c, kl and tau, at its fixed point."""
    m = random_model(rng, 3, 1, 2, 0.9)
    start = {"x0": np.zeros(3), "P0": m.Q_w, "tau": tau}
    robust = robust_kalman.design(m, 600, c=0.1, kl=kl, **start)
    ours = risk_sensitive.design(m, 600, theta_from=Radius(0.1, kl), **start)
    np.testing.assert_allclose(ours.extra["theta"], robust.extra["theta"][-1], rtol=1e-11)
    np.testing.assert_allclose(ours.L[-1], robust.L[-1], rtol=1e-9)


def test_from_the_process_noise_the_covariance_grows_to_its_limit(servo):
    """Oracle: servo.md 3.4: from P_0 = GG' the sequence is monotone and theta lambda_max stays below 0.337."""
    P_pred = risk_sensitive.design(servo, 400, x0=np.zeros(4), P0=servo.Q_w, theta=THETA_BAR).extra["P_pred"]
    for before, after in zip(P_pred[:-1], P_pred[1:], strict=True):
        assert np.linalg.eigvalsh(after - before)[0] >= -1e-12 * np.abs(after).max()  # rounding
    assert THETA_BAR * np.linalg.eigvalsh(P_pred)[:, -1].max() < 0.337


def test_the_recursion_is_theorem_2(rng):
    """Oracle: (18) written out with explicit inverses of well-conditioned matrices."""
    m, theta, P = random_model(rng, 3, 1, 2), 0.05, random_psd(rng, 3)
    ours = risk_sensitive.design(m, 10, x0=np.zeros(3), P0=P, theta=theta)
    for k in range(11):
        V = np.linalg.inv(np.linalg.inv(P) - theta * np.eye(3))
        S = m.C @ V @ m.C.T + m.R_v
        L = V @ m.C.T @ np.linalg.inv(S)
        np.testing.assert_allclose(ours.L[k], L, atol=1e-10)
        np.testing.assert_allclose(ours.extra["V"][k], V, atol=1e-10)
        P = m.A @ V @ m.A.T - m.A @ L @ S @ L.T @ m.A.T + m.Q_w


@pytest.mark.parametrize("given", [{}, {"theta": 0.1, "theta_from": Radius(0.1)}])
def test_exactly_one_source_of_theta_is_wanted(given, scalar_model):
    """Oracle: the docstring."""
    with pytest.raises(DesignError, match="either theta or theta_from"):
        risk_sensitive.design(scalar_model, 3, x0=np.zeros(1), P0=np.eye(1), **given)


def test_a_scalar_steady_state_is_that_of_the_quadratic():
    """Oracle: by hand; with information i = 1/P: P = a^2 / (i - theta + 1/r) + q is a quadratic in P."""
    from rmpc_bench.models.linear import LinearModel

    a, q, r, theta = 0.8, 0.5, 2.0, 0.1
    model = LinearModel([[a]], [[1.0]], [[1.0]], [[q]], [[r]])
    P = risk_sensitive.design(model, 500, x0=np.zeros(1), P0=np.eye(1), theta=theta).extra["P_pred"][-1, 0, 0]
    g = 1.0 / r - theta  # P (1 + g P) = a^2 P + q (1 + g P)
    roots = np.roots([g, 1.0 - a**2 - q * g, -q])
    np.testing.assert_allclose(P, roots[roots > 0.0][0], **ROUND)
