"""The robust Kalman / H-infinity filter: its inequality, its guarantees by brute force, and its limit."""

import numpy as np
import pytest
from conftest import random_psd
from estimators.uncertain_oracles import at, conditional, of_error, random_F, ratio
from scipy.optimize import minimize

from rmpc_bench.estimators.kalman_predictor import design as kalman_predictor
from rmpc_bench.estimators.risk_sensitive import design as risk_sensitive
from rmpc_bench.estimators.robust_h_infinity import design
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.robust_bounded_real import Bounds, Limits, Uncertain, bounded_real_step
from rmpc_bench.numerics.square_root import covariance_of
from rmpc_bench.types import DesignError

N = 6


def system(rng, nx=3, ny=2, size=0.2, **changed):
    """Random system with uncertainty in A and C and correlated noises."""
    # F_hat decorrelates e and x, which makes the bounds of a fast stable system large.
    A = np.eye(nx) + 0.1 * rng.standard_normal((nx, nx))
    given = {
        "A": 0.9 * A / np.abs(np.linalg.eigvals(A)).max(), "B": np.zeros((nx, 1)), "Bw": rng.standard_normal((nx, nx)),
        "C": rng.standard_normal((ny, nx)), "Dw": 0.3 * rng.standard_normal((ny, nx)), "Dv": np.eye(ny),
        "H_A": size * rng.standard_normal((nx, 2)), "H_C": size * rng.standard_normal((ny, 2)),
        "G_x": 0.05 * rng.standard_normal((2, nx)),
        "W": random_psd(rng, nx).tolist(), "V": random_psd(rng, ny).tolist(),
    }  # fmt: skip
    return uncertain_model(N, **given | changed)


def parameters(rng, nx=3, **changed):
    """Start and free parameters with which the bounds exist."""
    given = {"x0": rng.standard_normal(nx), "P0": random_psd(rng, nx), "alpha": 2.0, "theta": 0.01, "weight": 0.8}
    return given | changed


def joint(model):
    """Covariance of [w~; v~] of the nominal model."""
    now = model.at(0)
    return np.block([[now.Q_w, now.S_wv], [now.S_wv.T, now.R_v]])


def bounded_real(model, F, K, P, X, alpha, theta, L):
    """Right side of the inequality for [e; x], every matrix spelt out; the bound diag(P, X) must fulfil it."""
    m, nx = model.system.at(0), len(P)
    F_hat, zero = F - K @ m.C, np.zeros((nx, nx))
    A = np.block([[F_hat, m.A - K @ m.C - F_hat], [zero, m.A]])
    M = np.vstack([m.H_A - K @ m.H_C, m.H_A])
    D = np.block([[np.eye(nx), -K], [np.eye(nx), np.zeros_like(K)]])
    weights = np.block([[theta**2 * L.T @ L, zero], [zero, m.G_x.T @ m.G_x / alpha]])
    inner = np.linalg.inv(np.linalg.inv(np.block([[P, zero], [zero, X]])) - weights)
    return A @ inner @ A.T + alpha * M @ M.T + D @ joint(model) @ D.T


def test_the_bounds_fulfil_the_inequality_of_the_joint_system(rng):
    """Oracle: the inequality for [e; x] with 2 n states: equality in both blocks, zero between them."""
    for _ in range(10):
        model, given = system(rng), parameters(rng)
        filter_ = design(model, N, **given)
        for k in range(N):
            P, X = filter_.P[k], filter_.extra["X"][k]
            right = bounded_real(model, filter_.F[k], filter_.K[k], P, X, 2.0, 0.01, 0.8 * np.eye(3))
            left = np.zeros((6, 6))
            left[:3, :3], left[3:, 3:] = filter_.P[k + 1], filter_.extra["X"][k + 1]
            np.testing.assert_allclose(right, left, atol=1e-9 * np.abs(left).max())


def test_the_gain_is_the_best_one(rng):
    """Oracle: BFGS on the trace of the next bound over K, with the F_hat that makes the block between e and x zero."""
    model, given = system(rng), parameters(rng)
    filter_, m = design(model, N, **given), model.system.at(0)
    M = np.vstack([m.H_A, m.H_C])
    R = joint(model) + 2.0 * M @ M.T
    for k in (0, 4):
        P, X = filter_.P[k], filter_.extra["X"][k]
        X_inv = np.linalg.inv(X) - m.G_x.T @ m.G_x / 2.0

        def trace(K, P=P, X=X, X_inv=X_inv):
            K = K.reshape(3, 2)
            F = m.A + (R[:3, :3] - K @ R[3:, :3]) @ np.linalg.inv(m.A.T) @ X_inv
            return np.trace(bounded_real(model, F, K, P, X, 2.0, 0.01, 0.8 * np.eye(3))[:3, :3])

        best = minimize(trace, np.zeros(6), method="BFGS", options={"gtol": 1e-9})
        np.testing.assert_allclose(trace(filter_.K[k].ravel()), best.fun, rtol=1e-9)
        np.testing.assert_allclose(filter_.K[k].ravel(), best.x, atol=1e-5)


