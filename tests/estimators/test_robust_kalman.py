"""The robust Kalman filter: limits, the paper's recursion and the numbers of servo.md."""

from functools import cache, partial

import mpmath
import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd, servo_model
from scipy.linalg import expm
from scipy.optimize import brentq

from rmpc_bench.estimators import kalman, robust_kalman


def difference(m, c, n_steps=30, P0=None):
    """Largest distance of the robust gains from the Kalman gains, relative to the latter."""
    start = {"x0": np.zeros(m.nx), "P0": m.Q_w if P0 is None else P0}
    L = kalman.design(m, n_steps, **start).L
    return np.abs(robust_kalman.design(m, n_steps, c=c, **start).L - L).max() / np.abs(L).max()


@pytest.mark.parametrize(("nx", "ny"), [(1, 1), (3, 1), (4, 2)])
def test_a_small_ball_is_the_kalman_filter(nx, ny, rng):
    """Oracle: c -> 0 is Kalman; V - P is of order theta, and theta of order sqrt(c) by (16)."""
    m = random_model(rng, nx, 1, ny)
    at = {c: difference(m, c) for c in (1e-10, 1e-8, 1e-6)}
    assert at[1e-10] < 10.0 * 1e-5  # sqrt(c) times the relative slope of the gains, which is below 10 here
    for small, large in ((1e-10, 1e-8), (1e-8, 1e-6)):
        np.testing.assert_allclose(at[large] / at[small], 10.0, rtol=0.02)  # next order: sqrt(c) = 1e-3


def test_on_the_servo_a_ball_of_1e_10_is_the_kalman_filter(servo):
    """Oracle: c -> 0 is Kalman, on the paper's model; the distance is of order sqrt(c) = 1e-5 and shrinks with it."""
    assert difference(servo, 1e-10, 200) < 10.0 * 1e-5
    assert difference(servo, 1e-14, 200) < 10.0 * 1e-7


def solve_16(P, c):
    """Multiplier by bisection on (16) as printed, with determinant and inverse, in mpmath's precision."""
    low, high = mpmath.mpf(0), 1 / max(mpmath.eigsy(P, eigvals_only=True))
    for _ in range(130):
        theta = (low + high) / 2
        rest = mpmath.eye(P.rows) - theta * P
        inverse = rest**-1
        left = mpmath.log(mpmath.det(rest)) + sum(inverse[i, i] - 1 for i in range(P.rows))
        low, high = (theta, high) if left < c else (low, theta)
    return low


def test_the_recursion_is_theorem_1(rng):
    """Oracle: (13)-(16) written out in 40 digits with explicit inverses."""
    m, c, P0 = random_model(rng, 3, 1, 2), 0.2, random_psd(rng, 3)
    ours = robust_kalman.design(m, 4, x0=np.zeros(3), P0=P0, c=c)
    with mpmath.workdps(40):
        A, C, Q, R, P = (mpmath.matrix(M.tolist()) for M in (m.A, m.C, m.Q_w, m.R_v, P0))
        for k in range(5):
            theta = solve_16(P, c)
            V = (P**-1 - theta * mpmath.eye(3)) ** -1  # (13)
            S = C * V * C.T + R
            L = V * C.T * S**-1  # (14)
            np.testing.assert_allclose(ours.extra["theta"][k], float(theta), rtol=1e-11)
            np.testing.assert_allclose(ours.extra["P_pred"][k], np.array(P.tolist(), dtype=float), rtol=1e-10)
            np.testing.assert_allclose(ours.extra["V"][k], np.array(V.tolist(), dtype=float), rtol=1e-10)
            np.testing.assert_allclose(ours.L[k], np.array(L.tolist(), dtype=float), rtol=1e-10)
            np.testing.assert_allclose(ours.K[k], np.array((A * L).tolist(), dtype=float), rtol=1e-10)
            P = A * V * A.T - A * L * S * L.T * A.T + Q  # (15)


# servo.md section 1: c, theta_0 (digits as printed), theta_bar to 8 decimals, lam_max * theta_bar, L_bar
PUBLISHED = [
    (1e-3, 0.013385, 5e-7, 0.00148145, 0.0400, [0.2189, -0.2293, 0.3223, 1.4533]),
    (1e-1, 0.10500, 5e-6, 0.00245384, 0.3369, [0.4752, 0.4658, 5.9037, 0.8408]),
]


@cache
def published_design(c):
    """The robust filter of servo.md section 1 over 150 s; cached because (16) is solved 1501 times."""
    model = servo_model()
    return robust_kalman.design(model, 1500, x0=np.zeros(4), P0=model.Q_w, c=c)


