"""The Kalman filter on a state-dependent model against its limit, a plain twin, and what does not go with it."""

import pickle

import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd
from estimators.state_dependent_models import Bursty, Frozen, Mass
from filterpy.kalman import KalmanFilter

from rmpc_bench.estimators.kalman import design
from rmpc_bench.models.moving_slide import SlideNoise
from rmpc_bench.models.moving_slide import design as slide
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import DesignError, Estimator, Status


def run(estimator, y, u):
    """Estimates (runs, samples, nx) and covariances (runs or 1, samples, nx, nx)."""
    state, x_hat, P = estimator.init(len(y)), [], []
    for k in range(y.shape[1]):
        state, estimate = estimator.correct(k, state, y[:, k])
        x_hat.append(estimate.x_hat)
        P.append(estimate.P if estimate.P.ndim == 3 else estimate.P[None])
        state = estimator.predict(k, state, u[:, k])
    return np.stack(x_hat, axis=1), np.stack(P, axis=1)


@pytest.mark.parametrize("use_y0", [True, False])
@pytest.mark.parametrize(("nx", "nu", "ny"), [(1, 1, 1), (4, 2, 2), (2, 1, 3)])
def test_of_a_constant_model_it_is_the_gain_schedule(nx, nu, ny, use_y0, rng):
    """Oracle: the filter with precomputed gains."""
    model = random_model(rng, nx, nu, ny)
    start = {"x0": rng.standard_normal(nx), "P0": random_psd(rng, nx), "use_y0": use_y0}
    y, u = rng.standard_normal((5, 21, ny)), rng.standard_normal((5, 21, nu))
    x_hat, P = run(design(Frozen(model), 20, **start), y, u)
    x_theirs, P_theirs = run(design(model, 20, **start), y, u)
    np.testing.assert_allclose(x_hat, x_theirs, atol=1e-12)  # rounding of sums of size 1
    np.testing.assert_allclose(P, np.broadcast_to(P_theirs, P.shape), rtol=ROUND["rtol"], atol=1e-14)


def test_of_a_model_that_depends_on_the_state_it_is_filterpys(rng):
    """Oracle: filterpy's filter, given A and B at every one of its own estimates."""
    model = Mass()
    _, y, u = model.simulated(rng, 3, 30, 0.1)
    x_hat, P = run(design(model, 30, x0=np.array([0.1, 0.2]), P0=0.5 * np.eye(2)), y, u)
    for i in range(3):
        theirs = KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
        theirs.H, theirs.Q, theirs.R = model.C, model.Q_w, model.R_v
        theirs.x, theirs.P = np.array([[0.1], [0.2]]), 0.5 * np.eye(2)
        for k in range(31):
            theirs.update(y[i, k])
            np.testing.assert_allclose(x_hat[i, k], theirs.x[:, 0], atol=1e-12)
            np.testing.assert_allclose(P[i, k], theirs.P, atol=1e-13)
            A, B = model.at_state(theirs.x.T)
            theirs.predict(u=u[i, k][:, None], F=A[0], B=B[0])
    assert np.ptp(P[:, -1, 1, 1]) > 0.0  # every run has its own


def test_a_covariance_that_depends_on_k_is_used(rng):
    """Oracle: filterpy's filter, given R of every sample; before the burst the filter with a constant R."""
    model = Bursty()
    _, y, u = model.simulated(rng, 2, 30, 0.1)
    x_hat, P = run(design(model, 30, x0=np.array([0.1, 0.2]), P0=0.5 * np.eye(2)), y, u)
    for i in range(2):
        theirs = KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
        theirs.H, theirs.Q = model.C, model.Q_w
        theirs.x, theirs.P = np.array([[0.1], [0.2]]), 0.5 * np.eye(2)
        for k in range(31):
            theirs.update(y[i, k], R=model.R_v_at(k))
            np.testing.assert_allclose(x_hat[i, k], theirs.x[:, 0], atol=1e-12)
            np.testing.assert_allclose(P[i, k], theirs.P, atol=1e-13)
            A, B = model.at_state(theirs.x.T)
            theirs.predict(u=u[i, k][:, None], F=A[0], B=B[0])
    steady = run(design(Mass(), 30, x0=np.array([0.1, 0.2]), P0=0.5 * np.eye(2)), y, u)
    np.testing.assert_array_equal(x_hat[:, :10], steady[0][:, :10])
    assert (P[:, 10, 0, 0] > steady[1][:, 10, 0, 0]).all()


