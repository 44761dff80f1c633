"""The tau family of divergences: what is derived in divergence.py, against its definition by other means.

Definition used here, for covariances V and P = F F' with the Cholesky root F and S = F^-1 V F^-T (0 < tau < 1):
D = tr[-S^tau / (tau (1 - tau)) + S / (1 - tau) + I / tau]; tau = 0: -log det S + tr(S - I), which is (16); tau = 1:
tr(S log S - S + I).
"""

import mpmath
import numpy as np
import pytest
from conftest import random_psd
from scipy.linalg import eigh, expm, fractional_matrix_power
from scipy.optimize import brentq

from rmpc_bench.numerics.divergence import inflate, inflate_to_radius, multiplier, right_side, solve_stretch
from rmpc_bench.numerics.linalg import psd_sqrt

TAUS = [0.0, 1e-3, 0.3, 0.5, 0.9, 1.0 - 1e-3, 1.0]
family = pytest.mark.parametrize("tau", TAUS)
RADII = pytest.mark.parametrize("c", [1e-3, 1e-1, 1.0, 10.0])


def divergence(V, P, tau):
    """The definition, by the eigenvalues of V against P."""
    s = eigh(V, P, eigvals_only=True)
    if tau == 0.0:
        return np.sum(s - 1.0 - np.log(s))
    if tau == 1.0:
        return np.sum(s * np.log(s) - s + 1.0)
    return np.sum(-(s**tau) / (tau * (1.0 - tau)) + s / (1.0 - tau) + 1.0 / tau)


@family
@RADII
def test_V_lies_on_the_sphere(tau, c, rng):
    """Oracle: the definition, by SciPy's generalised eigenvalues."""
    P = random_psd(rng, 4, 20.0)
    V = inflate_to_radius(psd_sqrt(P), c, tau).V
    np.testing.assert_array_equal(V, V.T)
    scale = min(max(tau, 1e-3), 1.0) * min(max(1.0 - tau, 1e-3), 1.0)  # the definition is a difference of 1 / scale
    np.testing.assert_allclose(divergence(V, P, tau), c, rtol=1e-12, atol=1e-14 / scale)


@family
@RADII
def test_a_variance_grows_to_the_edge_of_the_ball(tau, c):
    """Oracle: brute force; for n = 1 the largest V of the ball is where the divergence, grown from V = P, meets c."""
    edge = brentq(lambda s: divergence(np.array([[3.0 * s]]), np.array([[3.0]]), tau) - c, 1.0 + 1e-9, 1e3, xtol=1e-14)
    np.testing.assert_allclose(inflate_to_radius(psd_sqrt(np.array([[3.0]])), c, tau).V, [[3.0 * edge]], rtol=1e-9)


@family
@RADII
def test_no_other_covariance_of_the_ball_has_a_larger_trace(tau, c, rng):
    """Oracle: 200 random covariances on the sphere, half of them near V."""
    P = random_psd(rng, 3, 10.0)
    V = inflate_to_radius(psd_sqrt(P), c, tau).V
    root = np.linalg.cholesky(P)
    lam, U = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, V).T))
    best = (U * np.log(lam)) @ U.T
    for trial in range(100):
        D = rng.standard_normal((3, 3)) * rng.choice([0.01, 0.1, 0.5])
        lam, U = np.linalg.eigh((D + D.T) + (best if trial % 2 else 0.0))
        lam *= np.sign(lam[-1])  # some direction must grow, or the edge is never reached

        def at(t, lam=lam, U=U):
            return root @ (U * np.exp(np.maximum(t * lam, -20.0))) @ U.T @ root.T  # positive beyond rounding

        upper = 0.1
        while divergence(at(upper), P, tau) < c:
            upper *= 2.0
        other = at(brentq(lambda t, at=at: divergence(at(t), P, tau) - c, 0.0, upper, xtol=1e-13))
        assert np.trace(other) <= np.trace(V) * (1.0 + 1e-9)  # brentq


@family
@RADII
def test_theta_is_the_price_of_the_radius(tau, c, rng):
    """Oracle: the multiplier by the envelope theorem, d tr(V) / dc = 1 / theta, by numerical differentiation."""
    P, h = random_psd(rng, 4, 20.0), 1e-4 * c
    ahead, behind = (np.trace(inflate_to_radius(psd_sqrt(P), c + step, tau).V) for step in (h, -h))
    theta = inflate_to_radius(psd_sqrt(P), c, tau).theta
    np.testing.assert_allclose((ahead - behind) / (2.0 * h), 1.0 / theta, rtol=1e-7)  # h^2 and the rounding over h


@family
def test_V_is_the_function_of_the_cholesky_factor(tau, rng):
    """Oracle: V = F (I - theta (1 - tau) F'F)^(-1/(1 - tau)) F', (13) and (19), by SciPy's matrix functions."""
    P = random_psd(rng, 4, 20.0)
    F = np.linalg.cholesky(P)
    for theta in (0.05, 0.6):  # the largest eigenvalue of P is 1
        if tau == 1.0:
            middle = expm(theta * F.T @ F)
        else:
            middle = fractional_matrix_power(np.eye(4) - theta * (1.0 - tau) * F.T @ F, -1.0 / (1.0 - tau))
        np.testing.assert_allclose(
            inflate(psd_sqrt(P), theta, tau).V, F @ middle @ F.T, rtol=1e-9
        )  # tau near 1: a high power


