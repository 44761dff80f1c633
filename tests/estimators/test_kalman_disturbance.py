"""The Kalman filter for an unknown mean: limit, filterpy, Monte Carlo and a constant that is found."""

import numpy as np
import pytest
from conftest import random_model, random_psd, within_stat
from estimators.mixed_systems import estimates, paper_model
from filterpy.kalman import KalmanFilter

from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.kalman_disturbance import design
from rmpc_bench.types import DesignError

SIZES = pytest.mark.parametrize(("nx", "ny"), [(1, 1), (3, 2)])


@SIZES
def test_a_known_mean_leaves_the_kalman_filter(nx, ny, rng):
    """Oracle: the Kalman filter, D0 = 0 and drift = 0; gains, covariances and estimates."""
    model, start = random_model(rng, nx, 1, ny), {"x0": rng.standard_normal(nx), "P0": random_psd(rng, nx)}
    y = rng.standard_normal((3, 13, ny))
    for use_y0 in (True, False):
        ours, theirs = design(model, 12, **start, D0=0.0, use_y0=use_y0), kalman(model, 12, **start, use_y0=use_y0)
        np.testing.assert_allclose(ours.P, theirs.P, atol=1e-13)
        for a, b in zip(estimates(ours, y), estimates(theirs, y), strict=True):
            np.testing.assert_allclose(a.x_hat, b.x_hat, atol=1e-12)
            np.testing.assert_allclose(a.P, b.P, atol=1e-13)
            np.testing.assert_array_equal(a.info["w_mean"], 0.0)


@SIZES
def test_it_is_filterpys(nx, ny, rng):
    """Oracle: filterpy's KalmanFilter on [x; d]."""
    m, n_steps = random_model(rng, nx, 1, ny), 15
    x0, P0, D0 = rng.standard_normal(nx), random_psd(rng, nx), random_psd(rng, nx)
    ours = design(m, n_steps, x0=x0, P0=P0, D0=D0.tolist(), drift=0.3)
    theirs = KalmanFilter(dim_x=2 * nx, dim_z=ny, dim_u=1)
    zero = np.zeros((nx, nx))
    theirs.F, theirs.B = np.block([[m.A, np.eye(nx)], [zero, np.eye(nx)]]), np.vstack([m.B, 0 * m.B])
    theirs.H, theirs.R = np.hstack([m.C, 0 * m.C]), m.R_v
    theirs.Q, theirs.P = np.block([[m.Q_w, zero], [zero, 0.3 * np.eye(nx)]]), np.block([[P0, zero], [zero, D0]])
    theirs.x = np.concatenate([x0, np.zeros(nx)])[:, None]
    y, u, state = rng.standard_normal((1, n_steps + 1, ny)), rng.standard_normal((1, n_steps + 1, 1)), ours.init(1)
    for k in range(n_steps + 1):
        theirs.update(y[0, k])
        state, each = ours.correct(k, state, y[:, k])
        np.testing.assert_allclose(each.x_hat[0], theirs.x[:nx, 0], atol=1e-10)
        np.testing.assert_allclose(each.info["w_mean"][0], theirs.x[nx:, 0], atol=1e-10)
        np.testing.assert_allclose(each.P, theirs.P[:nx, :nx], atol=1e-10)
        np.testing.assert_allclose(ours.P[k], each.P, atol=1e-12)
        theirs.predict(u=u[0, k][:, None])
        state = ours.predict(k, state, u[:, k])


def simulated(rng, m, runs, n_steps, x, d, drift=0.0):
    """True states, means and measurements of a model whose noise has the mean d."""
    xs, ds, ys = [], [], []
    for _ in range(n_steps + 1):
        xs.append(x)
        ds.append(d)
        ys.append(x @ m.C.T + rng.multivariate_normal(np.zeros(m.ny), m.R_v, runs))
        x = x @ m.A.T + d + rng.multivariate_normal(np.zeros(m.nx), m.Q_w, runs)
        d = d + np.sqrt(drift) * rng.standard_normal(d.shape)
    return [np.stack(values, axis=1) for values in (xs, ds, ys)]


def test_the_errors_have_the_promised_covariance(rng):
    """Oracle: Monte Carlo, 10,000 runs, of x and of the mean, which drifts."""
    m, runs = random_model(rng, 2, 1, 1), 10_000
    ours = design(m, 8, x0=np.zeros(2), P0=np.eye(2), D0=2.0, drift=0.2)
    x, d, y = simulated(rng, m, runs, 8, rng.standard_normal((runs, 2)),
                        np.sqrt(2.0) * rng.standard_normal((runs, 2)), 0.2)  # fmt: skip
    each = estimates(ours, y)[-1]
    error = np.hstack([each.x_hat - x[:, -1], each.info["w_mean"] - d[:, -1]])
    assert within_stat(error, 0.0)
    assert within_stat(error[:, :, None] * error[:, None, :], ours.full.P[-1])


def test_a_constant_mean_is_found(rng):
    """Oracle: the mean itself; the usual filter is off by what an unknown mean leaves, this one is not."""
    m, runs, mean = random_model(rng, 2, 1, 2, 0.7), 2000, np.array([1.0, -2.0])
    x, _, y = simulated(rng, m, runs, 200, np.zeros((runs, 2)), np.tile(mean, (runs, 1)))
    start = {"x0": np.zeros(2), "P0": np.eye(2)}
    ours, theirs = estimates(design(m, 200, **start, D0=1e4), y)[-1], estimates(kalman(m, 200, **start), y)[-1]
    assert within_stat(ours.info["w_mean"], mean)
    assert within_stat(ours.x_hat - x[:, -1], 0.0)
    assert not within_stat(theirs.x_hat - x[:, -1], 0.0)


def test_matched_noise_and_the_known_mean(rng):
    """Oracle: the Kalman filter with matched noise on a model whose mean is known, D0 = 0."""
    model = paper_model(w_mean=[0.5, -0.3], v_mean=0.2)
    start = {"x0": np.ones(2), "P0": np.eye(2), "M0": 4.0 * np.eye(2), "noise": "matched"}
    y = rng.standard_normal((2, 21, 1))
    ours, theirs = (
        estimates(make(model, 20, **start, **keys), y) for make, keys in ((design, {"D0": 0.0}), (kalman, {}))
    )
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a.x_hat, b.x_hat, atol=1e-11)
        np.testing.assert_allclose(a.P, b.P, atol=1e-12)


def test_what_is_no_covariance_is_refused():
    """Oracle: the parameter to blame."""
    with pytest.raises(DesignError, match="does not fit") as caught:
        design(paper_model(), 5, x0=np.zeros(2), P0=np.eye(2), D0=[1.0, 2.0, 3.0])
    assert caught.value.parameter == "D0"
