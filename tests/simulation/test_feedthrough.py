"""Outputs that depend on the input that acts, y = C x + D u or g(x, u, p): filters, laws, delays, and refusals."""

import numpy as np
import pytest
import yaml
from conftest import ROUND, SOLVER
from scipy import signal
from scipy.linalg import solve_discrete_are

from rmpc_bench import estimator, filter_data, load_config
from rmpc_bench.controllers import lqg, mpc
from rmpc_bench.models.disturbance import Disturbance
from rmpc_bench.models.disturbed import with_disturbance
from rmpc_bench.models.dynamics import dynamics_of
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.plants.nominal_step import NominalStep
from rmpc_bench.simulation.closed_loop import simulate, simulate_block
from rmpc_bench.simulation.episode import Episode
from rmpc_bench.simulation.linear_loop import applies
from rmpc_bench.types import ConfigError, DesignError

FILE = """
import numpy as np
from scipy import signal

def rhs(x, u, p):
    return [0.5 * x[0] + u[0]]

def g(x, u, p):
    return [2 * x[0] + 3 * u[0]]

def alone(x, u, p):
    return [2 * float(x[0]) + 3 * float(u[0])]

def old(x, p):
    return [2 * x[0]]

def turned(x, u, p):
    y = 2 * x[0] + 3 * u[0]
    return [np.arctan2(np.sin(y), np.cos(y))]

def drift(x, u, p):
    return [u[0] - x[0]]

def mixed(x, u, p):
    return [x[0] + 3 * u[0]]

def bent(x, u, p):
    return [2 * x[0] + 3 * u[0] + 0.2 * np.sin(x[0]) * u[0] ** 2]

system = signal.dlti([[0.5]], [[1.0]], [[2.0]], [[3.0]], dt=1.0)

def family(d=3.0):
    return signal.dlti([[0.5]], [[1.0]], [[2.0]], [[d]], dt=1.0)
"""
LINEAR = {"kind": "linear", "A": [[0.5]], "B": [[1]], "C": [[2]], "D": [[3]]}
ODE = {"ode": "m.py:rhs", "output": "m.py:g", "discrete": True, "states": 1, "inputs": 1, "outputs": 1}
ALONE = {**ODE, "output": "m.py:alone"}
PLANTS = [LINEAR, {"scipy": "m.py:system"}, {"scipy": "m.py:family", "parameters": {"d": 3}}, ODE, ALONE]
QUIET = {"process": {"gaussian": {"std": 0}}, "measurement": {"gaussian": {"std": 0}}}
NOISY = {"process": {"gaussian": {"std": 0.1}}, "measurement": {"gaussian": {"std": 0.2}}}
DESIGN = {"noise": {"process": 0.01, "measurement": 0.04}}
MODEL = {"from": "plant", "P_w": 0.01, "P_v": 0.04}
STEPS = {"kind": "steps", "times": [0, 1, 2, 3], "values": [1, 2, -1, 0]}
LQR = {"kind": "control-lqr", "Q_x": 1, "R_u": 1}
MPC = {"kind": "mpc", "Hp": 5, "Hu": 3, "Q": 1, "R": 0.5}
CASE = {
    "version": 1, "name": "fed", "runs": 1, "seed": 1, "time": {"steps": 4},
    "plant": LINEAR, "model": {"from": "plant", "P_w": 0, "P_v": 1}, "initial": {"x": 1, "x_hat": 0, "P": 1},
    "noise": QUIET, "input": STEPS, "reference": {"kind": "constant", "value": 0},
    "methods": {"M": {"estimator": {"kind": "kalman"}}}, "metrics": ["estimation_mse"], "figures": [],
}  # fmt: skip
X_HAT, P = [0.8, 17 / 12, 2.71, 0.355198020], [1 / 5, 1 / 24, 1 / 100, 1 / 404]


def closed(controller, delay=1, model=MODEL, measurement=(), **keys):
    """Return the keys of a loop whose input is late."""
    laws = {"sum": [{"gaussian": {"std": 0.2}}, *measurement]}
    noise = {"process": {"gaussian": {"std": 0.1}}, "measurement": laws}
    return {
        "input": None, "controller": controller, "model": model, "time": {"steps": 30},
        "noise": {**noise, **({"input": {"delayed": delay}} if delay else {})},
        **({} if controller is LQR else {"reference": {"kind": "square", "values": [1, -1], "period": 16}}), **keys,
    }  # fmt: skip


