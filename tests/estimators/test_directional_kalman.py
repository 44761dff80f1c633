"""The Kalman filter with noise in the direction of the uncertainty: limits, an own recursion, the reference study."""

import numpy as np
import pytest
from conftest import EXACT, ROUND, STAT, random_model, random_psd
from estimators.uncertain_oracles import random_uncertain
from estimators.wkf2018_system import WKF, stationary_error
from scipy.linalg import solve_discrete_are

from rmpc_bench.estimators import directional_kalman, kalman
from rmpc_bench.models.disturbance import Disturbance
from rmpc_bench.models.disturbed import with_disturbance
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.types import DesignError


def uncorrelated_uncertain(rng, n_steps, varying):
    """Random uncertain model whose process and measurement noise do not share a source."""
    model = random_uncertain(rng, n_steps, varying=varying)
    given = {name: np.array(M) for name, M in model.system.over_time._asdict().items()}
    given["Bv"], given["Dw"] = 0.0 * given["Bv"], 0.0 * given["Dw"]
    return uncertain_model(n_steps, **given, W=model.W.tolist(), V=model.V.tolist(), wbar=[1.0, 2.0])


@pytest.mark.parametrize("varying", [False, True])
def test_q_0_is_the_kalman_filter(varying, rng):
    """Oracle: kalman on the same model; every number is the same."""
    model, start = uncorrelated_uncertain(rng, 9, varying), {"x0": np.ones(3), "P0": random_psd(rng, 3)}
    ours, theirs = directional_kalman.design(model, 9, q=0.0, **start), kalman.design(model, 9, **start)
    for name in ("F", "B", "C", "f", "K", "L", "P", "S"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), **EXACT)


@pytest.mark.parametrize("varying", [False, True])
def test_the_noise_is_added_in_the_direction_of_H_A(varying, rng):
    """Oracle: kalman at every k on a linear model with Q_w + q H_A H_A', step by step from P_pred of the filter."""
    model, P0 = uncorrelated_uncertain(rng, 9, varying), random_psd(rng, 3)
    ours = directional_kalman.design(model, 9, x0=np.ones(3), P0=P0, q=3.0)
    for k in range(9):
        now, H = model.at(k), model.system.at(k).H_A
        wider = LinearModel(now.A, now.B, now.C, now.Q_w + 3.0 * 0.5 * (H @ H.T + (H @ H.T).T), now.R_v)
        one = kalman.design(wider, 1, x0=np.ones(3), P0=ours.extra["P_pred"][k])
        np.testing.assert_allclose(ours.L[k], one.L[0], **ROUND)
        np.testing.assert_allclose(ours.extra["P_pred"][k + 1], one.extra["P_pred"][1], rtol=1e-11)  # order of sums


def test_directions_are_written_in_several_ways(small_model, rng):
    """Oracle: the same matrix H; a number is that number times the identity."""
    start = {"x0": np.zeros(3), "P0": random_psd(rng, 3), "q": 0.7}

    def covariance(direction):
        return directional_kalman.design(small_model, 5, direction=direction, **start).P

    np.testing.assert_array_equal(covariance([0.0, 2.0, 1.0]), covariance([[0.0], [2.0], [1.0]]))
    np.testing.assert_array_equal(covariance(2.0), covariance((2.0 * np.eye(3)).tolist()))
    assert (covariance(2.0) != covariance([0.0, 2.0, 1.0])).any()


def test_the_steady_covariance_solves_the_riccati_equation(rng):
    """Oracle: scipy.linalg.solve_discrete_are with the wider Q_w."""
    m, H = random_model(rng, 3, 1, 2, 0.9), rng.standard_normal((3, 2))
    ours = directional_kalman.design(m, 400, x0=np.zeros(3), P0=np.eye(3), q=5.0, direction=H.tolist())
    expected = solve_discrete_are(m.A.T, m.C.T, m.Q_w + 5.0 * H @ H.T, m.R_v)
    np.testing.assert_allclose(ours.extra["P_pred"][-1], expected, rtol=1e-9)  # two methods for one equation


def test_disturbances_get_no_noise_unless_asked(rng):
    """Oracle: the same direction with a zero for the disturbance; with an uncertain model H_A does not act on it."""
    model = uncertain_model(20, **WKF, B=[[0.0], [1.0]])
    with_d = with_disturbance(model, Disturbance(at="input", drift=0.1), 20, np.zeros(2))
    start = {"x0": np.zeros(3), "P0": random_psd(rng, 3), "q": 4.0}
    ours = directional_kalman.design(with_d, 20, **start)
    for direction in ([0.99, 0.0], [0.99, 0.0, 0.0]):
        same = directional_kalman.design(with_d, 20, direction=direction, **start)
        np.testing.assert_array_equal(ours.P, same.P)


def test_a_missing_measurement_is_left_out(rng):
    """Oracle: P of the Kalman filter with Q_w + q H H', written out, where y(2) is missing."""
    m, wider = random_model(rng, 3, 1, 2), np.outer([1.0, 0.0, 1.0], [1.0, 0.0, 1.0])
    ours = directional_kalman.design(m, 4, x0=np.zeros(3), P0=np.eye(3), q=1.0, direction=[1.0, 0.0, 1.0])
    state, y, P_pred = ours.init(1), rng.standard_normal((5, 1, 2)), np.eye(3)
    y[2] = np.nan
    for k in range(5):
        state, estimate = ours.correct(k, state, y[k])
        gain = P_pred @ m.C.T @ np.linalg.inv(m.C @ P_pred @ m.C.T + m.R_v)
        P = P_pred if k == 2 else P_pred - gain @ m.C @ P_pred
        np.testing.assert_allclose(np.broadcast_to(estimate.P, (1, 3, 3))[0], P, rtol=1e-9)  # without roots
        state = ours.predict(k, state, np.zeros((1, 1)))
        P_pred = m.A @ P @ m.A.T + m.Q_w + wider


def test_the_error_on_wkf2018_is_that_of_the_reference_study():
    """Oracle: the reference study, 48.0 with standard error 1.2 per state for q H_A H_A', 92.7 with 3.6 for kalman.

    The error is exact: the second moments of state and error for a white d.  The best q is found on a grid.
    """
    model, start = uncertain_model(400, **WKF), {"x0": np.zeros(2), "P0": np.eye(2)}
    filters = [directional_kalman.design(model, 400, q=q, **start) for q in np.geomspace(1.0, 1e3, 13)]
    errors = [stationary_error(each, 0.99) / 2 for each in filters]
    assert abs(min(errors) - 48.0) < STAT * 1.2
    assert abs(stationary_error(kalman.design(model, 400, **start), 0.99) / 2 - 92.7) < STAT * 3.6


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({}, r"no uncertainty of A"),
        ({"direction": [1.0, 0.0]}, r"has 2 rows; the model has 3 states"),
        ({"direction": [[1.0], [0.0, 1.0], [0.0]]}, r"rows of the same length"),
    ],
)
def test_a_wrong_direction_is_a_design_error(keys, text, small_model):
    """Oracle: the docstring; the error names the key."""
    with pytest.raises(DesignError, match=text) as caught:
        directional_kalman.design(small_model, 3, x0=np.zeros(3), P0=np.eye(3), q=1.0, **keys)
    assert caught.value.parameter == "direction"
