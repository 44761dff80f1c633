"""Nonlinear models, models linearised along the trajectory, and models with an equation of their own."""

import math
import pickle

import numpy as np
import pytest
from conftest import EXACT, ROUND
from plants import tanks
from required_keys import REQUIRED
from scipy.integrate import solve_ivp

from rmpc_bench import registry
from rmpc_bench.components.single_estimator import advanced
from rmpc_bench.controllers.gpc import design as gpc
from rmpc_bench.controllers.noise_tuning import LpNoise
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.models.linearised import design as linearise
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import design as nonlinear
from rmpc_bench.models.nonlinear import design_ode as ode_model
from rmpc_bench.models.operating_point import At
from rmpc_bench.plants.linear import design as linear_plant
from rmpc_bench.plants.ode import design as ode_plant
from rmpc_bench.types import DesignError, Estimate

TS, STEPS = 2.0, 12
NOISE = DesignNoise(process=1e-6, measurement=4e-6)


def two_tanks(rhs=tanks.rhs, **keys):
    """Return the tanks as a plant."""
    names = {"states": tanks.STATES, "inputs": tanks.INPUTS, "outputs": tanks.OUTPUTS}
    given = {"ode": rhs, "output": tanks.output, "parameters": tanks.PARAMETERS, **names, **keys}
    return ode_plant(TS, STEPS, bounds={"h1": [0.0, 2.0], "pump": [0.0, 30.0]}, x0=[0.2, 0.1], **given)


def compilable(x, u, p):
    """The tanks, with parameters that compiled code can read."""
    q1, q2 = p.a1 * math.sqrt(2 * tanks.G * x[0]), p.a2 * math.sqrt(2 * tanks.G * x[1])
    return [(p.k * 1e-6 * u[0] - q1) / tanks.S1, (q1 - q2) / tanks.S2]


def oscillator(x, u, p):
    """A linear equation with a constant part."""
    return [x[1], u[0] - 0.3 * x[1] - 0.5 * x[0] + 0.2]


def moved_output(x, p):
    """A linear output with a constant part."""
    return [x[0] + 0.5 * x[1] + 0.7]


def linear():
    """Return the linear equation as a plant."""
    return ode_plant(0.3, STEPS, ode=oscillator, output=moved_output, states=["a", "b"], inputs=["f"], outputs=["y1"])


