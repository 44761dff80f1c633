"""Moments of f(x): exact for what is linear or quadratic, those of filterpy for the rest, run by run the same bits."""

import numpy as np
import pytest
from conftest import EXACT, ROUND, random_psd
from filterpy.kalman import CubatureKalmanFilter, JulierSigmaPoints, MerweScaledSigmaPoints, unscented_transform

from rmpc_bench.numerics.moment_transform import CentralDifferences, SigmaPoints, covariance_root

RULES = [SigmaPoints(), SigmaPoints(0.5, 2.0, 1.0), SigmaPoints(1e-3), CentralDifferences(), CentralDifferences(1e-4)]


def curved(x):
    """Map R^3 to R^2 smoothly, without symmetry."""
    return np.stack([np.sin(x[..., 0]) * x[..., 1], np.exp(-x[..., 2]) + x[..., 0] ** 2], axis=-1)


def gaussians(rng, runs, n=3):
    """Return means and covariances of some runs."""
    return rng.standard_normal((runs, n)), np.stack([random_psd(rng, n) for _ in range(runs)])


def covariance(found):
    """Covariance of f(x)."""
    less = 0.0 if found.minus is None else np.einsum("ri,rj->rij", found.minus, found.minus)
    return found.image @ found.image.mT - less


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_a_linear_map_is_exact(rng, rule):
    """Oracle: the algebra, A x + b and A P A'."""
    A, b = rng.standard_normal((2, 3)), rng.standard_normal(2)
    x, P = gaussians(rng, 4)
    found = rule.moments(lambda z: np.einsum("ij,rpj->rpi", A, z) + b, x, np.linalg.cholesky(P))
    # Differences over 1e-3 or 1e-4 of the standard deviation have four digits less than numbers have.
    loose = {"rtol": 1e-9, "atol": 1e-9}
    np.testing.assert_allclose(found.mean, x @ A.T + b, **loose)
    np.testing.assert_allclose(covariance(found), A @ P @ A.T, **loose)
    np.testing.assert_allclose(found.source @ found.image.mT, P @ A.T, **loose)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (SigmaPoints(0.5, 2.0, 1.0), lambda: MerweScaledSigmaPoints(3, alpha=0.5, beta=2.0, kappa=1.0)),
        (SigmaPoints(1.0, 0.0, 0.7), lambda: JulierSigmaPoints(3, kappa=0.7)),
    ],
    ids=["Merwe", "Julier"],
)
def test_the_points_of_filterpy(rng, ours, theirs):
    """Oracle: unscented_transform of filterpy; a sum with its weights loses some digits."""
    x, P = gaussians(rng, 5)
    found, points = ours.moments(curved, x, np.linalg.cholesky(P)), theirs()
    for i in range(5):
        mean, theirs_P = unscented_transform(curved(points.sigma_points(x[i], P[i])), points.Wm, points.Wc)
        np.testing.assert_allclose(found.mean[i], mean, **ROUND, atol=1e-14)
        np.testing.assert_allclose(covariance(found)[i], theirs_P, **ROUND, atol=1e-14)


def test_the_defaults_are_the_cubature_rule(rng):
    """Oracle: the prediction of filterpy's cubature filter."""
    x, P = gaussians(rng, 5)
    found = SigmaPoints().moments(lambda z: np.concatenate([curved(z), z[..., :1]], axis=-1), x, np.linalg.cholesky(P))
    for i in range(5):
        ckf = CubatureKalmanFilter(3, 1, 1.0, lambda z: z[:1], lambda z, dt: np.append(curved(z), z[0]))
        ckf.x, ckf.P, ckf.Q = x[i], P[i], np.zeros((3, 3))
        ckf.predict()
        np.testing.assert_allclose(found.mean[i], ckf.x.ravel(), **ROUND, atol=1e-14)
        np.testing.assert_allclose(covariance(found)[i], ckf.P, **ROUND, atol=1e-14)


def test_a_square_of_a_gaussian():
    """Oracle: x ~ N(m, s^2) has E x^2 = m^2 + s^2, cov(x, x^2) = 2 m s^2 and, with n + kappa = 3, var x^2 =
    4 m^2 s^2 + 2 s^4.
    """
    m, s2 = np.array([[0.7]]), np.array([[[0.3]]])
    found = SigmaPoints(1.0, 0.0, 2.0).moments(lambda z: z**2, m, np.sqrt(s2))
    np.testing.assert_allclose(found.mean, m**2 + 0.3, **ROUND)
    np.testing.assert_allclose(covariance(found)[0], 4 * m**2 * 0.3 + 2 * 0.3**2, **ROUND)
    np.testing.assert_allclose(found.source[0] @ found.image[0].T, 2 * m * 0.3, **ROUND)
    # A central difference of a square is exact for every step.
    linear = CentralDifferences(1.0).moments(lambda z: z**2, m, np.sqrt(s2))
    np.testing.assert_allclose(linear.image[0], 2 * m * np.sqrt(0.3), **ROUND)
    np.testing.assert_allclose(linear.mean, m**2, **EXACT)