@pytest.mark.parametrize("theta", [0.0, 0.01])
def test_the_second_moment_stays_below_the_bound(theta, rng):
    """Oracle: the exact second moment of [x; x_pred] under given F, inside and on the boundary of |F| <= 1."""
    largest = 0.0
    for number in range(8):
        model, given = system(rng, size=0.3, Dw=np.zeros((2, 3))), parameters(rng, theta=theta, alpha=2.0)
        filter_, m, x0 = design(model, N, **given), model.system.at(0), given["x0"]
        for kind in ("bang", "inside"):
            S = np.kron([[1.0, 1.0], [1.0, 1.0]], np.outer(x0, x0))
            S[:3, :3] += given["P0"]
            for k in range(N):
                F = random_F(np.random.default_rng((number, k)), m, kind)
                S = conditional(m, model.W, model.V, S, at(filter_.F, k), filter_.K[k], F)
                largest = max(largest, ratio(of_error(S), filter_.P[k + 1]))
                assert ratio(S[:3, :3], filter_.extra["X"][k + 1]) <= 1.0 + 1e-9
    assert 0.2 < largest <= 1.0 + 1e-9


def worst_energy(model, filter_, given, rng):
    """Largest sum of |L e|^2 over the energy of start and noises, for one random sequence of F: one big matrix."""
    m, nx, nz = model.system.at(0), 3, len(joint(model))
    root = np.linalg.cholesky(joint(model))
    start = np.block([[filter_.P[0], np.zeros((nx, nx))], [np.zeros((nx, nx)), filter_.extra["X"][0]]])
    # Columns: unit start of [e; x], then the unit noises of every step; rows of `state` are [e; x].
    state = np.hstack([np.linalg.cholesky(start), np.zeros((2 * nx, nz * N))])
    outputs = []
    for k in range(N + 1):
        outputs.append(given["weight"] * state[:nx])
        if k == N:
            break
        F, K, F_x = at(filter_.F, k), filter_.K[k], random_F(rng, m, "bang")[0]
        A, C = m.A + m.H_A @ F_x @ m.G_x, m.C + m.H_C @ F_x @ m.G_x
        F_hat = F - K @ m.C
        A_c = np.block([[F_hat, A - K @ C - F_hat], [np.zeros((nx, nx)), A]])
        D = np.block([[np.eye(nx), -K], [np.eye(nx), np.zeros_like(K)]])
        state = A_c @ state
        state[:, 2 * nx + nz * k : 2 * nx + nz * (k + 1)] += D @ root
    return np.linalg.norm(np.vstack(outputs), 2) ** 2


def test_the_energy_of_the_error_stays_below_its_bound(rng):
    """Oracle: the largest singular value of the map from start and noises to all errors, for random admissible F."""
    largest = 0.0
    for _ in range(8):
        model, given = system(rng, size=0.3), parameters(rng, alpha=2.0)
        theta = 0.999 * largest_theta(model, given)
        filter_ = design(model, N, **given | {"theta": theta})
        for _ in range(5):
            largest = max(largest, theta**2 * worst_energy(model, filter_, given, rng))
    assert 0.3 < largest <= 1.0 + 1e-9


def largest_theta(model, given):
    """Bisect for the largest theta with which all bounds exist."""
    low, high = 0.0, 10.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        try:
            design(model, N, **given | {"theta": middle})
            low = middle
        except DesignError as error:
            assert error.parameter == "theta"
            high = middle
    return low


@pytest.mark.parametrize("certain", [{"H_A": 0, "H_C": 0}, {"G_x": 0}])
def test_without_uncertainty_it_is_the_kalman_predictor(certain, rng):
    """Oracle: `kalman-predictor` with correlated noises, inputs and means of the noises."""
    model = system(rng, **certain, B=np.ones((3, 1)), wbar=[0.1, 0.0, -0.3], vbar=[0.2, 1.0])
    start = {"x0": np.ones(3), "P0": random_psd(rng, 3)}
    ours, theirs = design(model, N, **start, alpha=1.0), kalman_predictor(model, N, **start)
    for name in ("F", "B", "f", "d", "K", "P"):
        left, right = np.broadcast_arrays(getattr(ours, name), getattr(theirs, name))
        np.testing.assert_allclose(left, right, rtol=1e-10, atol=1e-12)


