"""Lemma 1: the density that nature chooses, its divergence and that no other of the ball does more harm.

The printed (16) has no factor 1/2.  The Kullback-Leibler divergence (10) of two Gaussians has one, so a ball whose
multiplier solves (16) with c on the right holds the densities with D <= c / 2 (servo.md, section 4, point 6).
"""

import numpy as np
import pytest
from conftest import random_psd
from scipy.optimize import brentq

from rmpc_bench.numerics.kl_ball import inflate_to_radius


def divergence(K, K_nominal, shift=0.0):
    """Divergence (10) of N(m + shift, K) from N(m, K_nominal)."""
    ratio = np.linalg.solve(K_nominal, K)
    shift = np.broadcast_to(shift, len(K))
    mean_part = shift @ np.linalg.solve(K_nominal, shift)
    return 0.5 * (np.trace(ratio) - len(K) - np.linalg.slogdet(ratio)[1] + mean_part)


def nominal_and_worst(rng, n, p, c):
    """Random K_z, the estimator's gain G = K_xy K_y^-1, the worst K_z of (24) and V."""
    K = random_psd(rng, n + p, 20.0)
    G = np.linalg.solve(K[n:, n:], K[n:, :n]).T
    P = K[:n, :n] - G @ K[n:, :n]  # (25)
    V = inflate_to_radius(P, c).V
    worst = K.copy()
    worst[:n, :n] += V - P  # (24), (25)
    return K, G, worst, V


SIZES = pytest.mark.parametrize(("n", "p"), [(1, 1), (3, 1), (4, 2)])
RADII = pytest.mark.parametrize("c", [1e-4, 1e-1, 10.0])


@SIZES
@RADII
def test_the_worst_density_lies_half_of_c_away(n, p, c, rng):
    """Oracle: closed form of the divergence of two Gaussians on the whole vector z = (x, y)."""
    K, _, worst, _ = nominal_and_worst(rng, n, p, c)
    np.testing.assert_allclose(divergence(worst, K), c / 2.0, rtol=1e-8)  # 1e-4 is a difference of numbers near 1


@SIZES
@RADII
def test_no_other_density_of_the_ball_does_more_harm(n, p, c, rng):
    """Oracle: the definition (23): 300 random Gaussians on the sphere D = c/2, means moved too."""
    K, G, worst, V = nominal_and_worst(rng, n, p, c)
    error = np.hstack([np.eye(n), -G])  # x - g(y) = error (z - m)

    def harm(K_z, shift):
        return np.trace(error @ K_z @ error.T) + np.sum((error @ shift) ** 2)

    np.testing.assert_allclose(harm(worst, np.zeros(n + p)), np.trace(V), rtol=1e-9)
    root = np.linalg.cholesky(K)
    for _ in range(300):
        # Around the nominal or around the worst density, which is the harder test.
        centre = worst if rng.random() < 0.5 else K
        D = rng.standard_normal((n + p, n + p))
        push = root @ (D + D.T) @ root.T * rng.uniform(0.0, 0.3)
        shift = root @ rng.standard_normal(n + p) * rng.choice([0.0, 0.1])
        other = centre - K + push

        def density(t, other=other, shift=shift):
            lam, U = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, K + t * other).T))
            return root @ (U * np.maximum(lam, 1e-3)) @ U.T @ root.T, t * shift  # kept positive definite

        def excess(t, density=density):
            K_z, mean = density(t)
            return divergence(K_z, K, mean) - c / 2.0

        upper = 1.0
        while excess(upper) < 0.0:
            upper *= 2.0
        assert harm(*density(brentq(excess, 0.0, upper, xtol=1e-13))) <= np.trace(V) * (1.0 + 1e-8)


def test_the_bayes_estimator_is_the_same_under_both_densities(rng):
    """Oracle: (24) leaves K_xy and K_y alone, so (27) does not change."""
    K, G, worst, _ = nominal_and_worst(rng, 3, 2, 0.5)
    np.testing.assert_allclose(np.linalg.solve(worst[3:, 3:], worst[3:, :3]).T, G, rtol=1e-12)
    assert np.linalg.eigvalsh(worst)[0] > 0.0
    assert np.linalg.eigvalsh(worst - K)[0] > -1e-12