def test_the_functions_of_the_model_are_those_of_the_nominal_plant():
    """Oracle: scipy's integration with tight tolerances, the equation itself, and differences."""
    plant = two_tanks()
    model, x, u = nonlinear(TS, plant, noise=NOISE), np.array([0.3, 0.1]), np.array([5.0])
    p = plant.ode.p
    exact = solve_ivp(lambda t, z: tanks.rhs(z, u, p), (0.0, TS), x, rtol=1e-12, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(model.f(x, u), exact, rtol=1e-9)
    np.testing.assert_array_equal(model.f(np.tile(x, (3, 1)), u), np.tile(model.f(x, u), (3, 1)))
    np.testing.assert_array_equal(model.h(x), [0.1])
    assert (model.nx, model.nu, model.ny, model.Ts, model.substeps) == (2, 1, 1, TS, plant.ode.substeps)
    assert (model.rhs, model.output, model.p.a1) == (tanks.rhs, tanks.output, tanks.PARAMETERS["a1"])
    np.testing.assert_array_equal(model.x_op, 0.0)
    h = 1e-5
    columns = [(model.f(x + h * e, u) - model.f(x - h * e, u)) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(model.F(x, u), np.array(columns).T, rtol=1e-6)
    np.testing.assert_allclose(model.H(x), [[0.0, 1.0]], rtol=1e-10, atol=1e-10)


def test_f_has_the_matrices_of_the_linear_model_at_the_operating_point():
    """Oracle: `linearise`; f integrates with an error of its own."""
    plant, at = two_tanks(), At(u=8.0, guess=0.1)
    model, expected = nonlinear(TS, plant, noise=NOISE, at=at), linearise(TS, plant, noise=NOISE, at=at)
    np.testing.assert_array_equal(model.x_op, expected.x_op)
    np.testing.assert_allclose(model.f(model.x_op, model.u_op), model.x_op, rtol=1e-12)
    np.testing.assert_allclose(model.F(model.x_op, model.u_op), expected.A, rtol=1e-8, atol=1e-10)
    np.testing.assert_array_equal(model.at(3).A, expected.A)
    np.testing.assert_array_equal(model.deviation.A, expected.A)
    again = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(again.f(model.x_op, [3.0]), model.f(model.x_op, [3.0]))


NONLINEAR = ("extended-kalman", "nonlinear-moving-horizon", "unscented-kalman")
"""Estimators for nonlinear models."""
LINEAR = [
    *(("estimators", kind) for kind in registry.names("estimators") if kind not in NONLINEAR),
    # `pid` of an estimate takes h(x_hat).
    *(("controllers", kind) for kind in registry.names("controllers") if kind != "pid"),
]


@pytest.mark.parametrize(("group", "kind"), LINEAR)
def test_linear_methods_refuse_a_nonlinear_model_with_the_way_out(group, kind):
    """Over the registry; the message names `linearise`."""
    import inspect

    plant = two_tanks()
    model, start = nonlinear(TS, plant, noise=NOISE), {"x0": np.zeros(2), "P0": np.eye(2), "M0": np.eye(2)}
    filter_ = kalman(linearise(TS, plant, noise=NOISE, at=At(u=8.0, guess=0.1)), STEPS, x0=np.zeros(2), P0=np.eye(2))
    provided = {"n_steps": STEPS, "plant": plant, "estimator": filter_, "Ts": TS, **start}
    make = registry.get(group, kind)
    given = {name: value for name, value in provided.items() if name in inspect.signature(make).parameters}
    with pytest.raises(DesignError, match="linearise|uncertain matrices"):
        make(model, **given, **REQUIRED.get(kind, {}))


@pytest.mark.long
def test_a_compiled_model_is_the_same_and_faster_to_call():
    """Oracle: the model that is not compiled."""
    plant = two_tanks(compilable)
    plain, compiled = (nonlinear(TS, plant, noise=NOISE, numba=numba) for numba in (False, True))
    x, u = np.array([0.3, 0.1]), np.array([5.0])
    np.testing.assert_allclose(compiled.f(x, u), plain.f(x, u), **ROUND)
    again = pickle.loads(pickle.dumps(compiled))
    np.testing.assert_allclose(again.f(x, u), compiled.f(x, u), **EXACT)


@pytest.mark.long
def test_what_cannot_be_compiled_is_refused():
    """Compiled code cannot read p["a2"]."""
    with pytest.raises(DesignError, match="rhs cannot be compiled") as found:
        nonlinear(TS, two_tanks(), noise=NOISE, numba=True)
    assert found.value.parameter == "numba"
    with pytest.raises(DesignError, match="no effect"):
        nonlinear(TS, linear_plant(TS, 5, A=[0.5], B=[[1.0]], C=[[1.0]]), noise=NOISE, numba=True)


def measured(rng, n_runs, ny):
    """Return outputs and inputs of a few runs near an operating point of the tanks."""
    return 0.1 + 0.01 * rng.standard_normal((n_runs, STEPS + 1, ny)), 8.0 + rng.standard_normal((n_runs, STEPS + 1, 1))


def filtered(estimator, y, u):
    """Estimates and covariances of a filter."""
    state, found = estimator.init(len(y)), []
    for k in range(y.shape[1]):
        state, estimate = estimator.correct(k, state, y[:, k])
        found.append((estimate.x_hat, np.broadcast_to(estimate.P, (len(y), *estimate.P.shape[-2:]))))
        state = estimator.predict(k, state, u[:, k])
    return [np.stack(parts, axis=1) for parts in zip(*found, strict=True)]


def test_kalman_on_a_trajectory_is_the_extended_kalman_filter(rng):
    """Oracle: the textbook filter, written for one run with derivatives in closed form."""
    plant, x0 = two_tanks(), np.array([0.2, 0.1])
    model = linearise(TS, plant, noise=NOISE, at="trajectory")
    y, u = measured(rng, 3, 1)
    found, P_found = filtered(kalman(model, STEPS, x0=x0, P0=1e-4 * np.eye(2)), y, u)
    f = nonlinear(TS, plant, noise=NOISE).f
    for run in range(3):
        x, P, C = x0, 1e-4 * np.eye(2), np.array([[0.0, 1.0]])
        for k in range(STEPS + 1):
            L = P @ C.T / (C @ P @ C.T + 4e-6)
            x, P = x + L[:, 0] * (y[run, k, 0] - x[1]), (np.eye(2) - L @ C) @ P
            np.testing.assert_allclose(found[run, k], x, rtol=1e-8)
            np.testing.assert_allclose(P_found[run, k], P, rtol=1e-6, atol=1e-14)
            slope = [tanks.PARAMETERS[name] / tanks.S1 * math.sqrt(tanks.G / (2 * h))
                     for name, h in zip(("a1", "a2"), x, strict=True)]  # fmt: skip
            a, b = (math.exp(-s * TS) for s in slope)
            A = np.array([[a, 0.0], [slope[0] * (a - b) / (slope[1] - slope[0]), b]])
            x, P = f(x, u[run, k]), A @ P @ A.T + 1e-6 * np.eye(2)


def test_an_equation_that_depends_on_time_is_linearised_in_its_sample():
    """Oracle: the growth over sample 3 of x' = 0.02 t x + 0.02 t; at t = 0 nothing would grow."""
    plain = linear_plant(TS, 5, A=[0.5], B=[[1.0]], C=[[1.0]])
    keys = {"ode": lambda t, x, u, p: [0.02 * t * (x[0] + 1.0)], "states": 1, "inputs": 1, "noise": NOISE}
    now = ode_model(TS, plain, **keys, at="trajectory").around(3, np.array([[0.5]]), np.zeros((1, 1)))
    growth = np.exp(0.01 * TS**2 * (4**2 - 3**2))
    np.testing.assert_allclose([now.A.item(), now.f.item()], [growth, growth - 1.0], rtol=1e-9)
    fixed = ode_model(TS, plain, **keys, at=At(x=0.5, u=0.0))
    assert any("that of t = 0" in remark for remark in fixed.remarks)
    np.testing.assert_allclose(fixed.A, 1.0, **ROUND)


def test_a_run_on_a_trajectory_is_the_run_alone(rng):
    """Bit for bit; a run whose estimate leaves the domain is NaN and leaves the others alone."""
    model = linearise(TS, two_tanks(), noise=NOISE, at="trajectory")
    estimator = kalman(model, STEPS, x0=np.array([0.2, 0.1]), P0=1e-4 * np.eye(2))
    y, u = measured(rng, 5, 1)
    y[2, 4] = -3.0
    with np.errstate(all="ignore"):
        x_hat, P = filtered(estimator, y, u)
        for run in range(5):
            alone = filtered(estimator, y[run : run + 1], u[run : run + 1])
            np.testing.assert_array_equal(x_hat[run], alone[0][0])
            np.testing.assert_array_equal(P[run], alone[1][0])
    assert np.isnan(x_hat[2, -1]).all()
    assert np.isfinite(np.delete(x_hat, 2, axis=0)).all()


def test_a_linear_equation_on_a_trajectory_is_the_linear_model(rng):
    """Oracle: `linearise` at 0, in the Kalman filter and in gpc, with constant parts of state and output."""
    on_trajectory = linearise(0.3, linear(), noise=NOISE, at="trajectory")
    fixed = linearise(0.3, linear(), noise=NOISE, at=At(x=0.0, u=0.0))
    y, u = rng.standard_normal((2, STEPS + 1, 1)), rng.standard_normal((2, STEPS + 1, 1))
    start = {"x0": np.zeros(2), "P0": np.eye(2)}
    for found, expected in zip(
        *(filtered(kalman(m, STEPS, **start), y, u) for m in (on_trajectory, fixed)), strict=True
    ):
        # f has 1e-6 of the range, x and y are of size 1.
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    laws = [gpc(m, STEPS, Np=5, Q_yw=1.0, Q_u=0.2) for m in (on_trajectory, fixed)]
    states = [law.init(2) for law in laws]
    for k in range(3):
        estimate = Estimate(rng.standard_normal((2, 2)), None, None, np.zeros(2, dtype=np.int8), {})
        r, inputs = rng.standard_normal((6, 1)), []
        for i, law in enumerate(laws):
            states[i], command = law.control(k, states[i], y[:, k], estimate, r)
            inputs.append(command.u)
        np.testing.assert_allclose(inputs[0], inputs[1], rtol=1e-7, atol=1e-9)


def test_what_does_not_support_a_trajectory_says_so():
    """With the way out."""
    model = linearise(TS, two_tanks(), noise=NOISE, at="trajectory")
    with pytest.raises(DesignError, match="use kalman"):
        registry.get("estimators", "lp-window")(model, STEPS, x0=np.zeros(2))
    with pytest.raises(DesignError, match="the estimator kalman or the controller gpc"):
        registry.get("controllers", "mpc")(model, **REQUIRED["mpc"])
    with pytest.raises(DesignError, match="at: trajectory"):
        gpc(model, STEPS, **REQUIRED["gpc"], tuning=LpNoise(Ne2=4, kp=0.3))
    with pytest.raises(DesignError, match="no effect"):
        linearise(TS, two_tanks(), noise=NOISE, at="trajectory", jacobian=tanks.rhs)


def one_tank(x, u, p):
    """A simpler model of the tanks: one tank with the outflow of the second one."""
    return [(p.k * 1e-6 * u[0] - p.a2 * np.sqrt(2 * tanks.G * x[0])) / (tanks.S1 + tanks.S2)]


def test_a_model_with_an_equation_of_its_own():
    """Oracle: its steady state in closed form; parameters that are given replace those of the plant."""
    keys = {"ode": one_tank, "states": ["level"], "noise": NOISE}
    model = ode_model(TS, two_tanks(), **keys, parameters={"a2": 6e-6}, at=At(u=8.0, guess=0.1))
    np.testing.assert_allclose(model.x_op, (8e-6 / 6e-6) ** 2 / (2 * tanks.G), rtol=1e-10)
    assert model.nx == 1
    free = ode_model(TS, two_tanks(), **keys)
    assert (free.p.a2, free.p.a1) == (tanks.PARAMETERS["a2"], tanks.PARAMETERS["a1"])
    assert free.f(np.array([0.1]), np.array([8.0])).shape == (1,)
    moving = ode_model(TS, two_tanks(), **keys, at="trajectory")
    assert moving.around(0, np.array([[0.1]]), np.array([[8.0]])).A.shape == (1, 1, 1)


def test_mistakes_in_a_model_with_an_equation_of_its_own():
    """Sizes of inputs and outputs are those of the plant; names are needed beside another plant."""
    with pytest.raises(DesignError, match="those of the plant: 1 and 1"):
        ode_model(TS, two_tanks(), ode=tanks.rhs, noise=NOISE)
    with pytest.raises(DesignError, match="no ODE plant") as found:
        ode_model(TS, linear_plant(TS, 5, A=[0.5], B=[[1.0]], C=[[1.0]]), ode=one_tank, noise=NOISE)
    assert found.value.parameter == "states"
    plain = ode_model(TS, linear_plant(TS, 5, A=[0.5], B=[[1.0]], C=[[1.0]]), ode=lambda x, u, p: [u[0] - x[0]],
                      states=1, inputs=1, noise=NOISE)  # fmt: skip
    np.testing.assert_allclose(plain.f([1.0], [1.0]), 1.0, **ROUND)


def test_a_held_step_moves_the_estimate_along_the_trajectory():
    """Oracle: f, and its Jacobian for P."""
    plant = two_tanks()
    model, free = linearise(TS, plant, noise=NOISE, at="trajectory"), nonlinear(TS, plant, noise=NOISE)
    x, P, u = np.array([0.2, 0.1]), 1e-4 * np.eye(2), np.array([8.0])
    x_next, P_next = advanced(model, 0, x, P, u)
    np.testing.assert_allclose(x_next, free.f(x, u), **ROUND)
    A = free.F(x, u)
    # The linearisation holds the Jacobian of the equation over the sample.
    np.testing.assert_allclose(P_next, A @ P @ A.T + 1e-6 * np.eye(2), rtol=1e-2)
    x_next, P_next = advanced(free, 0, x, P, u)
    np.testing.assert_allclose(x_next, free.f(x, u), **EXACT)
    np.testing.assert_allclose(P_next, A @ P @ A.T + 1e-6 * np.eye(2), **EXACT)


def test_a_held_step_of_an_equation_that_depends_on_time_uses_the_sample():
    """Oracle: the solution of x' = 0.02 t x over [k Ts, (k+1) Ts]."""
    plain = linear_plant(TS, 5, A=[0.5], B=[[1.0]], C=[[1.0]])
    keys = {"ode": lambda t, x, u, p: [0.02 * t * x[0]], "states": 1, "inputs": 1, "noise": NOISE, "substeps": 100}
    model = ode_model(TS, plain, **keys)
    growth = np.exp(0.01 * TS**2 * (3**2 - 2**2))
    x_next, P_next = advanced(model, 2, np.array([1.0]), np.eye(1), np.zeros(1))
    # Fourth order in a step of TS / 100.
    np.testing.assert_allclose(x_next, growth, rtol=1e-6)
    np.testing.assert_allclose(P_next[0], growth**2 + model.Q_w[0], rtol=1e-6)
