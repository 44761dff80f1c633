"""The Kalman filter against filterpy, SciPy, one big Gaussian, Monte Carlo and servo.md."""

import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd, within_stat
from estimators.mixed_systems import M0, M_V, M_W, P0, X0, in_ellipsoid, paper_model, random_mixed, simulated
from filterpy.kalman import KalmanFilter
from scipy.linalg import solve_discrete_are

from rmpc_bench.estimators.kalman import design
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import DesignError

SIZES = pytest.mark.parametrize(("nx", "nu", "ny"), [(1, 1, 1), (3, 1, 1), (4, 2, 2), (2, 1, 3)])


def run(estimator, y, u):
    """Estimates and predictions of a block; y (runs, samples, ny), u (runs, samples, nu)."""
    state, x_hat, x_pred = estimator.init(len(y)), [], []
    for k in range(y.shape[1]):
        x_pred.append(state.x_pred)
        state, estimate = estimator.correct(k, state, y[:, k])
        x_hat.append(estimate.x_hat)
        state = estimator.predict(k, state, u[:, k])
    return np.stack(x_hat, axis=1), np.stack(x_pred, axis=1)


@SIZES
def test_gains_covariances_and_estimates_are_filterpys(nx, nu, ny, rng):
    """Oracle: filterpy's KalmanFilter, which corrects and then predicts, as the bench does."""
    m, n_steps = random_model(rng, nx, nu, ny), 25
    x0, P0 = rng.standard_normal(nx), random_psd(rng, nx)
    y, u = rng.standard_normal((1, n_steps + 1, ny)), rng.standard_normal((1, n_steps + 1, nu))
    ours = design(m, n_steps, x0=x0, P0=P0)
    x_hat, x_pred = run(ours, y, u)
    theirs = KalmanFilter(dim_x=nx, dim_z=ny, dim_u=nu)
    theirs.F, theirs.B, theirs.H, theirs.Q, theirs.R = m.A, m.B, m.C, m.Q_w, m.R_v
    theirs.x, theirs.P = x0[:, None], P0
    for k in range(n_steps + 1):
        np.testing.assert_allclose(x_pred[0, k], theirs.x[:, 0], atol=1e-11)
        np.testing.assert_allclose(ours.extra["P_pred"][k], theirs.P, atol=1e-11)
        theirs.update(y[0, k])
        np.testing.assert_allclose(ours.L[k], theirs.K, atol=1e-11)
        np.testing.assert_allclose(ours.P[k], theirs.P, atol=1e-11)
        np.testing.assert_allclose(x_hat[0, k], theirs.x[:, 0], atol=1e-11)
        theirs.predict(u=u[0, k][:, None])


@pytest.mark.parametrize("radius", [0.5, 0.95, 1.1])
def test_the_steady_covariance_solves_the_algebraic_equation(radius, rng):
    """Oracle: scipy.linalg.solve_discrete_are for the prediction error, also of an unstable model."""
    m = random_model(rng, 3, 1, 2, radius)
    filter_ = design(m, 400, x0=np.zeros(3), P0=np.eye(3))
    P_pred = solve_discrete_are(m.A.T, m.C.T, m.Q_w, m.R_v)
    np.testing.assert_allclose(filter_.extra["P_pred"][-1], P_pred, rtol=1e-9)


@SIZES
def test_the_prediction_is_the_estimate_moved_by_the_model(nx, nu, ny, rng):
    """Oracle: x_pred(k+1) = A x_hat(k) + B u(k), although the filter computes it from x_pred(k) and e(k)."""
    m, n_steps = random_model(rng, nx, nu, ny), 20
    y, u = rng.standard_normal((7, n_steps + 1, ny)), rng.standard_normal((7, n_steps + 1, nu))
    x_hat, x_pred = run(design(m, n_steps, x0=rng.standard_normal(nx), P0=random_psd(rng, nx)), y, u)
    np.testing.assert_allclose(x_pred[:, 1:], x_hat[:, :-1] @ m.A.T + u[:, :-1] @ m.B.T, atol=1e-11)


