"""The Kullback-Leibler ball against 60-digit arithmetic, Lambert's W and properties."""

import mpmath
import numpy as np
import pytest
from conftest import ROUND, random_psd
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import lambertw

from rmpc_bench.numerics.divergence import inflate, inflate_to_radius
from rmpc_bench.numerics.linalg import psd_sqrt

RADII = [1e-6, 1e-4, 1e-2, 1e-1, 1.0, 10.0, 100.0]


def residual(P, theta, c):
    """Relative residual of (16) as printed, in 60 digits, from P itself by determinant and inverse."""
    with mpmath.workdps(60):
        n = len(P)
        rest = mpmath.eye(n) - mpmath.mpf(theta) * mpmath.matrix(P.tolist())
        inverse = rest**-1
        left = mpmath.log(mpmath.det(rest)) + sum(inverse[i, i] - 1 for i in range(n))
        return float(abs(left - c) / c)


@pytest.mark.parametrize("c", RADII)
@pytest.mark.parametrize(("condition", "rank"), [(1.0, None), (1e3, None), (1e8, None), (1e2, 1), (1e2, 3)])
def test_theta_solves_the_printed_equation(c, condition, rank, rng):
    """Oracle: (16) itself, -log det(I - theta P)^-1 + tr[(I - theta P)^-1 - I] = c, in 60 digits."""
    for scale in (1e-12, 1.0, 1e12):
        P = scale * random_psd(rng, 4, condition, rank)
        found = inflate_to_radius(psd_sqrt(P), c)
        V, theta = found.V, found.theta
        assert 0.0 < theta * np.linalg.eigvalsh(P)[-1] < 1.0
        assert residual(P, theta, c) <= 1e-11
        np.testing.assert_allclose(V, exact_inflation(P, theta), rtol=0, atol=1e-12 * np.abs(V).max())


def exact_inflation(P, theta):
    """V = P (I - theta P)^-1 in 60 digits, the form of (13) that needs no inverse of P."""
    with mpmath.workdps(60):
        exact = mpmath.matrix(P.tolist())
        V = exact * (mpmath.eye(len(P)) - mpmath.mpf(theta) * exact) ** -1
        return np.array(V.tolist(), dtype=float)


@pytest.mark.parametrize("c", [1e-2, 1e-1, 1.0, 10.0, 100.0])
def test_a_variance_is_inflated_in_closed_form(c):
    """Oracle: for n = 1, z = V/P solves z e^-z = e^-(1+c), so z = -W_-1(-e^-(1+c))."""
    z = -lambertw(-np.exp(-(1.0 + c)), -1).real
    np.testing.assert_allclose(inflate_to_radius(psd_sqrt(np.array([[3.0]])), c).V, [[3.0 * z]], **ROUND)


def test_a_certain_state_stays_certain():
    """Oracle: nature cannot move a point mass within a finite divergence."""
    found = inflate_to_radius(psd_sqrt(np.zeros((3, 3))), 0.1)
    V, theta = found.V, found.theta
    np.testing.assert_array_equal(V, np.zeros((3, 3)))
    assert theta == 0.0


def test_directions_without_variance_stay_without(rng):
    """Oracle: V and P have the same kernel."""
    P = random_psd(rng, 4, 10.0, rank=2)
    kernel = np.linalg.eigh(P)[1][:, :2]
    np.testing.assert_allclose(inflate_to_radius(psd_sqrt(P), 1.0).V @ kernel, 0.0, atol=1e-14)


def test_V_is_the_inverse_of_the_reduced_information(rng):
    """Oracle: (13) by explicit inverses where these are harmless."""
    P = random_psd(rng, 4, 10.0)
    for c in (1e-3, 0.1, 1.0):
        found = inflate_to_radius(psd_sqrt(P), c)
        V, theta = found.V, found.theta
        by_inverses = np.linalg.inv(np.linalg.inv(P) - theta * np.eye(4))
        np.testing.assert_allclose(V, by_inverses, rtol=1e-11)  # inverses of condition 10
        np.testing.assert_allclose(inflate(psd_sqrt(P), theta).V, by_inverses, rtol=1e-11)


@settings(max_examples=60)
@given(st.integers(1, 5), st.floats(-6.0, 2.0), st.floats(1e-3, 2.0), st.floats(0.0, 8.0), st.integers(0, 2**31))
def test_a_larger_ball_gives_a_larger_covariance(n, log_c, step, log_condition, seed):
    """Oracle: theta and V (in the order of matrices) increase with c, and V exceeds P."""
    P = random_psd(np.random.default_rng(seed), n, 10.0**log_condition)
    small, large = inflate_to_radius(psd_sqrt(P), 10.0**log_c), inflate_to_radius(psd_sqrt(P), 10.0 ** (log_c + step))
    assert 0.0 < small.theta < large.theta
    for V, below in ((large.V, small.V), (small.V, P)):
        assert np.linalg.eigvalsh(V - below)[0] >= -1e-13 * np.abs(V).max()  # rounding of the eigenvalues


@settings(max_examples=30)
@given(st.integers(1, 5), st.floats(-6.0, 2.0), st.floats(-20.0, 20.0), st.integers(0, 2**31))
def test_units_do_not_matter(n, log_c, log_scale, seed):
    """Oracle: theta scales as 1/P and V as P."""
    P, scale = random_psd(np.random.default_rng(seed), n), 10.0**log_scale
    one, other = inflate_to_radius(psd_sqrt(P), 10.0**log_c), inflate_to_radius(psd_sqrt(scale * P), 10.0**log_c)
    np.testing.assert_allclose(other.theta * scale, one.theta, rtol=1e-11)  # of 1e2 times rounding, at c = 100
    np.testing.assert_allclose(other.V, scale * one.V, rtol=0, atol=1e-11 * np.abs(other.V).max())


def test_a_small_ball_has_the_multiplier_of_its_expansion(rng):
    """Oracle: the left side of (16) is theta^2 tr(P^2) / 2 to leading order."""
    P = random_psd(rng, 3)
    for c in (1e-10, 1e-14, 1e-20):
        theta = inflate_to_radius(psd_sqrt(P), c).theta
        np.testing.assert_allclose(theta, np.sqrt(2.0 * c / np.trace(P @ P)), rtol=3.0 * np.sqrt(c) + 1e-12)


def test_beyond_the_pole_there_is_no_V():
    """Oracle: theta lambda_max = 1 makes P^-1 - theta I singular."""
    with pytest.raises(ValueError, match="not below 1"):
        inflate(psd_sqrt(np.diag([1.0, 2.0])), 0.5)
    np.testing.assert_allclose(inflate(psd_sqrt(np.diag([1.0, 2.0])), 0.25).V, np.diag([4.0 / 3.0, 4.0]), **ROUND)
