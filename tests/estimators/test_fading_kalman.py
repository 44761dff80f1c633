"""The fading-memory filter against filterpy, its limit, its least-squares problem and a closed form."""

import numpy as np
import pytest
from conftest import EXACT, ROUND, random_model, random_psd
from estimators.mixed_systems import random_mixed
from filterpy.kalman import KalmanFilter

from rmpc_bench.estimators import fading_kalman, kalman
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import DesignError


@pytest.mark.parametrize(("nx", "nu", "ny"), [(1, 1, 1), (3, 1, 2), (2, 1, 3)])
@pytest.mark.parametrize("alpha", [1.0, 1.01, 1.5])
def test_gains_and_estimates_are_filterpys(nx, nu, ny, alpha, rng):
    """Oracle: filterpy's KalmanFilter with its attribute alpha; the inverse of S in it costs some digits."""
    m, n_steps = random_model(rng, nx, nu, ny), 25
    x0, P0 = rng.standard_normal(nx), random_psd(rng, nx)
    y, u = rng.standard_normal((n_steps + 1, ny)), rng.standard_normal((n_steps + 1, nu))
    ours = fading_kalman.design(m, n_steps, x0=x0, P0=P0, alpha=alpha)
    theirs = KalmanFilter(dim_x=nx, dim_z=ny, dim_u=nu)
    theirs.F, theirs.B, theirs.H, theirs.Q, theirs.R = m.A, m.B, m.C, m.Q_w, m.R_v
    theirs.x, theirs.P, theirs.alpha = x0[:, None], P0, alpha
    state = ours.init(1)
    for k in range(n_steps + 1):
        np.testing.assert_allclose(ours.extra["P_pred"][k], theirs.P, atol=1e-11)
        theirs.update(y[k])
        state, estimate = ours.correct(k, state, y[k][None])
        np.testing.assert_allclose(ours.L[k], theirs.K, atol=1e-11)
        np.testing.assert_allclose(ours.P[k], theirs.P, atol=1e-11)
        np.testing.assert_allclose(estimate.x_hat[0], theirs.x[:, 0], atol=1e-10)
        theirs.predict(u=u[k][:, None])
        state = ours.predict(k, state, u[k][None])


@pytest.mark.parametrize("form", ["filter", "predictor"])
@pytest.mark.parametrize("use_y0", [True, False])
def test_alpha_1_is_the_kalman_filter(form, use_y0, rng):
    """Oracle: kalman on a model that varies with k; every number is the same."""
    model, keys = random_mixed(rng, 3, 2, 9), {"x0": np.ones(3), "P0": random_psd(rng, 3)}
    keys |= {"form": form, "use_y0": use_y0}
    ours, theirs = fading_kalman.design(model, 9, alpha=1.0, **keys), kalman.design(model, 9, **keys)
    for name in ("F", "B", "C", "K", "L", "P", "S"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), **EXACT)


def test_old_measurements_are_forgotten_by_powers_of_alpha(rng):
    """Oracle: weighted least squares for x(n), solved at once; a rotation, no process noise, a vague start."""
    n, alpha, A = 30, 1.1, np.array([[np.cos(0.4), np.sin(0.4)], [-np.sin(0.4), np.cos(0.4)]])
    m = LinearModel(A, np.zeros((2, 1)), np.array([[1.0, 0.5]]), np.zeros((2, 2)), np.eye(1))
    y = rng.standard_normal((n + 1, 1))
    filter_ = fading_kalman.design(m, n, x0=np.zeros(2), P0=1e8 * np.eye(2), alpha=alpha)
    state = filter_.init(1)
    for k in range(n + 1):
        state, estimate = filter_.correct(k, state, y[k][None])
        state = filter_.predict(k, state, np.zeros((1, 1)))
    rows = np.vstack([m.C @ np.linalg.matrix_power(A, j - n) for j in range(n + 1)])
    weights = alpha ** np.arange(-n, 1.0)
    expected = np.linalg.lstsq(weights[:, None] * rows, weights * y[:, 0], rcond=None)[0]
    np.testing.assert_allclose(estimate.x_hat[0], expected, rtol=1e-6)  # the start counts 1e-8 of a measurement


def test_the_steady_state_of_a_scalar_system_is_the_root_of_a_quadratic():
    """Oracle: by hand; P (P + r) = alpha^2 a^2 r P + q (P + r)."""
    a, q, r, alpha = 0.9, 0.5, 2.0, 1.3
    model = LinearModel([[a]], [[1.0]], [[1.0]], [[q]], [[r]])
    P = fading_kalman.design(model, 300, x0=np.zeros(1), P0=np.eye(1), alpha=alpha).extra["P_pred"][-1, 0, 0]
    roots = np.roots([1.0, r - alpha**2 * a**2 * r - q, -q * r])
    np.testing.assert_allclose(P, roots[roots > 0][0], **ROUND)


def test_after_a_missing_measurement_the_run_has_its_own_covariance(rng):
    """Oracle: the recursion written out, P_pred = alpha^2 A P A' + Q_w, with the correction left out at k = 2."""
    m, alpha, P_pred = random_model(rng, 3, 1, 2), 1.2, np.eye(3)
    ours = fading_kalman.design(m, 5, x0=np.zeros(3), P0=P_pred, alpha=alpha)
    state, y = ours.init(2), rng.standard_normal((6, 2, 2))
    y[2, 0] = np.nan
    for k in range(6):
        state, estimate = ours.correct(k, state, y[k])
        gain = P_pred @ m.C.T @ np.linalg.inv(m.C @ P_pred @ m.C.T + m.R_v)
        P = P_pred if k == 2 else P_pred - gain @ m.C @ P_pred
        reported = np.broadcast_to(estimate.P, (2, 3, 3))
        np.testing.assert_allclose(reported[0], P, rtol=1e-9)  # without roots
        np.testing.assert_array_equal(reported[1], ours.P[k])
        state = ours.predict(k, state, np.zeros((2, 1)))
        P_pred = alpha**2 * m.A @ P @ m.A.T + m.Q_w


def test_an_unobservable_mode_that_grows_is_a_design_error():
    """Oracle: by hand; alpha^2 a^2 = 1.44 0.81 > 1 and C = 0, so that P_pred grows by 1.1664 per step."""
    model = LinearModel([[0.9]], [[1.0]], [[0.0]], [[1.0]], [[1.0]])
    kalman.design(model, 2000, x0=np.zeros(1), P0=np.eye(1))
    with pytest.raises(DesignError, match=r"beyond 1e\+100 at k = 1484"):
        fading_kalman.design(model, 2000, x0=np.zeros(1), P0=np.eye(1), alpha=1.2)