def joint_gaussian(m, x0, P0, u, n):
    """Mean of (x(0..n), y(0..n)) given the inputs, and its covariance, from one linear map of all noises.

    x(k+1) = A x(k) + B u(k) + w(k) is one block bidiagonal system N X = (x(0), B u + w); nothing is recursive.
    """
    nx, steps = m.nx, n + 1
    N = np.eye(steps * nx) - np.kron(np.eye(steps, k=-1), m.A)
    source = np.concatenate([x0, *(m.B @ u[k] for k in range(n))])
    Q = np.kron(np.diag([0.0] + [1.0] * n), m.Q_w) + np.kron(np.diag([1.0] + [0.0] * n), P0)
    X, cov_X = np.linalg.solve(N, source), np.linalg.solve(N, np.linalg.solve(N, Q).T)
    observe = np.kron(np.eye(steps), m.C)
    T = np.vstack([np.eye(steps * nx), observe])
    cov = T @ cov_X @ T.T
    cov[steps * nx :, steps * nx :] += np.kron(np.eye(steps), m.R_v)
    return T @ X, cov


@SIZES
def test_estimates_are_conditional_means_of_one_big_gaussian(nx, nu, ny, rng):
    """Oracle: E[x(n) | y(0..n)] and its covariance by one big solve, with known inputs and x(0) ~ N(x0, P0)."""
    m, n = random_model(rng, nx, nu, ny), 8
    x0, P0 = rng.standard_normal(nx), random_psd(rng, nx)
    y, u = rng.standard_normal((1, n + 1, ny)), rng.standard_normal((1, n + 1, nu))
    filter_ = design(m, n, x0=x0, P0=P0)
    x_hat, _ = run(filter_, y, u)
    for k in (0, 3, n):
        mean, cov = joint_gaussian(m, x0, P0, u[0], k)
        now, seen = slice(k * nx, (k + 1) * nx), slice((k + 1) * nx, None)
        gain = np.linalg.solve(cov[seen, seen], cov[seen, now]).T
        np.testing.assert_allclose(x_hat[0, k], mean[now] + gain @ (y[0, : k + 1].ravel() - mean[seen]), atol=1e-9)
        np.testing.assert_allclose(filter_.P[k], cov[now, now] - gain @ cov[seen, now], atol=1e-9)


@pytest.mark.parametrize("nx", [1, 3])
def test_the_errors_have_the_promised_covariance(nx, rng):
    """Oracle: Monte Carlo, 20,000 runs of the model itself; STAT on the mean and every entry of P."""
    m, n_steps, runs = random_model(rng, nx, 1, 1), 10, 20_000
    x0, P0 = rng.standard_normal(nx), random_psd(rng, nx)
    x = x0 + rng.multivariate_normal(np.zeros(nx), P0, runs)
    w = rng.multivariate_normal(np.zeros(nx), m.Q_w, (runs, n_steps + 1))
    v = rng.multivariate_normal(np.zeros(1), m.R_v, (runs, n_steps + 1))
    u, ys = rng.standard_normal((runs, n_steps + 1, 1)), []
    for k in range(n_steps + 1):
        ys.append(x @ m.C.T + v[:, k])
        now, x = x, x @ m.A.T + u[:, k] @ m.B.T + w[:, k]
    filter_ = design(m, n_steps, x0=x0, P0=P0)
    error = run(filter_, np.stack(ys, axis=1), u)[0][:, -1] - now
    assert within_stat(error, 0.0)
    assert within_stat(error[:, :, None] * error[:, None, :], filter_.P[-1])


def test_a_constant_is_estimated_by_the_mean():
    """Oracle: by hand; without process noise and with a vague start x_hat is the average of the measurements."""
    model = LinearModel(np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), np.eye(1))
    y = np.array([[1.0], [2.0], [6.0]])[None]
    x_hat, _ = run(design(model, 2, x0=np.zeros(1), P0=1e12 * np.eye(1)), y, np.zeros((1, 3, 1)))
    np.testing.assert_allclose(x_hat[0, :, 0], [1.0, 1.5, 3.0], rtol=1e-9)  # 1e-12 of a prior, 1e-16 of its weight


def test_the_servos_steady_gain_is_the_published_one(servo):
    """Oracle: servo.md section 1, four decimals."""
    filter_ = design(servo, 2000, x0=np.zeros(4), P0=servo.Q_w)
    np.testing.assert_allclose(filter_.L[-1, :, 0], [0.1999, -0.2401, 0.1772, 1.3596], atol=5.1e-5)


def test_a_singular_innovation_is_a_design_error():
    """Oracle: a perfect sensor on a perfectly known state; the message names the step."""
    model = LinearModel(np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), np.zeros((1, 1)))
    with pytest.raises(DesignError, match="k = 0"):
        design(model, 3, x0=np.zeros(1), P0=np.zeros((1, 1)))


