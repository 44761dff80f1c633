"""The linear loop against the code that simulates it."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROUND, random_model
from simulation.toy import Halfway, Proportional

from rmpc_bench.controllers.mpc import MpcState
from rmpc_bench.controllers.mpc import design as mpc
from rmpc_bench.diagnostics.stability import linear_pair, spectral_radius
from rmpc_bench.estimators.gain_schedule import FilterState
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.types import LinearTruth

N = 6


def parts(seed, law="increment"):
    """A model, its filter, its controller, and another plant with a state more."""
    rng = np.random.default_rng(seed)
    model, other = random_model(rng, 3, 2, 2), random_model(rng, 4, 2, 2)
    estimator = kalman(model, N, x0=np.zeros(3), P0=model.Q_w)
    controller = mpc(model, Hp=5, Hu=2, Q=1.0, R=0.3, law=law)
    return estimator, controller, LinearTruth(other.A, other.B, other.C, np.eye(3, 4))


def probed(estimator, controller, truth):
    """Matrix of the loop, column by column: one period from every unit vector, by the code that simulates."""
    n, n_hat, nu = len(truth.A), estimator.F.shape[1], truth.B.shape[1]
    x, x_pred, u = np.split(np.eye(n + n_hat + nu), [n, n + n_hat], axis=1)
    state, estimate = estimator.correct(N, FilterState(x_pred, np.zeros((len(x), 2))), x @ truth.C.T)
    r = np.zeros((controller.preview, 2))
    _, command = controller.control(N, MpcState(u), x @ truth.C.T, estimate, r)
    after = estimator.predict(N, state, command.u).x_pred
    return np.hstack([x @ truth.A.T + command.u @ truth.B.T, after, command.u]).T


@pytest.mark.parametrize("law", ["increment", "printed"])
def test_spectral_radius(law):
    """Of the matrix that one period of the simulated loop amounts to."""
    for seed in range(5):
        estimator, controller, truth = parts(seed, law)
        expected = np.abs(np.linalg.eigvals(probed(estimator, controller, truth))).max()
        found = spectral_radius(truth, linear_pair(estimator, controller))
        np.testing.assert_allclose(found, expected, rtol=1e-10)  # eigenvalues of a matrix that is not symmetric


def test_input_in_terms_of_the_measurement():
    """u = J y + what the past and the reference add, at every k."""
    estimator, controller, truth = parts(1)
    pair = linear_pair(estimator, controller)
    rng = np.random.default_rng(2)
    for k in (0, 3):
        g, x_pred, u, y = pair.at(k), *(rng.standard_normal((1, n)) for n in (3, 2, 2))
        _, estimate = estimator.correct(k, FilterState(x_pred, y), y)
        r = rng.standard_normal((controller.preview, 2))
        _, command = controller.control(k, MpcState(u), y, estimate, r)
        parts_of_u = (g.J @ y[0], g.from_x_pred @ x_pred[0], g.from_u @ u[0], pair.law.K_r @ r[1:].ravel())
        np.testing.assert_allclose(sum(parts_of_u), command.u[0], rtol=1e-10)  # a sum of terms that may cancel


def test_gain_of_a_controller_of_ones_own():
    """A method `gain()` may show what the attributes of another controller do."""
    estimator, controller, truth = parts(1)
    own = SimpleNamespace(gain=lambda: controller)
    expected = spectral_radius(truth, linear_pair(estimator, controller))
    np.testing.assert_allclose(spectral_radius(truth, linear_pair(estimator, own)), expected, **ROUND)


def test_pairs_without_gains_are_not_looked_at():
    """Neither an estimator nor a controller has to show gains."""
    estimator, controller, _ = parts(1)
    assert linear_pair(Halfway(), controller) is None
    assert linear_pair(estimator, Proportional()) is None