def test_without_uncertainty_it_is_the_risk_sensitive_predictor(rng):
    """Oracle: `risk-sensitive` in predictor form, whose theta is theta^2 here; the weight is I, P there is widened."""
    model = system(rng, H_A=0, H_C=0, Dw=np.zeros((2, 3)))
    start = {"x0": np.ones(3), "P0": random_psd(rng, 3)}
    theirs = risk_sensitive(model, N, **start, theta=0.01, form="predictor")
    ours = design(model, N, **start, alpha=1.0, theta=0.1)
    np.testing.assert_allclose(ours.K, theirs.K, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(ours.P, theirs.extra["P_pred"], rtol=1e-9, atol=1e-12)


def test_a_large_state_gives_the_gain_without_uncertainty(rng):
    """Oracle: the limit X -> infinity of the published equations with alpha M = 0: the Kalman predictor."""
    model, tiny = system(rng, H_A=0, H_C=0), system(rng, H_C=0)
    start, noise = Bounds(psd_sqrt(random_psd(rng, 3)), 1e9 * np.eye(3)), joint(model)
    m, limits = tiny.system.at(0), Limits(1e9, 0.0, np.eye(3), 0.0)
    step = bounded_real_step(Uncertain(m.A, m.C, m.G_x, noise), start, limits)
    without = bounded_real_step(Uncertain(m.A, m.C, m.G_x, noise), start._replace(X=None), limits)
    np.testing.assert_allclose(step.K, without.K, atol=1e-6)
    P, P_without = (covariance_of(each.after.root) for each in (step, without))
    np.testing.assert_allclose(P, P_without, atol=1e-6)


def test_the_recursion_is_the_published_one(rng):
    """Oracle: the equations of section 12.2 with their auxiliary matrices and inverses, eps included."""
    model, given = system(rng), parameters(rng, eps=0.01, S1=5.0, S2=7.0)
    filter_, m, inv = design(model, N, **given), model.system.at(0), np.linalg.inv
    noise, alpha, L = joint(model), 2.0, 0.01 * 0.8 * np.eye(3)
    R_11, R_12 = noise[:3, :3] + alpha * m.H_A @ m.H_A.T, noise[:3, 3:] + alpha * m.H_A @ m.H_C.T
    R_22, P, X = noise[3:, 3:] + alpha * m.H_C @ m.H_C.T, 5.0 * np.eye(3), 7.0 * np.eye(3)
    for k in range(N):
        core = inv(inv(X) - m.G_x.T @ m.G_x / alpha)
        R_1 = core @ m.A.T
        R_2 = inv(R_1) @ core @ inv(R_1).T
        A_1, C_1, T = m.A + R_11 @ inv(R_1), m.C + R_12.T @ inv(R_1), inv(inv(P) - L.T @ L)
        cross = A_1 @ T @ C_1.T + R_11 @ R_2 @ R_12 + R_12
        K = cross @ inv(C_1 @ T @ C_1.T + R_12.T @ R_2 @ R_12 + R_22)
        np.testing.assert_allclose(filter_.K[k], K, atol=1e-9)
        np.testing.assert_allclose(filter_.F[k] - filter_.K[k] @ m.C, A_1 - K @ C_1, atol=1e-9)
        P = A_1 @ T @ A_1.T + R_11 + R_11 @ R_2 @ R_11.T - K @ cross.T + 0.01 * np.eye(3)
        inner = inv(alpha * np.eye(2) - m.G_x @ X @ m.G_x.T)
        X = m.A @ (X + X @ m.G_x.T @ inner @ m.G_x @ X) @ m.A.T + R_11 + 0.01 * np.eye(3)
        np.testing.assert_allclose(filter_.P[k + 1], P, atol=1e-8)
        np.testing.assert_allclose(filter_.extra["X"][k + 1], X, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("keys", "parameter", "message"),
    [
        ({"alpha": 1e-6}, "alpha", "does not hold at k = 0: choose a larger alpha"),
        ({"theta": 10.0}, "theta", "does not hold at k = 0: choose a smaller theta"),
        ({"S2": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]}, "S2", "give a positive definite S2"),
        ({"S1": [1.0, 2.0]}, "S1", "does not fit"),
        ({"S2": -1.0}, "S2", "positive semidefinite"),
        ({"weight": [1.0, 2.0]}, "weight", "does not fit"),
    ],
)
def test_bad_parameters_are_design_errors(keys, parameter, message, rng):
    """Oracle: the parameter to blame and the way out."""
    with pytest.raises(DesignError, match=message) as error:
        design(system(rng, size=1.0), N, **parameters(rng, alpha=100.0) | keys)
    assert error.value.parameter == parameter


def test_a_singular_transition_is_refused(rng):
    """Oracle: the published equations need the inverse of A."""
    with pytest.raises(DesignError, match="is singular at k = 0"):
        design(system(rng, A=[[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0]]), N, **parameters(rng))


def test_inputs_and_means_are_refused_with_an_uncertain_model(rng):
    """Oracle: F_hat differs from A - K C, so that a known part of the state would become an error."""
    for changed in ({"B": np.ones((3, 1))}, {"wbar": [0.1, 0.0, 0.0]}, {"vbar": [0.1, 0.0]}):
        with pytest.raises(DesignError, match="choose another estimator"):
            design(system(rng, **changed), N, **parameters(rng))
