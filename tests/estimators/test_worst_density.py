"""Lemma 1 and Theorem 1: the density that nature chooses, its divergence, its harm, and the filter under it.

The printed (16) has no factor 1/2.  The Kullback-Leibler divergence (10) of two Gaussians has one, so a ball whose
multiplier solves (16) with c on the right holds the densities with D <= c / 2 (servo.md, section 4, point 6).
"""

import numpy as np
import pytest
from conftest import STAT, random_model, random_psd, within_stat
from scipy.linalg import block_diag
from scipy.optimize import brentq

from rmpc_bench.controllers import mpc
from rmpc_bench.estimators import kalman, risk_sensitive, robust_kalman
from rmpc_bench.numerics.divergence import inflate_to_radius
from rmpc_bench.numerics.linalg import psd_sqrt


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
    V = inflate_to_radius(psd_sqrt(P), c).V
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


FILTERS = {
    "robust": (robust_kalman.design, {"c": 0.1}),
    "robust-half": (robust_kalman.design, {"c": 1.0, "kl": "half"}),
    "robust-tau": (robust_kalman.design, {"c": 0.5, "tau": 1.0}),
    "risk-sensitive": (risk_sensitive.design, {"theta": 0.1}),
}
STEPS, RUNS = 10, 20_000


@pytest.fixture(params=FILTERS)
def loop(request):
    """Return a model, one of the filters and a predictive controller that closes the loop around it."""
    model = random_model(np.random.default_rng(8), 3, 2, 2)
    design, parameters = FILTERS[request.param]
    filter_ = design(model, STEPS, x0=np.ones(3), P0=np.diag([1.0, 0.5, 0.2]), **parameters)
    return model, filter_, mpc.design(model, Hp=5, Hu=2, Q=1.0, R=0.1)


def test_an_input_made_from_the_measurements_changes_no_covariance(loop):
    """Oracle: (28)-(34) written out with the feedback J_t = -K_x L_t; K_y, P(t+1) and the divergence are as without."""
    m, filter_, controller = loop
    V, P_pred = filter_.extra["V"], filter_.extra["P_pred"]
    for k in range(STEPS):
        J = -controller.K_x @ filter_.L[k]
        to_z = np.vstack([m.A + m.B @ J @ m.C, m.C])  # (30), the noises w and v instead of G v and D v
        noise = np.block([[np.eye(3), m.B @ J], [np.zeros((2, 3)), np.eye(2)]])
        K_z = to_z @ V[k] @ to_z.T + noise @ block_diag(m.Q_w, m.R_v) @ noise.T
        G = np.linalg.solve(K_z[3:, 3:], K_z[3:, :3]).T
        np.testing.assert_allclose(G, filter_.K[k] + m.B @ J, atol=1e-12)  # the input is known: x_pred moves with it
        np.testing.assert_allclose(K_z[:3, :3] - G @ K_z[3:, :3], P_pred[k + 1], atol=1e-12)  # (34)
        worst = K_z + block_diag(V[k + 1] - P_pred[k + 1], np.zeros((2, 2)))  # (32)
        ratio = np.linalg.eigvals(np.linalg.solve(K_z, worst))
        without = np.linalg.eigvals(np.linalg.solve(P_pred[k + 1], V[k + 1]))
        np.testing.assert_allclose(np.sort(np.abs(ratio))[2:], np.sort(np.abs(without)), rtol=1e-9)
        np.testing.assert_allclose(np.sort(np.abs(ratio))[:2], 1.0, rtol=1e-9)


def test_under_the_worst_density_the_closed_loop_has_the_covariance_V(loop):
    """Oracle: Monte Carlo of Theorem 1's last sentence: e_t is Gaussian with mean 0 and covariance V_t, input and all.

    Given the past, (31) differs from the nominal density by the covariance V - P_pred of x(t+1) alone: nature adds
    independent noise of that covariance.  The filter and the controller are run as in the bench.
    """
    m, filter_, controller = loop
    rng = np.random.default_rng(20180420)
    V, P_pred = filter_.extra["V"], filter_.extra["P_pred"]
    state, memory = filter_.init(RUNS), controller.init(RUNS)
    r = np.sin(np.arange(STEPS + controller.preview))[:, None] * [1.0, -2.0]
    x = filter_.x0 + rng.standard_normal((RUNS, 3)) @ psd_sqrt(V[0])
    last = np.zeros((RUNS, 2))
    for k in range(STEPS + 1):
        e = x - state.x_pred
        assert within_stat(e, 0.0)
        assert within_stat(e[:, :, None] * e[:, None, :], V[k])
        assert not within_stat(np.sum(e**2, axis=1), np.trace(P_pred[k]))  # so the test would tell
        assert within_stat(e[:, :, None] * last[:, None, :], 0.0)  # the past says nothing about the error
        fourth = np.einsum("ri,ij,rj->r", e, np.linalg.inv(V[k]), e) ** 2  # chi-squared with 3 degrees: 3 * (3 + 2)
        assert within_stat(fourth, 15.0)
        y = x @ m.C.T + rng.standard_normal((RUNS, 2)) @ psd_sqrt(m.R_v)
        state, estimate = filter_.correct(k, state, y)
        assert within_stat((estimate.x_hat - x)[:, :, None] * (estimate.x_hat - x)[:, None, :], filter_.P[k])
        memory, command = controller.control(k, memory, y, estimate, r[k : k + controller.preview])
        if k < STEPS:
            x = x @ m.A.T + command.u @ m.B.T + rng.standard_normal((RUNS, 3)) @ psd_sqrt(m.Q_w)
            x += rng.standard_normal((RUNS, 3)) @ psd_sqrt(V[k + 1] - P_pred[k + 1])
            state, last = filter_.predict(k, state, command.u), state.e
    assert np.std(command.u) > STAT / np.sqrt(RUNS)  # there was an input, and it depended on the measurements


def test_under_the_worst_density_the_kalman_filter_does_worse(loop):
    """Oracle: (12): V_1 is what nature can do to the robust predictor and less than what it does to another gain."""
    m, filter_, _ = loop
    other = kalman.design(m, STEPS, x0=filter_.x0, P0=filter_.extra["P_pred"][0])
    V, P_pred = filter_.extra["V"], filter_.extra["P_pred"]
    rest = m.A - other.K[0] @ m.C
    error = rest @ V[0] @ rest.T + other.K[0] @ m.R_v @ other.K[0].T + m.Q_w + V[1] - P_pred[1]
    assert np.trace(error) > np.trace(V[1])