def test_series_cover_all_samples(small_model):
    """Oracle: gains are made for k = 0..N; theta of a Kalman filter is 0, V is P_pred, rho the radius of A - K C."""
    series = design(small_model, 5, x0=np.zeros(3), P0=np.eye(3)).series()
    assert {name: len(values) for name, values in series.items()} == dict.fromkeys(
        ("K", "L", "P", "P_pred", "V", "theta", "rho"), 6
    )
    np.testing.assert_array_equal(series["theta"], np.zeros(6))
    np.testing.assert_array_equal(series["V"], series["P_pred"])
    radii = [np.abs(np.linalg.eigvals(small_model.A - K @ small_model.C)).max() for K in series["K"]]
    np.testing.assert_allclose(series["rho"], radii, **ROUND)


def test_a_covariance_without_bound_is_a_design_error():
    """Oracle: by hand; nobody sees x, P(k) = (4^(k+1) - 1) / 3 goes beyond 1e100 at k = 166."""
    model = LinearModel([[2.0]], [[1.0]], [[0.0]], [[1.0]], [[1.0]])
    design(model, 160, x0=np.zeros(1), P0=np.eye(1))
    for n_steps in (170, 600):
        with pytest.raises(DesignError, match=r"beyond 1e\+100 at k = 166"), np.errstate(all="ignore"):
            design(model, n_steps, x0=np.zeros(1), P0=np.eye(1))


def test_matched_noise_counts_the_sets_as_uniform_laws(rng):
    """Oracle: the filter on a model with Q_w + M_w / 4, R_v + M_v / 3 and P0 + M0 / 4; nominal ignores the sets."""
    model, zero = paper_model(), np.zeros((2, 2))
    start = {"x0": X0, "P0": P0, "M0": M0}
    ours = design(model, 30, **start, noise="matched")
    wider = paper_model(P_w=(0.25 * np.eye(2) + np.array(M_W) / 4).tolist(), P_v=0.25 + M_V / 3)
    theirs = design(wider, 30, x0=X0, P0=P0 + M0 / 4)
    for name in ("L", "K", "P"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), **ROUND)
    plain = design(paper_model(M_w=0.0, M_v=0.0), 30, x0=X0, P0=P0)
    for keys in (start, start | {"M0": zero}):
        np.testing.assert_array_equal(design(model, 30, **keys).P, plain.P)
    np.testing.assert_array_equal(design(model, 30, x0=X0, P0=P0, noise="matched").extra["P_pred"][0], P0)


def test_matched_noise_promises_the_right_covariance(rng):
    """Oracle: Monte Carlo, 20,000 runs with uniform bounded noises beside the Gaussian ones."""
    model, runs, shape = random_mixed(rng, 2, 1, 8), 20_000, random_psd(rng, 2)
    ours = design(model, 8, x0=np.zeros(2), P0=np.eye(2), M0=shape, noise="matched")
    start = rng.standard_normal((runs, 2)) + in_ellipsoid(rng, shape, runs)
    x, y = simulated(rng, model, runs, 8, start)
    error = run(ours, y, np.zeros((runs, 9, 1)))[0][:, -1] - x[:, -1]
    assert within_stat(error[:, :, None] * error[:, None, :], ours.P[-1])
    nominal = design(model, 8, x0=np.zeros(2), P0=np.eye(2), M0=shape)
    assert not within_stat(error[:, :, None] * error[:, None, :], nominal.P[-1])


def test_y0_is_left_out_on_request(small_model, rng):
    """Oracle: the filter that begins one sample later with the prediction from x0 and P0."""
    x0, P0 = rng.standard_normal(3), random_psd(rng, 3)
    y, u = rng.standard_normal((2, 9, 2)), rng.standard_normal((2, 9, 2))
    ours = design(small_model, 8, x0=x0, P0=P0, use_y0=False)
    x_hat, x_pred = run(ours, y, u)
    np.testing.assert_array_equal(x_hat[:, 0], [x0, x0])
    np.testing.assert_allclose(ours.P[0], P0, rtol=1e-12)
    m = small_model
    later = design(m, 7, x0=m.A @ x0, P0=m.A @ P0 @ m.A.T + m.Q_w)
    for ours_k, theirs_k in ((ours.P[1:], later.P), (ours.L[1:], later.L)):
        np.testing.assert_allclose(ours_k, theirs_k, rtol=1e-9)  # another order of products
    np.testing.assert_allclose(x_pred[:, 1], x0 @ m.A.T + u[:, 0] @ m.B.T, atol=1e-13)
