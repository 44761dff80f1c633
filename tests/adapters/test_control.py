"""Systems of python-control as plants and models, its gains, and plants as its systems."""

import pickle

import numpy as np
import pytest

pytest.importorskip("control")

import control
from adapters import control_systems as systems
from conftest import ROUND, random_model
from scipy.linalg import solve_discrete_are
from small_experiment import write

from rmpc_bench import load_config
from rmpc_bench.adapters.control import model, plant, system
from rmpc_bench.adapters.control_gains import lqe, lqr
from rmpc_bench.controllers.state_feedback import lqr as own_lqr
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.models.linearised import design as linearised
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.operating_point import At
from rmpc_bench.plants.linear import ParametricLinear
from rmpc_bench.plants.linear import design as linear
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.plants.uncertain_linear import UncertainLinear
from rmpc_bench.types import DesignError

NOISE = DesignNoise(1e-6, 4e-6)
TANKS = {"bounds": systems.BOUNDS, "x0": systems.X0}


def tanks(**keys):
    """The tanks of python-control as a plant."""
    return plant(systems.TS, 100, control=systems.tanks(), **TANKS, **keys)


def test_a_nonlinear_system_is_the_ode_plant_bit_for_bit():
    """Oracle: the plant `ode` with the same equations, for a block and for every run alone."""
    ours, theirs = systems.ode_tanks(), tanks()
    assert theirs.ode.rhs_takes_blocks and theirs.ode.places() == ours.ode.places()
    assert theirs.nominal == systems.PARAMETERS
    np.testing.assert_array_equal(systems.trajectory(theirs), systems.trajectory(ours))


@pytest.mark.parametrize("solver", [Solver(substeps=3), Solver("LSODA")])
def test_every_solver(solver):
    """Oracle: the plant `ode` with this solver."""
    ours, theirs = (
        systems.trajectory(each, n_runs=2, n_steps=5)
        for each in (systems.ode_tanks(solver=solver), tanks(solver=solver))
    )
    np.testing.assert_array_equal(theirs, ours)


def test_a_system_of_systems_is_called_run_by_run():
    """Oracle: a Runge-Kutta loop around `dynamics` of python-control, for every run alone."""
    made, inner = (systems.with_actuator() for _ in range(2))
    bench = plant(systems.TS, 10, control=made, solver=Solver(substeps=4), x0=[0.1, 0.1, 5.0])
    assert "takes one run at a time" in bench.remarks[0]
    assert bench.ode.states == ("tanks_h1", "tanks_h2", "pump_flow")
    rng = np.random.default_rng(4)
    p = {name: value * rng.uniform(0.9, 1.1, 3) for name, value in bench.nominal.items()}
    x, u = np.array([0.1, 0.1, 5.0]) * rng.uniform(0.9, 1.1, (3, 3)), rng.uniform(4.0, 9.0, (3, 1))
    found = bench.step(0, bench.draw(p, [], 1), x, u, np.zeros((3, 3))).x
    for i in range(3):
        params, z, h = {name: values[i] for name, values in p.items()}, x[i], systems.TS / 4
        for _ in range(4):
            k1 = inner.dynamics(0.0, z, u[i], params)
            k2 = inner.dynamics(0.0, z + h / 2 * k1, u[i], params)
            k3 = inner.dynamics(0.0, z + h / 2 * k2, u[i], params)
            z = z + h / 6 * (k1 + 2 * (k2 + k3) + inner.dynamics(0.0, z + h * k3, u[i], params))
        np.testing.assert_array_equal(found[i], z)


def test_a_discrete_system_is_a_map():
    """Oracle: the map written out; `dt = True` stands for any sampling time."""
    rule = {"states": ["a"], "inputs": ["v"], "params": {"b": 0.5}}
    for dt in (systems.TS, True):
        made = control.nlsys(lambda t, x, u, params: [0.9 * x[0] + params["b"] * u[0] + t], None, dt=dt, **rule)
        bench = plant(systems.TS, 10, control=made)
        delta = bench.draw({"b": np.array([0.5, 0.7])}, [], 1)
        x = bench.step(2, delta, np.array([[1.0], [2.0]]), np.array([[1.0], [3.0]]), np.zeros((2, 1))).x
        np.testing.assert_allclose(x[:, 0], [0.9 + 0.5 + 6.0, 1.8 + 2.1 + 6.0], **ROUND)