@pytest.mark.parametrize(("c", "theta_0", "digits", "theta_bar", "x_max", "L_bar"), PUBLISHED)
def test_on_the_servo_the_published_numbers_come_out(c, theta_0, digits, theta_bar, x_max, L_bar):
    """Oracle: the table of servo.md section 1, half a unit of its last digit (L: 1 % of a unit more)."""
    filter_ = published_design(c)
    theta = filter_.extra["theta"]
    np.testing.assert_allclose(theta[0], theta_0, rtol=0, atol=digits)
    np.testing.assert_allclose(theta[-1], theta_bar, rtol=0, atol=5e-9)
    x = theta[-1] * np.linalg.eigvalsh(filter_.extra["P_pred"][-1])[-1]
    np.testing.assert_allclose(x, x_max, rtol=0, atol=5e-5)
    np.testing.assert_allclose(filter_.L[-1, :, 0], L_bar, rtol=0, atol=5.05e-5)


@pytest.mark.parametrize(("c", "seconds"), [(1e-3, 29.0), (1e-1, 9.3)])
def test_on_the_servo_the_gain_settles_when_published(c, seconds):
    """Oracle: servo.md section 1, "converged (1e-3) after", as the last time an entry of L is off by more.

    By more than 1e-3 of the largest entry, that is; of the norms tried, this one gives all published times.
    """
    L = published_design(c).L[:, :, 0]
    off = np.abs(L - L[-1]).max(axis=1) > 1e-3 * np.abs(L[-1]).max()
    np.testing.assert_allclose(0.1 * np.flatnonzero(off)[-1], seconds, **ROUND)


def test_the_half_is_a_ball_of_twice_the_radius(servo):
    """Oracle: bit for bit the filter of 2 c; servo.md 3.3: theta_bar(0.1) = 0.00245512 to half a unit."""
    start = {"x0": np.zeros(4), "P0": servo.Q_w}
    half = robust_kalman.design(servo, 1500, c=0.1, kl="half", **start)
    np.testing.assert_array_equal(half.L, robust_kalman.design(servo, 1500, c=0.2, **start).L)
    np.testing.assert_allclose(half.extra["theta"][-1], 0.00245512, rtol=0, atol=5e-9)


@pytest.mark.parametrize("tau", [0.0, 0.3, 0.9, 1.0])
def test_every_member_of_the_family_has_the_kalman_limit(tau, rng):
    """Oracle: c -> 0 is Kalman; divergences of the family agree to second order, so the distances do, too."""
    m = random_model(rng, 3, 1, 2)
    start = {"x0": np.zeros(3), "P0": m.Q_w}
    L, by_kl = (design(m, 30, **start).L for design in (kalman.design, partial(robust_kalman.design, c=1e-10)))
    near = robust_kalman.design(m, 30, c=1e-10, tau=tau, **start).L
    np.testing.assert_allclose(near - L, by_kl - L, rtol=0, atol=1e-4 * np.abs(by_kl - L).max())  # next: sqrt(c) = 1e-5


@pytest.mark.parametrize("tau", [1e-9, 1.0 - 1e-9])
def test_the_filter_is_continuous_at_the_ends_of_the_family(tau, servo):
    """Oracle: tau -> 0 is (13), tau -> 1 is (19), down to 1e-9 times the sensitivity."""
    start = {"x0": np.zeros(4), "P0": servo.Q_w}
    near = robust_kalman.design(servo, 200, c=0.1, tau=tau, **start).L
    end = robust_kalman.design(servo, 200, c=0.1, tau=float(round(tau)), **start).L
    assert 0.0 < np.abs(near - end).max() < 1e-7 * np.abs(end).max()


def test_the_other_end_of_the_family_is_19(rng):
    """Oracle: V = F exp(theta F'F) F' by SciPy, theta from tr[exp(x)(x - 1) + 1] = c by brentq, then (14), (15)."""
    m, c, P = random_model(rng, 3, 1, 2), 0.2, random_psd(rng, 3)
    ours = robust_kalman.design(m, 6, x0=np.zeros(3), P0=P, c=c, tau=1.0)
    for k in range(7):
        F, lam = np.linalg.cholesky(P), np.linalg.eigvalsh(P)
        theta = brentq(lambda t, lam=lam: np.sum(np.exp(t * lam) * (t * lam - 1.0) + 1.0) - c, 0.0, 5.0 / lam[-1])
        V = F @ expm(theta * F.T @ F) @ F.T
        S = m.C @ V @ m.C.T + m.R_v
        L = V @ m.C.T @ np.linalg.inv(S)
        np.testing.assert_allclose(ours.extra["theta"][k], theta, rtol=1e-9)
        np.testing.assert_allclose(ours.L[k], L, atol=1e-9)
        P = m.A @ V @ m.A.T - m.A @ L @ S @ L.T @ m.A.T + m.Q_w


def test_a_certain_start_is_allowed(rng):
    """Oracle: P_0 = 0 gives V_0 = 0, L_0 = 0 and P_1 = Q_w."""
    m = random_model(rng, 3)
    filter_ = robust_kalman.design(m, 2, x0=np.zeros(3), P0=np.zeros((3, 3)), c=0.1)
    np.testing.assert_array_equal(filter_.L[0], np.zeros((3, 1)))
    np.testing.assert_allclose(filter_.extra["P_pred"][1], m.Q_w, atol=1e-15)