def test_a_narrow_spread_keeps_its_digits(rng):
    """With alpha = 1e-3 the weight of the centre is -1e6; the second moments stay those of the limit alpha -> 0.

    Oracle: mean f + tr(H P) / 2 of the curved map, by its second derivatives.
    """
    x, P = gaussians(rng, 3)
    found = SigmaPoints(1e-3).moments(curved, x, np.linalg.cholesky(1e-2 * P))
    for i, ((a, b, c), Q) in enumerate(zip(x, 1e-2 * P, strict=True)):
        H = np.zeros((2, 3, 3))
        H[0, 0, 0], H[0, 0, 1] = -np.sin(a) * b, np.cos(a)
        H[0, 1, 0], H[1, 0, 0], H[1, 2, 2] = np.cos(a), 2.0, np.exp(-c)
        expected = curved(x[i]) + 0.5 * np.einsum("kij,ij->k", H, Q)
        # A second difference over 1e-4 has an error of 1e-16 / 1e-8; times P, 1e-2.
        np.testing.assert_allclose(found.mean[i], expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_a_row_of_a_block_is_the_row_alone(rng, rule):
    x, P = gaussians(rng, 50)
    root = np.linalg.cholesky(P)
    root[7], root[11] = np.diag([1.0, 0.0, 0.7]), np.nan
    together = rule.moments(curved, x, root)
    for i in (0, 7, 10, 11, 49):
        alone = rule.moments(curved, x[i : i + 1], root[i : i + 1])
        for one, block in zip(alone, together, strict=True):
            if one is not None:
                np.testing.assert_array_equal(one[0], block[i])
    assert np.isnan(covariance(together)[11]).all()
    assert np.isfinite(np.delete(covariance(together), 11, axis=0)).all()


def test_the_root_of_what_is_not_positive_definite(rng):
    """Oracle: S S' is P without its negative eigenvalues; a singular P is not indefinite."""
    singular, U = random_psd(rng, 4, rank=2), np.linalg.qr(rng.standard_normal((4, 4)))[0]
    bad = (U * [3.0, 1.0, 0.5, -0.2]) @ U.T
    root, indefinite = covariance_root(np.stack([singular, bad, np.zeros((4, 4))]))
    product = root @ root.swapaxes(1, 2)
    np.testing.assert_allclose(product[0], singular, rtol=0, atol=1e-12)
    np.testing.assert_allclose(product[1], (U * [3.0, 1.0, 0.5, 0.0]) @ U.T, rtol=0, atol=1e-12)
    assert indefinite.tolist() == [False, True, False] and not product[2].any()


def test_a_step_sees_a_jump_that_a_derivative_does_not():
    """Oracle: dead zone max(|x| - 1, 0) sgn x at 0 with standard deviation 2; the chord over +-2 has the slope 1/2."""
    dead = lambda x: np.sign(x) * np.maximum(np.abs(x) - 1.0, 0.0)  # noqa: E731
    x, P = np.zeros((1, 1)), np.full((1, 1, 1), 4.0)
    assert CentralDifferences(1.0).moments(dead, x, P**0.5).image.item() == 2.0 * 0.5
    assert CentralDifferences(1e-4).moments(dead, x, P**0.5).image.item() == 0.0


@pytest.mark.parametrize("rule", [CentralDifferences(1.0), CentralDifferences()], ids=str)
def test_the_derivative_is_that_of_a_small_step(rule):
    """Oracle: the derivative of sin; a central difference with the best step has about ten digits."""
    x = np.array([[0.3], [1e3]])
    size = 0.0 if rule.spread else 1e-3
    found = rule.moments(np.sin, x, np.full((2, 1, 1), size))
    if size:
        # The step is relative to |x|: 6e-6 and 6e-3, with errors of its square over 6.
        np.testing.assert_allclose(found.image[:, 0, 0] / size, np.cos(x[:, 0]), rtol=1e-4)
        np.testing.assert_allclose(found.image[0, 0, 0] / size, np.cos(0.3), rtol=1e-9)
    else:
        assert not found.image.any()


@pytest.mark.parametrize("keys", [(1.0, 0.0, -1.0), (1.0, -3.0, 0.0)])
def test_weights_without_a_root_leave_a_vector(rng, keys):
    """Oracle: the sum of the covariance with its weights, for kappa < 0 (Julier's 3 - n for n = 4) and beta < 0."""
    x, P = gaussians(rng, 4)
    root, (alpha, beta, kappa) = np.linalg.cholesky(P), keys
    found = SigmaPoints(*keys).moments(curved, x, root)
    c = alpha**2 * (3 + kappa)
    for i in range(4):
        points = np.sqrt(c) * np.concatenate([root[i].T, -root[i].T])
        d = curved(x[i] + points) - curved(x[i])
        m = d.sum(axis=0) / (2 * c)
        expected = d.T @ d / (2 * c) + (beta - alpha**2) * np.outer(m, m)
        np.testing.assert_allclose(covariance(found)[i], expected, **ROUND, atol=1e-13)