def test_linear_systems_are_sampled_exactly():
    """Oracle: scipy's zero-order hold through `sample` of python-control, for every run with its own parameters."""
    bench = plant(0.1, 10, control=systems.oscillator)
    assert isinstance(bench, ParametricLinear) and bench.nominal == {"m": 1.0, "k": 2.0, "d": 0.3}
    assert bench.names == {"x.0": "place", "x.1": "speed", "u.0": "force", "y.0": "place"}
    k = np.array([1.0, 2.0, 3.0])
    delta = bench.draw({"m": np.ones(3), "k": k, "d": np.full(3, 0.3)}, [], 1)
    for i in range(3):
        exact = systems.oscillator(k=k[i]).sample(0.1)
        np.testing.assert_allclose(delta.A[i], exact.A, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(delta.B[i], exact.B, rtol=1e-12, atol=1e-15)
    assert bench.linear({"m": 1.0, "k": 1.0, "d": 0.3}).A.tolist() == delta.A[0].tolist()


def test_a_fixed_linear_system_is_the_plant_linear():
    """Oracle: the plant `linear` with the sampled matrices, bit for bit; with bounds of the input the general plant."""
    fixed = plant(0.1, 10, control=systems.oscillator())
    A, B, C = fixed.system.at(0).A, fixed.system.at(0).B, fixed.system.at(0).C
    same = linear(0.1, 10, A=A.tolist(), B=B.tolist(), C=C.tolist())
    wide = plant(0.1, 10, control=systems.oscillator(), bounds={"force": (-1e3, 1e3)})
    assert isinstance(fixed, UncertainLinear) and isinstance(wide, ParametricLinear)
    np.testing.assert_array_equal(systems.trajectory(fixed), systems.trajectory(same))
    np.testing.assert_array_equal(systems.trajectory(wide), systems.trajectory(same))


def test_a_transfer_function_has_the_response_of_the_library():
    """Oracle: the step response of python-control; the states do not depend on whether slycot is installed."""
    made = control.tf([2.0, 1.0], [1.0, 0.6, 1.0])
    bench = plant(0.1, 50, control=made)
    x, y = np.zeros((1, 2)), []
    delta = bench.draw({}, [np.random.default_rng(0)], 50)
    for k in range(50):
        y.append(bench.output(k, delta, x, np.zeros((1, 1)))[0, 0])
        x = bench.step(k, delta, x, np.ones((1, 1)), np.zeros((1, 2))).x
    expected = control.step_response(made, 0.1 * np.arange(50)).outputs
    np.testing.assert_allclose(y, expected, rtol=1e-10, atol=1e-12)


def test_models():
    """Oracle: the models of the bench with the same equations."""
    A, B, C = (getattr(systems.oscillator().sample(0.1), name) for name in "ABC")
    bench = plant(0.1, 10, control=systems.oscillator)
    made = model(0.1, bench, control=systems.oscillator, noise=NOISE)
    for name, expected in (("A", A), ("B", B), ("C", C)):
        np.testing.assert_allclose(getattr(made, name), expected, rtol=1e-12, atol=1e-15)
    stiff = model(0.1, bench, control=systems.oscillator, parameters={"k": 9.0}, noise=NOISE)
    np.testing.assert_allclose(stiff.A, systems.oscillator(k=9.0).sample(0.1).A, rtol=1e-12)
    at = At(u=8.0, guess=0.1)
    ours = linearised(systems.TS, systems.ode_tanks(), at=at, noise=NOISE)
    for theirs in (
        linearised(systems.TS, tanks(), at=at, noise=NOISE),
        model(systems.TS, tanks(), control=systems.tanks(), at=at, noise=NOISE),
    ):
        np.testing.assert_array_equal(theirs.A, ours.A)
        np.testing.assert_array_equal(theirs.operating_point.x, ours.operating_point.x)
        assert theirs.remarks == ()
    nonlinear = model(systems.TS, tanks(), control=systems.tanks(), noise=NOISE)
    np.testing.assert_allclose(nonlinear.F(ours.x_op, ours.u_op), ours.A, rtol=1e-6)  # of error control


@pytest.mark.parametrize("noun", ["states", "inputs", "outputs"])
@pytest.mark.parametrize("is_linear", [True, False])
def test_a_model_with_the_names_of_the_plant_in_another_order_is_refused(noun, is_linear):
    """Its columns would act on the other input, its rows be compared with the other state."""

    def made(**other):
        names = {"states": ["h", "q"], "inputs": ["a", "b"], "outputs": ["y1", "y2"], **other}
        matrices = -np.diag([1.0, 2.0]), np.eye(2), np.eye(2)
        if is_linear:
            return control.ss(*matrices, np.zeros((2, 2)), **names)
        return control.nlsys(lambda t, x, u, params: matrices[0] @ x + u, lambda t, x, u, params: x, **names)

    bench = plant(0.1, 10, control=made())
    swapped = {"states": ["q", "h"], "inputs": ["b", "a"], "outputs": ["y2", "y1"]}[noun]
    at = {} if is_linear else {"at": At(u=[0.0, 0.0])}
    model(0.1, bench, control=made(), noise=NOISE, **at)
    model(0.1, bench, control=made(**{noun: ["v", "w"]}), noise=NOISE, **at)
    with pytest.raises(DesignError, match=f"has the {noun} {', '.join(swapped)}; the order of the plant") as caught:
        model(0.1, bench, control=made(**{noun: swapped}), noise=NOISE, **at)
    assert caught.value.parameter == "control"


def test_names_of_a_linear_plant_in_an_operating_point():
    """Oracle: the static gain 1/k."""
    bench = plant(0.1, 10, control=systems.oscillator)
    made = linearised(0.1, bench, at=At(u={"force": 4.0}), noise=NOISE)
    np.testing.assert_allclose(made.operating_point.x, [2.0, 0.0], atol=1e-12)


SIZES = [(1, 1, 1), (2, 1, 1), (3, 2, 2), (5, 2, 3)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("form", ["filter", "predictor"])
def test_lqe_is_the_converged_kalman_filter(size, form):
    """Oracle: `kalman` after 500 samples: gains, covariances and, from then on, estimates."""
    nominal = random_model(np.random.default_rng(5), *size, 0.9)
    start = {"x0": np.ones(size[0])}
    ours = kalman(nominal, 500, P0=nominal.Q_w, form=form, **start)
    theirs = lqe(nominal, 500, form=form, **start)
    for name in ("K", "L", "P", "S"):
        own = getattr(ours, name)[-1]
        np.testing.assert_allclose(getattr(theirs, name)[0], own, rtol=0, atol=1e-12 * max(1.0, np.abs(own).max()))


def test_the_gain_of_dlqe_is_that_of_the_predictor():
    """The naive filter, which corrects x_pred by the gain of `dlqe`, has a larger error."""
    nominal = random_model(np.random.default_rng(6), 2, 1, 1, 0.9)
    K, P, _ = control.dlqe(nominal.A, np.eye(2), nominal.C, nominal.Q_w, nominal.R_v)
    made = lqe(nominal, 10, x0=np.zeros(2))
    np.testing.assert_array_equal(made.K[0], K)
    np.testing.assert_allclose(nominal.A @ made.L[0], K, rtol=1e-12, atol=1e-15)

    def error(L):
        rest = np.eye(2) - L @ nominal.C
        return np.trace(rest @ P @ rest.T + L @ nominal.R_v @ L.T)

    assert np.abs(made.L[0] - K).max() > 1e-2
    assert error(K) > 1.001 * error(made.L[0])
    np.testing.assert_allclose(error(made.L[0]), np.trace(made.P[0]), **ROUND)


@pytest.mark.parametrize("size", SIZES)
def test_lqr_is_lqr_with_a_long_horizon(size):
    """Oracle: `lqr` over 1000 samples, and the Riccati equation."""
    nominal = random_model(np.random.default_rng(7), *size, 0.9)
    filtered = kalman(nominal, 1, x0=np.zeros(size[0]), P0=nominal.Q_w)
    weights = {"Q_x": 1.0, "R_u": 0.1}
    ours, theirs = own_lqr(nominal, 1, filtered, horizon=1000, **weights), lqr(nominal, 1, filtered, **weights)
    np.testing.assert_allclose(theirs.K[0], ours.K[0], rtol=0, atol=1e-12 * np.abs(ours.K).max())
    A, B, nx, nu = nominal.A, nominal.B, *size[:2]
    X = solve_discrete_are(A, B, np.eye(nx), 0.1 * np.eye(nu))
    np.testing.assert_allclose(theirs.K[0], np.linalg.solve(0.1 * np.eye(nu) + B.T @ X @ B, B.T @ X @ A), rtol=1e-9)


def test_lqr_regulates_to_the_operating_point():
    """Oracle: u = u_op - K (x_hat - x_op), as `lqr`."""
    made = linearised(systems.TS, tanks(), at=At(u=8.0, guess=0.1), noise=NOISE)
    filtered = lqe(made, 10, x0=made.x_op)
    law = lqr(made, 10, filtered, Q_x=1.0, R_u=1e-3)
    _, estimate = filtered.correct(0, filtered.init(1), made.y_op[None] + 0.01)
    _, command = law.control(0, law.init(1), made.y_op[None], estimate, np.zeros((1, 1)))
    np.testing.assert_allclose(command.u[0], made.u_op - law.K[0] @ (estimate.x_hat[0] - made.x_op), **ROUND)
    np.testing.assert_array_equal(law.regulates_to, made.y_op)


def test_gains_that_there_are_not():
    """Every reason is a design error."""
    given = control.ss([[1.0, 0.0], [0.0, -1.0]], [[1.0], [1.0]], [[0.0, 1.0]], 0)
    unstable = model(0.1, tanks(), control=given, noise=NOISE)
    with pytest.raises(DesignError, match="finds no stationary gain"):
        lqe(unstable, 10, x0=np.zeros(2))
    with pytest.raises(DesignError, match="positive definite"):
        lqr(unstable, 10, kalman(unstable, 1, x0=np.zeros(2), P0=np.eye(2)), Q_x=1.0, R_u=0.0)


def _unobservable():
    from rmpc_bench.adapters.control import linear as read
    from rmpc_bench.models.library_systems import parametric_system

    given = control.ss([[1.0, 0.0], [0.0, -1.0]], [[1.0], [1.0]], [[0.0, 1.0]], 0)
    return (parametric_system(given, read, {}, "control"),)


def test_a_linear_plant_as_a_system():
    """Round trip: matrices and names stay."""
    bench = plant(0.1, 10, control=systems.oscillator())
    made = system(bench)
    assert isinstance(made, control.StateSpace) and made.dt == 0.1 and made.state_labels == ["place", "speed"]
    again = plant(0.1, 10, control=made)
    np.testing.assert_array_equal(systems.trajectory(again), systems.trajectory(bench))


def test_an_ode_plant_as_a_system():
    """Round trip: the trajectories of runs with parameters of their own stay, bit for bit."""
    made = system(systems.ode_tanks())
    assert isinstance(made, control.NonlinearIOSystem) and made.isctime() and made.params == systems.PARAMETERS
    assert (made.state_labels, made.input_labels, made.output_labels) == (["h1", "h2"], ["pump"], ["level"])
    again = plant(systems.TS, 100, control=made, **TANKS)
    np.testing.assert_array_equal(systems.trajectory(again), systems.trajectory(systems.ode_tanks()))
    # Its own parameters, and the bounds of its input.
    np.testing.assert_allclose(
        made.dynamics(0.0, systems.X0, [99.0], {"a1": 1e-5}),
        systems.update(0.0, systems.X0, [30.0], {**systems.PARAMETERS, "a1": 1e-5}),
        **ROUND,
    )


def test_the_servo_as_a_system():
    """Step response in python-control equal to that of the bench; friction is in it."""
    from rmpc_bench.plants.servo import design as servo

    bench = servo(0.1)
    made = system(bench)
    assert made.dt == 0.1 and made.nstates == 5 and "alpha_l1" in made.params
    times = 0.1 * np.arange(40)
    u = np.where(times < 2.0, 50.0, 0.0)
    theirs = control.input_output_response(made, times, u, np.zeros(5))
    x, delta = np.zeros((1, 5)), bench.draw({name: np.array([each]) for name, each in bench.nominal.items()}, [], 1)
    for k in range(40):
        np.testing.assert_array_equal(theirs.states[:, k], x[0])
        x = bench.step(k, delta, x, u[k : k + 1, None], np.zeros((1, 4))).x
    assert np.abs(theirs.outputs).max() > 0.1


def test_a_configuration_as_a_system(tmp_path):
    """A path or a loaded configuration; the linear servomechanism is a StateSpace."""
    path = write(tmp_path)
    for given in (path, str(path), load_config(path)):
        made = system(given)
        assert isinstance(made, control.StateSpace) and made.nstates == 4 and made.dt == 0.1


def test_a_plant_with_a_memory_is_refused():
    """Its state is not all that it knows."""
    from components.one_run import designed

    from rmpc_bench import single_run

    @single_run
    class Counter:
        nx, nu, ny = 1, 1, 1

        def start(self):
            self.n = 0

        def step(self, x, u):
            self.n += 1
            return x + self.n

        def output(self, x):
            return x

    with pytest.raises(DesignError, match="memory besides its state"):
        system(designed("plants", Counter))


def test_pickling():
    """A plant of named functions can be sent anywhere."""
    again = pickle.loads(pickle.dumps(tanks()))
    np.testing.assert_array_equal(systems.trajectory(again), systems.trajectory(tanks()))


def test_a_linear_system_has_no_parameters():
    """The message says how to write one that has."""
    system = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(DesignError, match="a linear system has no parameters; name a function of m") as raised:
        plant(0.1, 5, control=system, parameters={"m": 1.0})
    assert raised.value.parameter == "parameters.m"
