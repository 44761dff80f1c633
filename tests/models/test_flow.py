"""Design models as maps of many states: the plant at nominal parameters, with and without friction."""

import pickle

import numpy as np
import pytest
from conftest import ROUND, random_model
from models import pendulum

from rmpc_bench.estimators import extended_kalman, unscented_kalman
from rmpc_bench.models import servo as servo_linear
from rmpc_bench.models.flow import flow_of
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import design as nonlinear
from rmpc_bench.models.servo import CURRENT_VARIANCE, ServoNoise
from rmpc_bench.models.servo import design_nonlinear as servo_model
from rmpc_bench.plants.linear import design as linear_plant
from rmpc_bench.plants.ode import design as ode
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.plants.servo import design as servo_plant
from rmpc_bench.types import DesignError

NOISE, UNIT = DesignNoise(1e-4, 1e-2), ServoNoise(1.0, 1.0)


def one_at_a_time(x, u, p):
    """The pendulum for one run only: math.sin of an array would fail."""
    return [float(each) for each in pendulum.rhs([float(each) for each in x], u, p)]


@pytest.mark.parametrize("rhs", [pendulum.rhs, one_at_a_time], ids=["block", "alone"])
def test_the_flow_of_an_equation_is_the_plant(rng, rhs):
    """Oracle: a step of the plant with nominal parameters, and f(x, u) of the model row by row."""
    names = {"states": pendulum.STATES, "inputs": pendulum.INPUTS, "outputs": ["position"]}
    given = {"output": pendulum.position, "parameters": pendulum.PARAMETERS, "x0": np.zeros(4), **names}
    plant = ode(0.05, 9, ode=rhs, solver=Solver(substeps=4), **given)
    model = nonlinear(0.05, plant, noise=NOISE)
    x, u = 0.3 * rng.standard_normal((13, 4)), rng.standard_normal((13, 1))
    flow = pickle.loads(pickle.dumps(flow_of(model)))
    moved = flow.advance(3, x, u)
    p = {name: np.full(13, value) for name, value in plant.nominal.items()}
    delta = plant.draw(p, [np.random.default_rng(0)] * 13, 9)
    np.testing.assert_allclose(moved, plant.step(3, delta, x, u, np.zeros((13, 4))).x, **ROUND)
    np.testing.assert_allclose(moved, model.f(x, u, 3), **ROUND)
    np.testing.assert_array_equal(flow.measure(0, x), x[:, :1])
    for rows in (slice(0, 1), slice(4, 9)):
        np.testing.assert_array_equal(flow.advance(3, x[rows], u[rows]), moved[rows])


def test_the_flow_of_a_plant_with_matrices(rng):
    """Oracle: the matrices; the output is linear, so that corrections need no points."""
    made = random_model(rng, 3, 2, 2)
    plant = linear_plant(1.0, 5, A=made.A, B=made.B, C=made.C)
    flow = flow_of(nonlinear(1.0, plant, noise=NOISE))
    x, u = rng.standard_normal((6, 3)), rng.standard_normal((6, 2))
    np.testing.assert_allclose(flow.advance(0, x, u), x @ made.A.T + u @ made.B.T, rtol=0, atol=1e-14)  # sums of size 1
    np.testing.assert_array_equal(flow.C_at(0), made.C)
    np.testing.assert_allclose(flow.measure(0, x), x @ made.C.T, rtol=0, atol=1e-14)


def test_the_flow_of_the_servomechanism_is_the_plant(rng):
    """Oracle: the plant at its nominal parameters, bit for bit, moving, starting and at rest."""
    plant, model = servo_plant(0.1), servo_model(0.1, noise=UNIT)
    x, u = rng.standard_normal((40, 5)) * [0.5, 1.0, 10.0, 20.0, 1.0], 60.0 * rng.standard_normal((40, 1))
    x[:5], u[:5] = 0.0, [[0.0], [1.0], [5.0], [20.0], [220.0]]
    delta = plant.draw({name: np.full(40, value) for name, value in plant.nominal.items()}, [], 1)
    np.testing.assert_array_equal(flow_of(model).advance(0, x, u), plant.step(0, delta, x, u, np.zeros((40, 4))).x)


