"""Two tanks: the equations, the outliers, and the moving-horizon estimator."""

from pathlib import Path

import numpy as np
import pytest
from conftest import ROUND, SOLVER
from examples.example_files import FOLDER, module_of, recursion
from scipy.linalg import expm
from scipy.optimize import least_squares

import rmpc_bench
from rmpc_bench import load_config
from rmpc_bench.conformance import parametrize_with_checks
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import Parameters

TEMPLATES = Path(rmpc_bench.__file__).parent / "cli" / "templates"
P = Parameters({"a1": 7.1e-6, "a2": 5.7e-6, "area": 2.8e-3})
TANKS = module_of("tanks")
G = 9.81


@pytest.fixture(scope="module")
def config():
    return load_config(FOLDER / "two-tanks.yaml", smoke=True)


def steady(flow):
    """Levels for a constant flow [ml/s], by hand."""
    return [(1e-6 * flow / a) ** 2 / (2 * G) for a in (P.a1, P.a2)]


@parametrize_with_checks([f"{FOLDER / 'tanks.py'}:{name}" for name in ("MHE", "PI")])
def test_component(check):
    check()


@parametrize_with_checks([f"{FOLDER / 'tanks.py'}:outliers"], "noises")
def test_noise(check):
    check()


@pytest.mark.parametrize("name", ["plant_ode", "noise", "controller_plain"])
def test_it_has_the_components_that_init_writes(name):
    assert (TEMPLATES / f"{name}.txt").read_text(encoding="utf-8") in (FOLDER / "tanks.py").read_text(encoding="utf-8")


@pytest.mark.parametrize("flow", [4.0, 8.0, 12.0])
def test_the_steady_state(flow):
    """The rates vanish against those of the flow, up to rounding."""
    rates = TANKS.rhs(np.array(steady(flow)), np.array([flow]), P)
    np.testing.assert_allclose(rates, 0.0, atol=1e-12 * 1e-6 * flow / P.area)


def test_the_volume_changes_by_inflow_and_outflow():
    x, u = np.array([0.07, 0.12]), np.array([9.0])
    rates = TANKS.rhs(x, u, P)
    outflow = P.a2 * np.sqrt(2 * G * TANKS.output(x, P)[0])
    np.testing.assert_allclose(P.area * sum(rates), 9e-6 - outflow, **ROUND)


def test_the_design_model_has_the_time_constants_of_the_textbook(config):
    """T_i = (A / a_i) sqrt(2 h_i / g), sampled exactly; differences give ten digits."""
    model = config.experiment.methods[0].estimator.sets.model
    h = np.array(steady(8.0))
    T = P.area / np.array([P.a1, P.a2]) * np.sqrt(2 * h / G)
    A, B = np.array([[-1 / T[0], 0.0], [1 / T[0], -1 / T[1]]]), np.array([[1e-6 / P.area], [0.0]])
    sampled = expm(3.0 * np.block([[A, B], [np.zeros((1, 3))]]))
    np.testing.assert_allclose(model.operating_point.x, h, rtol=1e-9)
    np.testing.assert_allclose(model.A, sampled[:2, :2], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(model.B, sampled[:2, 2:], rtol=1e-8)


@pytest.mark.parametrize("Ne", [1, 6])
def test_the_estimator_is_kalman_for_a_linear_model_and_a_large_delta(Ne):
    """Rounding, times the condition of the window."""
    model = LinearModel(
        [[0.9, 0.0], [0.08, 0.93]], [[1e-3], [4e-5]], [[0.0, 1.0]], 1e-6, 4e-6, f0=[1e-3, 2e-3], d0=[0.01]
    )
    rng, x0, P0 = np.random.default_rng(2), np.array([0.1, 0.0]), 1e-4 * np.eye(2)
    y, u = 0.1 + 2e-3 * rng.standard_normal((30, 1)), rng.standard_normal((30, 1))
    kalman = rmpc_bench.estimator("kalman", model, n_steps=30, x0=x0, P0=P0)
    estimator = TANKS.MHE(model, Ne=Ne, delta=1e9, iterations=1)
    estimator.start(x0, P0)
    mine = [estimator.update(y[k], u[k - 1] if k else None) for k in range(30)]
    np.testing.assert_allclose(mine, recursion(kalman, model, y, u, x0, P0), rtol=1e-9)


def window_of(model, delta):
    """An estimator after a full window of data far from the operating point, and the data."""
    estimator = TANKS.MHE(model, Ne=5, delta=delta, iterations=30)
    x0, P0 = np.array([0.03, 0.06]), 1e-4 * np.eye(2)
    estimator.start(x0, P0)
    y = 0.06 + np.array([0.0, 1.0, -1.0, 15.0, 2.0, -1.0]) * 2e-3
    u = np.full((5, 1), 12.0)
    for k in range(6):
        x_hat = estimator.update(y[k : k + 1], u[k - 1] if k else None)
    return x_hat, (x0, P0, y, u)


@pytest.mark.parametrize("delta", [1.5, 1e6])
def test_the_estimate_minimises_the_cost_of_the_window(config, delta):
    """Against a minimiser of SciPy, far from the operating point."""
    model = config.experiment.methods[-1].estimator.given["model"]
    x_hat, (x0, P0, y, u) = window_of(model, delta)

    def residuals(flat):
        x = flat.reshape(6, 2) / 100
        motion = [(x[j + 1] - model.f(x[j], u[j])) / 1e-3 for j in range(5)]
        r = np.abs((y - x[:, 1]) / 2e-3)
        huber = np.where(r <= delta, r**2, 2 * delta * r - delta**2)
        return np.concatenate([(x[0] - x0) / 1e-2, *motion, np.sqrt(huber)])

    best = least_squares(residuals, 100 * np.tile(x0, 6), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(x_hat, best.x[-2:] / 100, **SOLVER)


def test_an_outlier_moves_the_huber_estimate_less(config):
    """The same data, of which one sample is 15 standard deviations away."""
    model = config.experiment.methods[-1].estimator.given["model"]
    quadratic, huber = (window_of(model, delta)[0] for delta in (1e6, 1.5))
    assert huber[1] < quadratic[1] - 1e-3


def test_estimates_stay_within_the_bounds(config):
    """Measurements above the rim of the tank: the level is at its bound and not above it."""
    model = config.experiment.methods[-1].estimator.given["model"]
    estimator = TANKS.MHE(model)
    estimator.start(np.array([0.1, 0.5]), 1e-2 * np.eye(2))
    for k in range(4):
        x_hat = estimator.update(np.array([0.9]), np.array([20.0]) if k else None)
    assert x_hat[1] == 0.6