def exact(lam, c, tau):
    """Theta and the eigenvalues of V in 60 digits, by bisection on the multiplier equation of servo.md section 6."""
    lam, c, tau = [mpmath.mpf(value) for value in lam], mpmath.mpf(c), mpmath.mpf(tau)

    def left(theta):
        x = [theta * value for value in lam]
        if tau == 1:
            return sum(mpmath.exp(value) * (value - 1) + 1 for value in x)
        z = [1 - (1 - tau) * value for value in x]
        if tau == 0:
            return sum(mpmath.log(value) + 1 / value - 1 for value in z)
        power = tau / (tau - 1)
        return sum(-(v**power) / (tau * (1 - tau)) + v ** (1 / (tau - 1)) / (1 - tau) + 1 / tau for v in z)

    low, high = mpmath.mpf(0), (1 / (1 - tau) if tau < 1 else mpmath.mpf(100)) / max(lam)
    high = min(high, 100 / max(lam))  # no radius here needs more
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if left(middle) < c else (low, middle)
    stretch = mpmath.exp if tau == 1 else lambda x: (1 - (1 - tau) * x) ** (-1 / (1 - tau))
    return float(low), [float(value * stretch(low * value)) for value in lam]


@pytest.mark.parametrize("tau", [0.0, 1e-12, 0.3, 0.9, 1.0 - 1e-9, 1.0])
@pytest.mark.parametrize("c", [1e-9, 1e-3, 0.08, 1.0, 100.0])
def test_digits(tau, c):
    """Oracle: the multiplier equation in 60 digits; what is promised is 2e-15."""
    for lam in ([1.0], [0.0, 1e-8, 0.3, 1.0], [1e-3, 0.5, 0.9, 1.0], [2.0, 2.0]):
        with mpmath.workdps(60):
            theta, stretched = exact(lam, c, tau)
        inflation = inflate_to_radius(psd_sqrt(np.diag(lam)), c, tau)
        np.testing.assert_allclose(inflation.theta, theta, rtol=2e-15)
        np.testing.assert_allclose(np.diag(inflation.V), stretched, rtol=2e-15)


@pytest.mark.parametrize(("end", "inward"), [(0.0, 1.0), (1.0, -1.0)])
@RADII
def test_the_ends_of_the_family_are_limits(end, inward, c, rng):
    """Oracle: continuity; the distance to the end is proportional to that of tau, down to rounding."""
    P = random_psd(rng, 4, 20.0)
    at_end = inflate_to_radius(psd_sqrt(P), c, end)
    off = []
    for h in (1e-4, 1e-6, 1e-8):
        near = inflate_to_radius(psd_sqrt(P), c, end + inward * h)
        off.append(abs(near.theta / at_end.theta - 1.0))
        assert np.abs(near.V - at_end.V).max() <= 10.0 * h * np.abs(at_end.V).max()
    np.testing.assert_allclose([off[0] / off[1], off[1] / off[2]], 100.0, rtol=1e-3)
    for tiny in (1e-16, 1e-300, 5e-324):  # and nothing is lost on the last steps
        nearly = inflate_to_radius(psd_sqrt(P), c, end + inward * tiny)
        np.testing.assert_allclose(nearly.theta, at_end.theta, rtol=3e-15)


@family
def test_a_small_ball_has_the_multiplier_of_its_expansion(tau, rng):
    """Oracle: to leading order the divergence is tr(S - I)^2 / 2 for every tau, so theta^2 tr(P^2) / 2 = c."""
    P = random_psd(rng, 3)
    for c in (1e-10, 1e-20, 1e-40, 1e-200):
        theta = inflate_to_radius(psd_sqrt(P), c, tau).theta
        np.testing.assert_allclose(theta, np.sqrt(2.0 * c / np.trace(P @ P)), rtol=3.0 * np.sqrt(c) + 1e-14)


@family
def test_a_huge_ball_still_has_a_multiplier(tau):
    """Oracle: the definition for one variance; no pole and no overflow up to c = 1e30."""
    for c in (1e3, 1e10, 1e30):
        s = np.exp(solve_stretch([1.0], c, tau))
        np.testing.assert_allclose(divergence(np.array([[s]]), np.eye(1), tau), c, rtol=1e-11)  # tau (1 - tau) >= 1e-3
        assert 0.0 < multiplier(np.log(s), tau) <= (1.0 / (1.0 - tau) if tau < 1.0 else np.inf)


def test_above_zero_large_covariances_are_defined_longer():
    """Oracle: the pole theta (1 - tau) lambda = 1 moves out, and at tau = 1 there is none but overflow."""
    P = np.diag([1.0, 2.0])
    with pytest.raises(ValueError, match=r"1 - tau.* is not below 1"):
        inflate(psd_sqrt(P), 1.0, 0.5)
    np.testing.assert_allclose(inflate(psd_sqrt(P), 0.9, 0.5).V, np.diag([0.55**-2.0, 2.0 * 0.1**-2.0]), rtol=1e-13)
    np.testing.assert_allclose(
        inflate(psd_sqrt(P), 100.0, 1.0).V, np.diag(np.exp([100.0, 200.0 + np.log(2.0)])), rtol=1e-13
    )
    with pytest.raises(ValueError, match="overflows"):
        inflate(psd_sqrt(P), 200.0, 1.0)
    np.testing.assert_array_equal(inflate(psd_sqrt(np.zeros((2, 2))), 1.0, 1.0).V, np.zeros((2, 2)))


def test_the_half_doubles_the_radius():
    """Oracle: with its factor 1/2 the left side of (16) equals c where without it it equals 2 c."""
    assert right_side(0.1, "printed") == 0.1
    assert right_side(0.1, "half") == 0.2
