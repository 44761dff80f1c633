"""Inverted pendulum: energy, the published linear model, and the observer."""

import numpy as np
import pytest
from examples.example_files import FOLDER, module_of, recursion
from scipy.linalg import solve_discrete_are

import rmpc_bench
from rmpc_bench import load_config
from rmpc_bench.conformance import parametrize_with_checks
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.jacobian import jacobian
from rmpc_bench.types import Parameters

NOMINAL = {"M": 0.5, "m": 0.2, "b": 0.1, "l": 0.3}
PENDULUM = module_of("pendulum")
G = PENDULUM.GRAVITY


@parametrize_with_checks([f"{FOLDER / 'pendulum.py'}:Luenberger"])
def test_component(check):
    check()


@pytest.fixture(scope="module")
def model():
    config = load_config(FOLDER / "pendulum.yaml", smoke=True)
    return config.experiment.methods[0].estimator.sets.model


def test_the_energy_changes_by_the_power_of_force_and_friction():
    """The derivative of the energy along the equations, at random states of a pendulum with random parameters."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        p = Parameters({name: value * rng.uniform(0.5, 2.0) for name, value in NOMINAL.items()})
        x, F = rng.standard_normal(4), 5.0 * rng.standard_normal()
        v, theta, omega = x[1:]
        _, a, _, alpha = PENDULUM.rhs(x, np.array([F]), p)
        ml, inertia = p.m * p.l, 4 / 3 * p.m * p.l**2
        power = (
            (p.M + p.m) * v * a
            + ml * np.cos(theta) * (a * omega + v * alpha)
            - ml * np.sin(theta) * v * omega**2
            + inertia * omega * alpha
            - ml * G * np.sin(theta) * omega
        )
        np.testing.assert_allclose(power, F * v - p.b * v**2, rtol=1e-10, atol=1e-12)


def test_the_linear_model_is_the_published_one(monkeypatch):
    """Control Tutorials, "Inverted Pendulum: State-Space Methods": g = 9.8, and the angle has the other sign there."""
    monkeypatch.setattr(PENDULUM, "GRAVITY", 9.8)
    A = jacobian(lambda x: np.array(PENDULUM.rhs(x, np.zeros(1), Parameters(NOMINAL))), np.zeros(4))
    B = jacobian(lambda u: np.array(PENDULUM.rhs(np.zeros(4), u, Parameters(NOMINAL))), np.zeros(1))
    published = [[0, 1, 0, 0], [0, -0.1818, -2.6727, 0], [0, 0, 0, 1], [0, 0.4545, 31.1818, 0]]
    # Four decimals are printed.
    np.testing.assert_allclose(A, published, atol=5.1e-5)
    np.testing.assert_allclose(B, [[0], [1.8182], [0], [-4.5455]], atol=5.1e-5)


def test_the_pole_upright_is_unstable_and_everything_is_observable(model):
    assert np.sum(np.abs(np.linalg.eigvals(model.A)) > 1.0 + 1e-9) == 1
    assert dict(model.facts())["observable"] == "4 of 4 states"
    assert "steady state, x' = 0" in dict(model.facts())[""]


def test_the_error_of_the_observer_has_the_poles(model):
    poles = [0.5, 0.55, 0.6, 0.65]
    L = PENDULUM.Luenberger(model, poles=poles).L
    found = np.sort(np.linalg.eigvals((np.eye(4) - L @ model.C) @ model.A).real)
    # Poles of a matrix whose entries are about 1e3 times as large.
    np.testing.assert_allclose(found, poles, rtol=1e-8)


def test_the_observer_with_the_stationary_gain_is_kalman():
    """From the stationary covariance on, the gain of `kalman` is constant."""
    model = LinearModel(
        [[0.9, 0.1], [0.0, 0.95]], [[0.0], [0.1]], [[1.0, 0.0]], [1e-3, 1e-2], 4e-2, f0=[0.1, 0.0], d0=[0.5]
    )
    P0 = solve_discrete_are(model.A.T, model.C.T, model.Q_w, model.R_v)
    L = P0 @ model.C.T @ np.linalg.inv(model.C @ P0 @ model.C.T + model.R_v)
    rng, x0 = np.random.default_rng(4), np.array([1.0, -1.0])
    y, u = rng.standard_normal((40, 1)), rng.standard_normal((40, 1))
    kalman = rmpc_bench.estimator("kalman", model, n_steps=40, x0=x0, P0=P0)
    observer, mine = PENDULUM.Luenberger(model, L=L), []
    observer.start(x0)
    for k in range(40):
        mine.append(observer.correct(y[k]))
        observer.predict(u[k])
    # The Riccati equation is solved to about 1e-13, relative.
    np.testing.assert_allclose(mine, recursion(kalman, model, y, u, x0, P0), rtol=1e-9, atol=1e-12)