def test_without_friction_and_inductance_the_flow_is_the_linear_model(rng):
    """Oracle: servo-linear; an inductance of 1e-3 H moves a sample by about a thousandth of it."""
    smooth = {f"alpha_{body}{i}": 0.0 for body in "lm" for i in range(3)}
    gaps = []
    for L in (1e-2, 1e-3):
        model = servo_model(0.1, noise=UNIT, L=L, **smooth)
        x, u = rng.standard_normal((8, 4)) * [0.5, 1.0, 10.0, 20.0], 60.0 * rng.standard_normal((8, 1))
        # The current of the linear model, (V - K_t w_m) / R.
        both = np.hstack([x, (u - 10.0 * x[:, 3:]) / 20.0])
        linear = model.at(0)
        gaps.append(np.abs(model.flow.advance(0, both, u)[:, :4] - x @ linear.A.T - u @ linear.B.T).max())
    assert gaps[0] < 0.5 and gaps[1] < 0.15 * gaps[0]


def test_controllers_get_the_linear_model_and_four_states():
    """Oracle: the model servo-linear with the same parameters."""
    model = servo_model(0.1, noise=UNIT, J_l=30.0)
    linear = servo_linear.design(0.1, noise=UNIT, J_l=30.0)
    for name in ("A", "B", "C", "Q_w", "R_v"):
        np.testing.assert_array_equal(getattr(model.at(0), name), getattr(linear, name))
    assert (model.nx, model.nu, model.ny) == (4, 1, 1) and {*model.extra_signals} == {*linear.extra_signals}
    P0 = 2.0 * linear.Q_w
    for module in (extended_kalman, unscented_kalman):
        estimator = module.design(model, 5, x0=np.ones(4), P0=P0)
        state, estimate = estimator.correct(0, estimator.init(3), np.ones((3, 1)))
        assert estimate.x_hat.shape == (3, 4) and estimate.P.shape == (3, 4, 4)
        assert estimate.info["x_all"].shape == (3, *estimator.reports["x_all"]) == (3, 5)
        np.testing.assert_array_equal(estimate.info["x_all"][:, :4], estimate.x_hat)
        np.testing.assert_allclose(state.root[0, 4] @ state.root[0, 4], CURRENT_VARIANCE, rtol=1e-14)
        np.testing.assert_array_equal(estimator.flow.Q_w_at(0)[:4, :4], linear.Q_w)
    with pytest.raises(DesignError, match="increase L"):
        servo_model(0.1, noise=UNIT, L=1e-9)


def test_a_resting_load_moves_for_steps_of_a_standard_deviation_only():
    """With dry friction an infinitesimal step sees a load that sticks: d theta+ = d theta, nothing from its velocity.

    A step of a standard deviation sees a load that slips.  Oracle: the flow itself at two states, and numbers of an
    independent study; the derivative at rest is (1, 0, 0, 0, 0) because sticking bodies stay where they are.
    """
    model = servo_model(0.1, noise=UNIT)
    P0 = np.diag([1.0, 1.0, 1.0, 1.0])
    rows = []
    for spread in (1e-6, 1.0, None):
        estimator = extended_kalman.design(model, 1, x0=np.zeros(4), P0=P0, spread=spread)
        state = estimator.init(1)

        def f(x, flow=estimator.flow):
            return flow.advance(0, x[0], np.zeros((x.shape[1], 1)))[None]

        rows.append(estimator.rule.moments(f, state.x, state.root).image[0, 0] / np.diag(state.root[0]))
    # A load that starts with 1e-6 rad/s stops after some 1e-12 rad.
    np.testing.assert_allclose(rows[0], [1.0, 0.0, 0.0, 0.0, 0.0], rtol=0, atol=1e-5)
    np.testing.assert_allclose(rows[2], [1.0, 0.0, 0.0, 0.0, 0.0], rtol=0, atol=1e-4)
    up, down = (model.flow.advance(0, sign * np.eye(1, 5, 1), np.zeros((1, 1)))[0, 0] for sign in (1.0, -1.0))
    assert rows[1][1] == pytest.approx(0.5 * (up - down), rel=1e-12)
    # The study has three decimals.
    np.testing.assert_allclose(rows[1], [0.765, 0.086, 0.010, 0.0, 0.0], rtol=0, atol=5e-4)
