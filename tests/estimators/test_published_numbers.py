"""Published gains of Kalman filters, to the digits printed."""

import numpy as np
import pytest

from rmpc_bench import LinearModel
from rmpc_bench.estimators.kalman import design
from rmpc_bench.estimators.kalman_predictor import design as kalman_predictor


def test_the_example_of_the_control_system_toolbox():
    """Oracle: the manual of MATLAB's Control System Toolbox, Kalman Filter Design: M = .5345, .0101, -.4776.

    The noise w enters with the input and has the variance 2.3; the measurement noise has the variance 1.
    """
    A, B = np.array([[1.1269, -0.4940, 0.1129], [1, 0, 0], [0, 1, 0]]), np.array([[-0.3832], [0.5919], [0.5191]])
    C, Q_w, R_v = np.array([[1.0, 0, 0]]), 2.3 * (B @ B.T), np.eye(1)
    filter_ = design(LinearModel(A, B, C, Q_w, R_v), 200, x0=np.zeros(3), P0=Q_w)
    np.testing.assert_allclose(filter_.L[-1][:, 0], [0.5345, 0.0101, -0.4776], rtol=0, atol=0.5e-4)
    steady = kalman_predictor(LinearModel(A, B, C, Q_w, R_v), 1, x0=np.zeros(3), P0=Q_w, gain="steady")
    np.testing.assert_allclose(steady.K[0], A @ filter_.L[-1], atol=1e-9)


@pytest.mark.parametrize("form", ["filter", "predictor"])
def test_the_level_of_the_nile(form):
    """Oracle: Durbin and Koopman, Time Series Analysis by State Space Methods (2001), chapter 2: the local level model.

    The annual flow of the Nile at Aswan, 1871 to 1970, with the variances 15099 and 1469.1: the gain tends to 0.267048.
    By hand: with q = 1469.1 / 15099 the prediction has the variance (q + sqrt(q^2 + 4 q)) / 2 times 15099.
    """
    one = np.eye(1)
    level = LinearModel(one, np.zeros((1, 1)), one, 1469.1 * one, 15099.0 * one)
    filter_ = design(level, 100, x0=np.zeros(1), P0=1e7 * one, form=form)
    np.testing.assert_allclose(filter_.K[-1], [[0.267048]], rtol=0, atol=0.5e-6)
    q = 1469.1 / 15099.0
    p = 0.5 * (q + np.sqrt(q * q + 4.0 * q))
    np.testing.assert_allclose(filter_.K[-1], [[p / (1.0 + p)]], rtol=1e-10)
