"""Two tanks: the equations, the outliers, and the window of the moving-horizon estimator."""

from pathlib import Path

import numpy as np
import pytest
from conftest import ROUND, SOLVER
from examples.example_files import FOLDER, module_of
from scipy.linalg import expm
from scipy.optimize import least_squares

import rmpc_bench
from rmpc_bench import load_config
from rmpc_bench.conformance import parametrize_with_checks
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


@parametrize_with_checks([f"{FOLDER / 'tanks.py'}:{name}" for name in ("PI",)])
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


@pytest.mark.long
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


def test_the_built_in_estimator_minimises_the_cost_of_the_window(config):
    """Against a minimiser of SciPy, far from the operating point."""
    estimator = config.experiment.method("MHE").estimator
    flow, x0, u = estimator.flow, np.array([0.03, 0.06]), np.full((6, 1), 12.0)
    y = 0.06 + np.array([0.0, 1.0, -1.0, 15.0, 2.0, -1.0]) * 2e-3
    state = estimator.init(1)
    state = state._replace(x=x0[None, None], x_bar=x0[None, None])
    for k in range(6):
        state, estimate = estimator.correct(k, state, y[k].reshape(1, 1))
        state = estimator.predict(k, state, u[:1])

    def residuals(flat):
        x = flat.reshape(6, 2) / 100
        motion = (x[1:] - flow.advance(0, x[:-1], u[:5])) / 1e-3
        return np.concatenate([(x[0] - x0) / 1e-2, motion.ravel(), (y - x[:, 1]) / 2e-3])

    best = least_squares(residuals, 100 * np.tile(x0, 6), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(estimate.x_hat[0], best.x[-2:] / 100, **SOLVER)


def test_estimates_stay_within_the_bounds(config):
    """Measurements above the rim of the tank: the level is at its bound and not above it."""
    estimator = config.experiment.method("MHE").estimator
    state = estimator.init(1)
    for k in range(4):
        state, estimate = estimator.correct(k, state, np.array([[0.9]]))
        state = estimator.predict(k, state, np.array([[20.0]]))
    assert estimate.x_hat[0, 1] == 0.6