def test_bursts_with_factor_1_change_nothing(rng):
    """Oracle: the filter of the robot without bursts, bit for bit."""
    bursts = [Burst(0.02, 0.08, 1.0)]
    with_bursts, without = (slide(0.01, noise=SlideNoise(bursts=given)) for given in (bursts, []))
    start = {"x0": np.array([0.05, -0.03, 0.1, 0.0, 0.0, 0.0]), "P0": 1e-6 * np.eye(6)}
    y, u = start["x0"][:3] + 1e-3 * rng.standard_normal((2, 11, 3)), 0.1 * rng.standard_normal((2, 11, 4))
    for left, right in zip(run(design(with_bursts, 10, **start), y, u), run(design(without, 10, **start), y, u),
                           strict=True):  # fmt: skip
        np.testing.assert_array_equal(left, right)


def test_rows_do_not_depend_on_each_other(rng):
    """Oracle: every run alone, and a pickle, bit for bit, beside a run whose measurement is missing."""
    model = Mass()
    _, y, u = model.simulated(rng, 7, 12, 0.1)
    y[3, 5] = np.nan
    filter_ = design(model, 12, x0=np.zeros(2), P0=np.eye(2))
    assert isinstance(filter_, Estimator)
    x_hat, P = run(pickle.loads(pickle.dumps(filter_)), y, u)
    assert np.isnan(x_hat[3, 5:]).all() and np.isfinite(np.delete(x_hat, 3, axis=0)).all()
    for i in range(7):
        alone = run(filter_, y[i : i + 1], u[i : i + 1])
        for a, b in zip(alone, (x_hat, P), strict=True):
            np.testing.assert_array_equal(a[0], b[i])


def test_arguments_are_left_alone(rng):
    """Oracle: copies taken before the call."""
    filter_, y = design(Mass(), 3, x0=np.zeros(2), P0=np.eye(2)), rng.standard_normal((4, 1))
    state = filter_.init(4)
    kept = [part.copy() for part in (*state, y)]
    corrected, _ = filter_.correct(0, state, y)
    filter_.predict(0, corrected, y)
    for part, copy in zip((*state, y), kept, strict=True):
        np.testing.assert_array_equal(part, copy)


def test_an_estimate_that_is_too_large_ends_the_run():
    """Oracle: `largest` of the model, 20."""
    filter_ = design(Mass(), 3, x0=np.array([19.5, 0.0]), P0=np.eye(2))
    _, estimate = filter_.correct(0, filter_.init(2), np.array([[19.0], [25.0]]))
    np.testing.assert_array_equal(estimate.status, [Status.OK, Status.DIVERGED])


@pytest.mark.parametrize(("key", "value"), [("form", "predictor"), ("noise", "matched")])
def test_keys_that_do_not_go_with_it(key, value):
    """Oracle: the key to blame, and the way out."""
    with pytest.raises(DesignError, match="choose") as caught:
        design(Mass(), 3, x0=np.zeros(2), P0=np.eye(2), **{key: value})
    assert caught.value.parameter == key


def test_a_sensor_without_noise_is_a_design_error():
    """Oracle: R_v = 0 can make an innovation without covariance."""
    model = Mass()
    model.R_v = np.zeros((1, 1))
    with pytest.raises(DesignError, match="measurement noise"):
        design(model, 3, x0=np.zeros(2), P0=np.eye(2))
    bursty = Bursty(factor=0.0)
    design(bursty, 9, x0=np.zeros(2), P0=np.eye(2))
    with pytest.raises(DesignError, match="measurement noise"):
        design(bursty, 10, x0=np.zeros(2), P0=np.eye(2))
