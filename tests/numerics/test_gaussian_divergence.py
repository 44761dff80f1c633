"""The divergence of normal densities: its definition, its parts, its limits."""

import numpy as np
import pytest
from conftest import ROUND, SOLVER, random_psd

from rmpc_bench.numerics.divergence import covariance_part, mean_part


def test_definition_in_one_dimension():
    """Both parts together are the integral of f~ log(f~ / f)."""
    from scipy.integrate import quad
    from scipy.stats import norm

    m_true, s_true, m, s = 0.3, 0.7, -0.2, 1.1

    def integrand(z):
        return norm.pdf(z, m_true, s_true) * (norm.logpdf(z, m_true, s_true) - norm.logpdf(z, m, s))

    K_true, K = np.array([[s_true**2]]), np.array([[s**2]])
    both = covariance_part(K_true, K) + mean_part(np.array([[(m_true - m) ** 2]]), K)
    np.testing.assert_allclose(both, quad(integrand, -10, 10)[0], **SOLVER)


def test_formula(rng):
    """The printed expression with trace, determinant and inverse."""
    K_true, K, dm = random_psd(rng, 4), random_psd(rng, 4), rng.standard_normal(4)
    ratio = np.linalg.solve(K, K_true)
    expected = 0.5 * (np.trace(ratio) - 4 - np.linalg.slogdet(ratio)[1])
    np.testing.assert_allclose(covariance_part(K_true, K), expected, **ROUND)
    np.testing.assert_allclose(mean_part(np.outer(dm, dm), K), 0.5 * dm @ np.linalg.solve(K, dm), **ROUND)


def test_same_densities_do_not_diverge(rng):
    """Zero up to the square of the rounding of an eigenvalue."""
    K = random_psd(rng, 4, condition=1e4)
    assert 0.0 <= covariance_part(K, K) <= 1e-20
    assert mean_part(np.zeros((4, 4)), K) == 0.0


def test_units_do_not_matter(rng):
    """Both parts are the same after any change of coordinates."""
    K_true, K, moment = random_psd(rng, 3), random_psd(rng, 3), random_psd(rng, 3, rank=1)
    T = np.diag([1e-3, 1.0, 1e3]) @ (np.eye(3) + 0.3 * rng.standard_normal((3, 3)))
    for part, first in ((covariance_part, K_true), (mean_part, moment)):
        # 1e-8: rounding times the condition number of T, which is about 1e6
        np.testing.assert_allclose(part(T @ first @ T.T, T @ K @ T.T), part(first, K), rtol=1e-8)


def test_batches(rng):
    """Axes in front are kept, and a single K serves all."""
    K = random_psd(rng, 3)
    many = np.stack([random_psd(rng, 3) for _ in range(4)])
    for part in (covariance_part, mean_part):
        np.testing.assert_allclose(part(many, K[None]), [part(each, K) for each in many], **ROUND)


def test_singular_covariances(rng):
    """A truth that is certain of something is infinitely far; a belief that is, has no density."""
    full, flat = np.eye(2), np.diag([1.0, 0.0])
    assert covariance_part(flat, full) == np.inf
    with pytest.raises(np.linalg.LinAlgError):
        covariance_part(full, flat)