@pytest.fixture
def load(tmp_path):
    """Return a function that loads a configuration with other keys."""
    (tmp_path / "m.py").write_text(FILE)

    def loaded(**keys):
        tree = {name: value for name, value in (CASE | keys).items() if value is not None}
        (tmp_path / "fed.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
        return load_config(tmp_path / "fed.yaml", allow_code=[tmp_path / "m.py"])

    return loaded


@pytest.fixture
def problems(load):
    """Return a function that gives the text of the errors of a configuration."""

    def found(**keys):
        with pytest.raises(ConfigError) as caught:
            load(**keys)
        return str(caught.value)

    return found


def record(experiment, n_runs=1, method=0, **options):
    """Trajectories of a method."""
    draws = experiment.scenario.draw(experiment.plant, range(n_runs), experiment.n_steps)
    each = experiment.methods[method]
    r = experiment.scenario.reference.sample(experiment.n_steps + 1 + each.preview)
    found, status = simulate(experiment.plant, each, draws, r, experiment.n_steps, with_P=True, info=["e"], **options)
    assert not status.any()
    return found


def design(kind, **keys):
    """Return a method with an estimator."""
    return {"M": {"estimator": {"kind": kind, **keys}}}


WAYS = {
    "kalman": ({"linearise": "plant", "at": {"x": [0.3], "u": [0.7]}}, "kalman"),
    "extended of a linear model": ({"linearise": "plant", "at": {"x": [0], "u": [0]}}, "extended-kalman"),
    "extended": ({"nonlinear": "plant"}, "extended-kalman"),
    "unscented": ({"nonlinear": "plant"}, "unscented-kalman"),
    "around a point": ({"nonlinear": "plant", "at": {"x": [0], "u": [0]}}, "gated-kalman"),
}


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("way", WAYS)
def test_the_case_of_the_page(load, plant, way):
    """Closed form: y = 5, 9, 2.5, .75 and the estimates of the page."""
    model, kind = WAYS[way]
    model = {**model, "noise": {"process": 0, "measurement": 1}}
    keys = {"gate": 1e6} if kind == "gated-kalman" else {}
    found = record(load(plant=plant, model=model, methods=design(kind, **keys)).experiment)
    np.testing.assert_allclose(found.y[0, :4, 0], [5, 9, 2.5, 0.75], **ROUND)
    np.testing.assert_allclose(found.x_hat[0, :4, 0], X_HAT, atol=5e-10)  # the digits of the page
    np.testing.assert_allclose(np.ravel(found.P)[:4], P, **SOLVER)


@pytest.mark.parametrize("kind", ["extended-kalman", "unscented-kalman", "nonlinear-moving-horizon"])
@pytest.mark.parametrize(
    "measurement", [[], [{"missing": {"probability": 0.4}}], [{"delayed": 2}, {"missing": {"every": 3}}]]
)
def test_filters_of_an_equation_are_those_of_matrices(load, kind, measurement):
    """Oracle: kalman of the linear plant gets y - D u; the window has h(x, u) of every sample."""
    noise = {**NOISY, "measurement": {"sum": [{"gaussian": {"std": 0.2}}, *measurement]}}
    keys = {"input": {"kind": "sine", "amplitude": 1, "period": 7}, "noise": noise, "time": {"steps": 25}}
    late = {"delay": {"measurement": "same"}}
    of_plant, own = {"linearise": "plant", "at": {"x": [0], "u": [0]}}, {"window": 4} if "horizon" in kind else {}
    expected = record(load(**keys, model={**of_plant, **DESIGN, **late}).experiment, 3)
    model = {"nonlinear": "plant", **DESIGN, **late}
    found = record(load(**keys, plant=ODE, model=model, methods=design(kind, **own)).experiment, 3)
    np.testing.assert_allclose(found.x_hat, expected.x_hat, rtol=1e-6, atol=1e-8)  # the end of the iteration
    np.testing.assert_allclose(found.y, expected.y, **ROUND)


def test_an_extended_filter_of_a_bent_output(load):
    """Oracle: the recursion in this test, with the derivative of h(x, u) by hand."""
    keys = {"plant": {**ODE, "output": "m.py:bent"}, "noise": NOISY, "time": {"steps": 12}}
    keys |= {"input": {"kind": "sine", "amplitude": 1, "period": 7}, "model": {"nonlinear": "plant", **DESIGN}}
    experiment = load(**keys, methods=design("extended-kalman")).experiment
    found, draws = record(experiment), experiment.scenario.draw(experiment.plant, range(1), 12)
    u = experiment.methods[0].controller.signal.sample([0], 13)[0, :, 0]
    x, p = 0.0, 1.0
    for k in range(13):
        y = 2 * found.x[0, k, 0] + 3 * u[k] + 0.2 * np.sin(found.x[0, k, 0]) * u[k] ** 2
        np.testing.assert_allclose(found.y[0, k, 0], y, rtol=1e-12, atol=1e-14)
        h, H = 2 * x + 3 * u[k] + 0.2 * np.sin(x) * u[k] ** 2, 2 + 0.2 * np.cos(x) * u[k] ** 2
        L = p * H / (H * p * H + 0.04)
        x, p = x + L * (y + draws.v[0, k, 0] - h), (1 - L * H) * p
        np.testing.assert_allclose(found.x_hat[0, k, 0], x, rtol=1e-7)  # differences in place of the derivative
        x, p = 0.5 * x + u[k], 0.25 * p + 0.01


LINEAR_KINDS = {
    "kalman-predictor": {}, "fading-kalman": {"alpha": 1.1}, "huber-kalman": {}, "student-kalman": {"dof": 4},
    "moving-horizon": {}, "robust-kalman": {"c": 0.1}, "kalman-disturbance": {}, "h-infinity": {"theta": 0.01},
}  # fmt: skip


@pytest.mark.parametrize("kind", LINEAR_KINDS)
@pytest.mark.parametrize("laws", [[], [{"delayed": [0, 2]}], [{"missing": {"every": 3}}]])
def test_linear_estimators_do_not_change(load, kind, laws):
    """Oracle: the same plant without D, whose noise is the same; y - D u is its y."""
    noise = {**NOISY, "measurement": {"sum": [{"gaussian": {"std": 0.2}}, *laws]}}
    keys = {"noise": noise, "methods": design(kind, **LINEAR_KINDS[kind]), "time": {"steps": 20}}
    model = MODEL | ({"delay": "same"} if laws else {})
    without = {name: value for name, value in LINEAR.items() if name != "D"}
    found, expected = (record(load(**keys, plant=plant, model=model).experiment, 3) for plant in (LINEAR, without))
    np.testing.assert_allclose(found.x_hat, expected.x_hat, rtol=1e-9, atol=1e-12)  # y - D u rounds


def test_what_a_method_does_not_know_of_a_delay_it_takes_from_the_newest(load):
    """Closed form: with `none` y(k-1) counts as y(k), from which D u(k) is taken; with 1 it is D u(k-1)."""
    noise, keys = {**QUIET, "measurement": {"delayed": 1}}, {"time": {"steps": 2}}
    for delay, second in (("none", 5 - 3 * 2), ({"measurement": 1}, 5 - 3 * 1)):
        found = record(load(**keys, noise=noise, model={**CASE["model"], "delay": delay}).experiment)
        e = second - 2 * (1 if delay == "none" else 0)
        np.testing.assert_allclose(found.info["e"][0, 1, 0], e, **ROUND)


def test_angles_of_an_output_that_depends_on_the_input(load):
    """Oracle: the same output without turns."""
    keys = {"input": {"kind": "sine", "amplitude": 2, "period": 7}, "noise": NOISY, "time": {"steps": 25}}
    keys |= {"model": {"nonlinear": "plant", **DESIGN}, "methods": design("extended-kalman")}
    plant = {**ODE, "output": "m.py:turned", "outputs": ["a"], "angles": ["a"]}
    found, straight = (record(load(plant=each, **keys).experiment) for each in (plant, ODE))
    assert np.abs(straight.y).max() > 7.0
    np.testing.assert_allclose(found.x_hat, straight.x_hat, rtol=1e-7)  # differences of a sine


def test_simulations_of_scipy(load):
    """Oracle: dlsim, and the exact sample of a continuous system."""
    u = STEPS["values"] + [0]
    _, y, x = signal.dlsim(signal.dlti([[0.5]], [[1.0]], [[2.0]], [[3.0]], dt=1.0), u, x0=[1.0])
    for plant in PLANTS:
        model = {"linearise": "plant", "at": {"x": [0], "u": [0]}, **DESIGN}
        found = record(load(plant=plant, model=model).experiment)
        np.testing.assert_allclose(found.y[0], y, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(found.x[0], x, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("kind", ["kalman", "extended-kalman"])
def test_a_loop_with_a_noisy_late_and_held_input(load, kind):
    """Oracle: the loop in this test, which knows neither the noise of the input nor its bounds beyond the limits."""
    keys = closed(LQR, methods=design(kind))
    keys["noise"]["input"] = {"sum": [{"gaussian": {"std": 0.3}}, {"delayed": 2}, {"missing": {"every": 3}}]}
    experiment = load(**keys).experiment
    found, draws = record(experiment), experiment.scenario.draw(experiment.plant, range(1), 30)
    (_, add), _, _ = draws.inputs
    p = solve_discrete_are([[0.5]], [[1.0]], [[1.0]], [[1.0]])
    K = (0.5 * p / (1 + p))[0, 0]
    x, x_hat, P, sent, u, u_m, on_way = 1.0, 0.0, 1.0, [], 0.0, 0.0, [0.0, 0.0]
    for k in range(31):
        if k % 3 == 0:
            u, u_m = (sent[k - 2] + add[0, k - 2, 0], sent[k - 2]) if k > 1 else (0.0, 0.0)
        y = 2 * x + 3 * u
        np.testing.assert_allclose(found.y[0, k, 0], y, rtol=1e-9, atol=1e-12)
        L = 2 * P / (4 * P + 0.04)
        x_hat, P = x_hat + L * (y + draws.v[0, k, 0] - 3 * u_m - 2 * x_hat), (1 - 2 * L) * P
        np.testing.assert_allclose(found.x_hat[0, k, 0], x_hat, rtol=1e-9, atol=1e-12)
        if k == 30:
            break
        z = x_hat
        for each in on_way:
            z = 0.5 * z + each
        sent.append(-K * z)
        on_way = [on_way[1], sent[-1]]
        x, x_hat, P = 0.5 * x + u + draws.w[0, k, 0], 0.5 * x_hat + u_m, 0.25 * P + 0.01


WIDE = LinearModel(
    [[0.9, 0.2], [0, 0.7]], [[0.1, 0.3], [1, 0]], [[1, 0], [1, 1]], 1, 1, D=[[0.5, 0], [0.2, -0.4]], d0=[0.1, 0.2]
)


def dense(x, u_before, r, Hp, Hu, R):
    """Return the stacked least squares of du: matrix and right side, written sample by sample."""
    nu, rows, right = 2, [], []
    for j in range(1, Hp + 1):
        free, moved, u = x.copy(), np.zeros((2, nu * Hu)), np.zeros((nu, nu * Hu))
        for i in range(j + 1):
            if i < Hu:
                u = u + np.eye(nu, nu * Hu, i * nu)
            if i < j:
                free, moved = WIDE.A @ free + WIDE.B @ u_before, WIDE.A @ moved + WIDE.B @ u
        rows.append(WIDE.C @ moved + WIDE.D @ u)
        right.append(r[j] - WIDE.C @ free - WIDE.D @ u_before - WIDE.d0)
    return np.vstack([*rows, np.sqrt(R) * np.eye(nu * Hu)]), np.concatenate([*right, np.zeros(nu * Hu)])


@pytest.mark.parametrize(("Hp", "Hu"), [(1, 1), (4, 1), (5, 3), (4, 4)])
def test_mpc_predicts_with_the_feedthrough(Hp, Hu):
    """Oracle: dense least squares over all moves, with bounds of the increments by another solver."""
    from scipy.optimize import lsq_linear

    rng = np.random.default_rng(4)
    limits = mpc.Limits(du=(-0.2, 0.2), enforce="qp")
    for enforce in (None, limits):
        law = mpc.design(WIDE, Hp=Hp, Hu=Hu, Q=1, R=0.3, limits=enforce)
        for _ in range(5):
            x, before, r = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(Hp + 1, 2))
            M, right = dense(x, before, r, Hp, Hu, 0.3)
            bounds = (-np.inf, np.inf) if enforce is None else (-0.2, 0.2)
            du = lsq_linear(M, right, bounds, tol=1e-14).x[:2]
            state = law.init(1)._replace(u_previous=before[None])
            from rmpc_bench.types import Estimate

            _, command = law.control(0, state, np.zeros((1, 2)), Estimate(x[None]), r)
            np.testing.assert_allclose(command.u[0], before + du, rtol=1e-6, atol=1e-7)  # two solvers


def test_lqg_has_the_feedthrough_in_its_steady_state_and_its_sums():
    """Oracle: the Riccati equation of [x; q] with q+ = q + C x + D u, and [A - I, B; C, D]."""
    Q, R, Q_i = np.diag([1.0, 2.0]), np.diag([0.5, 1.5]), 0.3 * np.eye(2)
    kalman = estimator("kalman", WIDE, 10, x0=0, P0=1)
    law = lqg.design(WIDE, 1.0, kalman, R_u=R.tolist(), Q_i=Q_i.tolist(), Q_x=Q.tolist(), feedforward="target")
    A = np.block([[WIDE.A, np.zeros((2, 2))], [WIDE.C, np.eye(2)]])
    B = np.vstack([WIDE.B, WIDE.D])
    p = solve_discrete_are(A, B, np.block([[Q, 0 * Q], [0 * Q, Q_i]]), R)
    K = np.linalg.solve(R + B.T @ p @ B, B.T @ p @ A)
    np.testing.assert_allclose(law.K_x, K[:, :2], rtol=1e-9)
    np.testing.assert_allclose(law.K_q, K[:, 2:], rtol=1e-9)
    steady = np.linalg.solve(np.block([[WIDE.A - np.eye(2), WIDE.B], [WIDE.C, WIDE.D]]), np.r_[0, 0, 1, 2 - 0.0])
    np.testing.assert_allclose(law.K_r @ [1, 2], steady[2:] + K[:, :2] @ steady[:2], rtol=1e-9)


@pytest.mark.parametrize("controller", [MPC, {"kind": "lqg", "Q_x": 1, "R_u": 1, "Q_i": 0.2}])
def test_laws_reach_the_reference(load, controller):
    """Limit: without noise y of the true plant is r, with an integral also where the model has another D."""
    model = MODEL if controller is MPC else {**MODEL, "D": [[2.5]]}
    keys = closed(controller, model=model, reference={"kind": "constant", "value": 2}, time={"steps": 80})
    keys["noise"] = {**QUIET, "input": {"delayed": 1}}
    found = record(load(**keys).experiment)
    np.testing.assert_allclose(found.y[0, -1, 0], 2.0, rtol=1e-6)  # the loop has settled


@pytest.mark.parametrize("plant", [LINEAR, PLANTS[2], ODE, ALONE])
@pytest.mark.parametrize("controller", [None, LQR])
def test_blocks_do_not_matter(load, plant, controller):
    """Oracle: every run alone, bit for bit."""
    model = {"linearise": "plant", "at": {"x": [0], "u": [0]}, **DESIGN}
    keys = {"noise": NOISY} if controller is None else closed(controller, [1, 2], {**model, "delay": {"input": 1}})
    experiment = load(**({"model": model} | keys), plant=plant, runs=5).experiment
    method, every = experiment.methods[0], range(5)
    whole = simulate_block(experiment, method, every).metrics
    parts = [simulate_block(experiment, method, range(i, i + 1)).metrics for i in every]
    np.testing.assert_array_equal(whole, np.concatenate(parts, axis=1))


def test_a_feedthrough_of_zero_has_no_effect(load):
    """Oracle: the plant without the key, bit for bit; only without one the compiled loop is used."""
    without = {name: value for name, value in LINEAR.items() if name != "D"}
    plants = [without, {**LINEAR, "D": [[0.0]]}, LINEAR]
    keys = closed({**MPC, "limits": {"u": [-1, 1]}})
    first, second, _ = [load(**keys, plant=plant).experiment for plant in plants]
    np.testing.assert_array_equal(record(first).x_hat, record(second).x_hat)
    np.testing.assert_array_equal(record(first).y, record(second).y)
    open_ = [load(plant=plant, noise=NOISY, runs=200_000).experiment for plant in plants]
    assert [applies(each, each.methods[0]) for each in open_][1:] == [applies(open_[0], open_[0].methods[0]), False]


UNCERTAIN = {"kind": "uncertain-linear", "A": [[0.5]], "B": [[1]], "C": [[2]], "D": [[3]], "W": [[0.01]], "V": [[0.04]]}


@pytest.mark.parametrize(
    ("plant", "model"),
    [
        (LINEAR, MODEL),
        (ODE, {"nonlinear": "plant", "at": {"u": [0]}, **DESIGN}),
        (LINEAR, UNCERTAIN | {"delay": "same"}),
    ],
)
def test_a_disturbance_of_the_input_enters_the_output(load, plant, model):
    """Limit: of an input that is larger by 0.5 than it is known to be the state is found, and y is r."""
    model = {**model, "disturbance": {"at": "input", "drift": 0.01}}
    keys = closed(MPC, plant=plant, model=model, reference={"kind": "constant", "value": 2}, time={"steps": 200})
    keys["noise"] = {**QUIET, "input": {"sum": [{"gaussian": {"mean": 0.5, "std": 0}}, {"delayed": 1}]}}
    experiment = load(**keys).experiment
    found = record(experiment)
    np.testing.assert_allclose(found.x_hat[0, -1], found.x[0, -1], rtol=1e-9)  # both have settled
    np.testing.assert_allclose(found.y[0, -1], 2.0, rtol=1e-9)


def test_functions_of_a_nonlinear_model_with_a_disturbance_of_the_input(load):
    """Closed form: y = 2 x + 3 (u + d) and its derivative, of one state or several."""
    model = {"nonlinear": "plant", "at": {"u": [0]}, **DESIGN}
    plant, one = load(plant=ODE, model=model, methods=design("extended-kalman")).experiment.plant, np.eye(1)
    within = NonlinearModel(dynamics_of(plant), 1.0, 0, one, one)
    made = with_disturbance(within, Disturbance("input", 0.01), 1, np.zeros(1))
    np.testing.assert_allclose(made.h([1.0, 0.5], [2.0]), [9.5], **ROUND)
    np.testing.assert_allclose(made.h([[1.0, 0.5], [0.0, 1.0]], [2.0]), [[9.5], [9.0]], **ROUND)
    np.testing.assert_allclose(made.H([1.0, 0.5], [2.0]), [[2.0, 3.0]], **SOLVER)


def test_recorded_data(load, tmp_path):
    """Oracle: the loop that has made them; u of the last sample is needed for its y."""
    keys = {"noise": NOISY, "model": MODEL, "time": {"steps": 4}}
    experiment = load(**keys).experiment
    found, draws = record(experiment), experiment.scenario.draw(experiment.plant, range(1), 4)
    y, u = found.y[0] + draws.v[0], np.array([*STEPS["values"], 0.0])[:, None]
    model = LinearModel([[0.5]], [[1]], [[2]], 0.01, 0.04, D=[[3]])
    kalman = estimator("kalman", model, x0=0, P0=1)
    np.testing.assert_allclose(filter_data(kalman, y, u).x_hat, found.x_hat[0], rtol=1e-10)
    shorter = filter_data(kalman, y, u[:-1])
    np.testing.assert_allclose(shorter.x_hat[:-1], found.x_hat[0, :-1], rtol=1e-10)
    assert np.isnan(shorter.e[-1]).all()
    np.savetxt(tmp_path / "run.csv", np.hstack([u, y]), delimiter=",", header="u,y", comments="", fmt="%.17g")
    data = {"plant": {"data": "run.csv", "columns": {"u": "u", "y": "y"}}, "metrics": ["innovation_mse"]}
    own = {name: value for name, value in LINEAR.items() if name != "kind"}
    replayed = load(
        **data,
        input=None,
        noise=None,
        initial={"x_hat": 0, "P": 1},
        model={"kind": "linear", **own, "P_w": 0.01, "P_v": 0.04},
    )
    np.testing.assert_allclose(record(replayed.experiment).x_hat[0, :-1], found.x_hat[0, :-1], rtol=1e-10)


def test_an_episode_is_the_loop(load):
    """Oracle: the loop, bit for bit; without a delay y(k) would need u(k)."""
    experiment = load(**closed(LQR)).experiment
    found, episode = record(experiment), Episode(experiment, 0, experiment.methods[0])
    for k in range(30):
        np.testing.assert_array_equal(episode.sample.y_true, found.y[0, k])
        np.testing.assert_array_equal(episode.sample.x_hat, found.x_hat[0, k])
        command = found.u[0, k + 1] if k < 29 else [0.0]
        episode.step(np.array(command))
    with pytest.raises(DesignError, match="chosen after"):
        Episode(load().experiment, 0)


def test_the_plant_in_other_programs_and_between_samples(load):
    """Closed form: y = C x + D u, and x(t) + 3 u within a sample."""
    for plant in PLANTS[:3]:
        model = {"linearise": "plant", "at": {"x": [0], "u": [0]}, **DESIGN}
        step = NominalStep.of(load(plant=plant, model=model).experiment.plant)
        np.testing.assert_allclose(step.output(0, np.array([2.0]), np.array([0.5]), {}), [5.5], **ROUND)
        np.testing.assert_array_equal(np.broadcast_to(step.linear.D, (1, 1)), [[3.0]])
    ode = {"ode": "m.py:drift", "output": "m.py:mixed", "states": 1, "inputs": 1, "outputs": 1}
    metrics = [{"kind": "largest", "of": "y.0", "between": 3, "to": 3}]
    keys = {"plant": ode, "model": {"nonlinear": "plant", **DESIGN}, "methods": design("extended-kalman")}
    experiment = load(**keys, metrics=metrics).experiment
    x1 = np.exp(-1) + (1 - np.exp(-1))  # from 1 with u = 1
    late = x1 * np.exp(-0.75) + 2 * (1 - np.exp(-0.75))  # the last point of the sample with u = 2
    value = simulate_block(experiment, experiment.methods[0], range(1)).metrics[0, 0]
    np.testing.assert_allclose(value, late + 6, rtol=1e-6)  # the tolerance of the integration


TEXT = "y(k) depends on u(k), which the controller computes from y(k): give it a sample, noise: {input: {delayed: 1}}"


def test_a_loop_needs_a_sample(problems, load):
    """The message of the page at the key that says so; the design model must know the delay."""
    assert f"fed.yaml:16:3: plant.D: {TEXT}" in problems(**closed(LQR, 0))
    assert f"plant.output: {TEXT}" in problems(
        **closed(LQR, [0, 2], {"nonlinear": "plant", "at": {"u": [0]}, **DESIGN, "delay": {"input": 1}}), plant=ODE
    )
    assert "its design model needs `delay: same`" in problems(**closed(LQR, 1, {**MODEL, "delay": "none"}))
    load(**closed(LQR, [1, 2], {**MODEL, "delay": {"input": 1}}))


REFUSED = [
    ({"kind": "gpc", "Np": 5, "Q_yw": 1, "Q_u": 1}, "gpc needs a model without feedthrough"),
    ({"kind": "tube-mpc", "horizon": 5, "Q_x": 1, "R_u": 1, "limits": {"u": [-1, 1]}, "W": 0.1}, "tube-mpc needs"),
    ({"kind": "minimax-lq", "horizon": 5, "Q_x": 1, "R_u": 1}, "minimax-lq needs a model without feedthrough"),
    ({"kind": "pid", "Kp": 1, "on": "estimate"}, "`on: estimate` needs a model without feedthrough"),
    ({**MPC, "law": "printed"}, "`law: printed`, needs a model without feedthrough"),
    ({"kind": "lqg", "Q_y": 1, "R_u": 1, "Q_i": 1}, "`Q_y` needs a model without feedthrough"),
    (
        {**MPC, "limits": {"enforce": "qp"}, "soft": {"y.0": {"limits": [-1, 1], "linear": 1}}},
        "a limit of an output needs",
    ),
]


@pytest.mark.parametrize(("controller", "message"), REFUSED)
def test_laws_that_count_without_it_refuse(problems, controller, message):
    assert message in problems(**closed(controller))


def test_other_refusals(problems, load):
    """Models that are linearised at every estimate, linear filters of g(x, u, p), and exact moments."""
    around = {"linearise": "plant", "at": "trajectory", **DESIGN}
    assert "trajectory needs an output that does not depend on u" in problems(plant=ODE, model=around)
    assert "needs a linear model" in problems(plant=ODE, model={"nonlinear": "plant", **DESIGN})
    assert "y(k) depends on u(k)" in problems(evaluate="moments", noise=NOISY)
    assert (
        record(
            load(
                plant={**ODE, "output": "m.py:old"}, model={"linearise": "plant", "at": {"u": [0]}, **DESIGN}
            ).experiment
        ).y[0, 0, 0]
        == 2
    )
