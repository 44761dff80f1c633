"""The linear loop against the code that simulates it."""

import numpy as np
import pytest
from conftest import random_model
from simulation.toy import Halfway, Proportional

from rmpc_bench.controllers.mpc import design as mpc
from rmpc_bench.controllers.mpc_law import MpcState
from rmpc_bench.diagnostics.stability import linear_pair, spectral_radius
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.types import Controller, LinearPlant

N = 6


def parts(seed, law="increment"):
    """A model, its filter, its controller, and another plant with a state more."""
    rng = np.random.default_rng(seed)
    model, other = random_model(rng, 3, 2, 2), random_model(rng, 4, 2, 2)
    estimator = kalman(model, N, x0=np.zeros(3), P0=model.Q_w)
    controller = mpc(model, Hp=5, Hu=2, Q=1.0, R=0.3, law=law)
    return estimator, controller, LinearPlant(other.A, other.B, other.C, np.eye(3, 4))


def probed(estimator, controller, plant):
    """Matrix of the loop, column by column: one period from every unit vector, by the code that simulates."""
    n, n_hat, nu = len(plant.A), estimator.F.shape[1], plant.B.shape[1]
    x, x_pred, u = np.split(np.eye(n + n_hat + nu), [n, n + n_hat], axis=1)
    state, estimate = estimator.correct(N, estimator.init(len(x))._replace(x_pred=x_pred), x @ plant.C.T)
    r = np.zeros((controller.preview, 2))
    _, command = controller.control(N, MpcState(u), x @ plant.C.T, estimate, r)
    after = estimator.predict(N, state, command.u).x_pred
    return np.hstack([x @ plant.A.T + command.u @ plant.B.T, after, command.u]).T


@pytest.mark.parametrize("law", ["increment", "printed"])
def test_spectral_radius(law):
    """Of the matrix that one period of the simulated loop amounts to."""
    for seed in range(5):
        estimator, controller, plant = parts(seed, law)
        expected = np.abs(np.linalg.eigvals(probed(estimator, controller, plant))).max()
        found = spectral_radius(plant, linear_pair(estimator, controller))
        np.testing.assert_allclose(found, expected, rtol=1e-10)  # eigenvalues of a matrix that is not symmetric


def test_input_in_terms_of_the_measurement():
    """u = J y + what the past and the reference add, at every k."""
    estimator, controller, plant = parts(1)
    pair = linear_pair(estimator, controller)
    rng = np.random.default_rng(2)
    for k in (0, 3):
        g, x_pred, u, y = pair.at(k), *(rng.standard_normal((1, n)) for n in (3, 2, 2))
        _, estimate = estimator.correct(k, estimator.init(1)._replace(x_pred=x_pred), y)
        r = rng.standard_normal((controller.preview, 2))
        _, command = controller.control(k, MpcState(u), y, estimate, r)
        parts_of_u = (g.J @ y[0], g.from_x_pred @ x_pred[0], g.from_u @ u[0], pair.law.K_r @ r[1:].ravel())
        np.testing.assert_allclose(sum(parts_of_u), command.u[0], rtol=1e-10)  # a sum of terms that may cancel


class OwnLaw(Controller):
    """A controller that declares the gains of another one."""

    def __init__(self, law):
        self.law = law

    def linear_law(self):
        """Return them."""
        return self.law


class Constrained(Controller):
    """A controller with the gains of its unconstrained optimum as attributes; its law is not linear."""

    def __init__(self, law):
        self.K_x, self.K_u, self.K_r, *_ = law


def test_a_linear_law_is_declared():
    """Oracle: the radius of the loop with the bench's controller; attributes with the names of gains do not count."""
    estimator, controller, plant = parts(1)
    law = controller.linear_law()
    expected = spectral_radius(plant, linear_pair(estimator, controller))
    assert spectral_radius(plant, linear_pair(estimator, OwnLaw(law))) == expected
    assert linear_pair(estimator, Constrained(law)) is None


def test_pairs_without_gains_are_not_analysed():
    """Neither an estimator nor a controller has to have gains."""
    estimator, controller, _ = parts(1)
    assert linear_pair(Halfway(), controller) is None
    assert linear_pair(estimator, Proportional()) is None
