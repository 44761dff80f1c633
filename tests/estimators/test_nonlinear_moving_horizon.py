"""nonlinear-moving-horizon: linear limits, values of IPOPT, three reactors, bits of a run, failures."""

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import SOLVER, random_model, random_psd
from estimators import window_systems

import rmpc_bench
from rmpc_bench import load_config
from rmpc_bench.estimators import kalman, moving_horizon
from rmpc_bench.estimators import nonlinear_moving_horizon as horizon
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import design as nonlinear
from rmpc_bench.models.nonlinear import nonlinear_model
from rmpc_bench.plants.ode import design as ode
from rmpc_bench.types import DesignError, Status

TEXT = """
version: 1
name: window
runs: 20
time: {{step: {step}, duration: {duration}}}
plant: {{ode: window_systems.py:{system}, output: window_systems.py:{output}, states: [{states}], inputs: [{inputs}],
        outputs: [m], bounds: {bounds}, solver: {solver}}}
model: {{nonlinear: plant, noise: {{process: {Q}, measurement: {R}}}}}
noise: same
initial: {{x: {x}, x_hat: {x_hat}, P: {P}}}
{more}
methods: {methods}
metrics: [{{kind: estimation_mse, from: {late}}}, fallbacks]
"""
FILTERS = "{E: {estimator: {kind: extended-kalman}}, M: {estimator: {kind: nonlinear-moving-horizon}}}"
SYSTEMS = {
    "three": {
        "step": 0.25, "duration": 20, "system": "three", "output": "pressure", "states": "A, B, C", "inputs": "",
        "bounds": "{A: [0, 100], B: [0, 100], C: [0, 100]}", "Q": "1.0e-6", "R": 0.0625, "x": "[0.5, 0.05, 0]",
        "x_hat": "[1, 0, 4]", "P": 0.25,
    },
    "two": {
        "step": 0.1, "duration": 8, "system": "two", "output": "total", "states": "A, B", "inputs": "",
        "bounds": "{A: [0, 100], B: [0, 100]}", "Q": "1.0e-6", "R": 0.01, "x": "[3, 1]", "x_hat": "[0.1, 4.5]", "P": 36,
    },
    "cstr": {
        "step": 0.05, "duration": 5, "system": "cstr", "output": "temperature", "states": "CA, T", "inputs": "Tc",
        "bounds": "{CA: [0, 10], T: [250, 1000]}", "Q": "[1.0e-6, 0.01]", "R": 0.25, "x": "[0.5, 350]",
        "x_hat": "[0.6, 348]", "P": "[0.01, 4]",
        "more": "input: {kind: sine, mean: 300, amplitude: 2, period: 3.14159265358979}",
    },
}  # fmt: skip


def loaded(folder, system, **keys):
    """The experiment of a system."""
    shutil.copy(Path(window_systems.__file__), folder)
    late = 20 * SYSTEMS[system]["step"]
    usual = {"late": late, "solver": "{substeps: 4}", "methods": FILTERS, "more": ""}
    text = TEXT.format(**usual | SYSTEMS[system] | keys)
    (folder / "window.yaml").write_text(text, encoding="utf-8")
    return load_config(folder / "window.yaml").experiment


def run(estimator, y, u):
    """Estimates (runs, samples, nx), iterations, fallbacks and statuses (runs, samples)."""
    state, found = estimator.init(len(y)), []
    for k in range(y.shape[1]):
        state, estimate = estimator.correct(k, state, y[:, k])
        info, P = estimate.info, np.broadcast_to(estimate.P, (len(y), *estimate.P.shape[-2:]))
        found.append((estimate.x_hat, info.get("iterations"), info.get("fallback"), estimate.status, P))
        state = estimator.predict(k, state, u[:, k])
    return [np.stack(each, axis=1) if each[0] is not None else None for each in zip(*found, strict=True)]


def nonlinear_of(estimator):
    """The model of an estimator, as functions of one run."""
    flow = estimator.flow
    return nonlinear_model(flow.dynamics, flow.Ts, DesignNoise(flow.Q_w.tolist(), flow.R_v.tolist()))


def simulated(model, system, runs=20, seed=1):
    """States, measurements and inputs of a system with the noises of its model, kept inside its bounds."""
    rng, x0, steps = np.random.default_rng(seed), eval(SYSTEMS[system]["x"]), 100 if system == "cstr" else 80
    x, X, Y, U = np.tile(np.array(x0, dtype=float), (runs, 1)), [], [], []
    for k in range(steps):
        u = np.full((runs, model.nu), 300.0 + 2.0 * np.sin(k / 10))
        X.append(x)
        Y.append(model.h(x) + np.sqrt(model.R_v[0, 0]) * rng.standard_normal((runs, 1)))
        U.append(u)
        w = rng.standard_normal(x.shape) * np.sqrt(np.diag(model.Q_w))
        x = np.maximum(model.f(x, u) + w, model.limits[0])
    return [np.stack(each, axis=1) for each in (X, Y, U)]


@pytest.mark.parametrize("use_y0", [True, False])
@pytest.mark.parametrize("window", [1, 5, 20])
def test_of_a_linear_model_without_bounds_it_is_the_kalman_filter(rng, window, use_y0):
    """Oracle: kalman, also with offsets, correlated outputs and missing measurements."""
    made = random_model(rng, 3, 2, 2)
    model = LinearModel(made.A, made.B, made.C, made.Q_w, made.R_v, f0=[0.1, -0.2, 0.3], d0=[0.5, -1.0])
    start = {"x0": rng.standard_normal(3), "P0": random_psd(rng, 3), "use_y0": use_y0}
    y, u = rng.standard_normal((4, 30, 2)), rng.standard_normal((4, 30, 2))
    y[1, 5:8, 0], y[2, 7], y[2, 9:12, 1] = np.nan, np.nan, np.nan
    ours, _, fallbacks, _, P = run(horizon.design(model, 30, **start, window=window), y, u)
    theirs, *_, P_theirs = run(kalman.design(model, 30, **start), y, u)
    np.testing.assert_allclose(ours, theirs, **SOLVER)
    np.testing.assert_allclose(P, P_theirs, **SOLVER)
    assert not fallbacks.any()


@pytest.mark.parametrize("bounds", [(-0.3, 0.5), [(0.0, None), (None, 0.4), (-0.1, 0.1)]])
def test_of_a_linear_model_with_bounds_it_is_the_linear_one(rng, bounds):
    """Oracle: moving-horizon, which solves in other unknowns; bounds are active, one of them at 0."""
    model = random_model(rng, 3, 2, 2)
    start = {"x0": rng.standard_normal(3), "P0": random_psd(rng, 3), "window": 5, "x": bounds}
    y, u = rng.standard_normal((4, 30, 2)), rng.standard_normal((4, 30, 2))
    y[1, 5:8, 0], y[2, 7] = np.nan, np.nan
    ours, theirs = (run(made.design(model, 30, **start), y, u)[0] for made in (horizon, moving_horizon))
    # A state at a bound of 0 has no size.
    np.testing.assert_allclose(ours, theirs, **SOLVER, atol=1e-9)


def test_a_model_that_depends_on_k(rng):
    """Oracle: kalman; every sample of the window has its own matrices."""
    rows = [random_model(rng, 2, 1, 1) for _ in range(8)]

    class Varying(LinearModel):
        varies = True

        def at(self, k):
            return rows[min(k, 7)]

    first = rows[0]
    model = Varying(first.A, first.B, first.C, first.Q_w, first.R_v)
    start, (y, u) = {"x0": np.zeros(2), "P0": np.eye(2)}, rng.standard_normal((2, 3, 8, 1))
    ours, theirs = (
        run(made.design(model, 7, **start, **keys), y, u)[0] for made, keys in ((horizon, {"window": 3}), (kalman, {}))
    )
    np.testing.assert_allclose(ours, theirs, **SOLVER)


@pytest.mark.parametrize(("solver", "tolerance"), [("{substeps: 4}", 2e-9), ("{}", 2e-7)])
def test_the_values_of_ipopt(tmp_path, solver, tolerance):
    """Oracle: IPOPT and scipy, which agree to 9 digits; error control of f changes the seventh one."""
    expected = {
        0: [0.0, 0.0, 0.550799562],
        1: [0.330295929, 0.044966255, 0.226772895],
        2: [0.355159697, 0.101486926, 0.199226143],
        10: [0.143287438, 0.305547377, 0.425658079],
    }
    kind = "estimator: {kind: nonlinear-moving-horizon"
    methods = f"{{M: {{{kind}}}}}, F: {{{kind}, x: [null, null]}}}}}}"
    bounded, free = loaded(tmp_path, "three", solver=solver, methods=methods).methods
    model, x = bounded.estimator.flow, np.array([[0.5, 0.05, 0.0]])
    y, u = np.empty((1, 11, 1)), np.zeros((1, 11, 0))
    for k in range(11):
        y[:, k], x = model.measure(k, x), model.advance(k, x, u[:, k])
    found, _, fallbacks, *_ = run(bounded.estimator, y, u)
    for k, each in expected.items():
        np.testing.assert_allclose(found[0, k], each, rtol=0, atol=tolerance)
    assert not fallbacks.any()
    last = run(free.estimator, y, u)[0][0, 10]
    np.testing.assert_allclose(last, [0.133364426, -0.649705062, 1.388676752], rtol=0, atol=tolerance)


@pytest.mark.parametrize(
    ("system", "most", "mean", "substeps"),
    [("three", 11, 4.1, 4), ("two", 18, 3.9, 4), ("cstr", 7, 3.9, 4), ("two", 18, 3.9, 0), ("cstr", 7, 4.0, 0)],
)
def test_iterations(tmp_path, system, most, mean, substeps):
    """As the prototype on the same data: 11, 18 and 7 at most, none without convergence, also with error control."""
    solver = f"{{substeps: {substeps}}}" if substeps else "{}"
    experiment = loaded(tmp_path, system, solver=solver)
    # An ignition with error control takes long.
    x, y, u = simulated(nonlinear_of(experiment.methods[1].estimator), system, runs=20 if substeps else 4)
    found, iterations, fallbacks, *_ = run(experiment.methods[1].estimator, y, u)
    assert iterations.max() <= most and iterations.mean() < mean and not fallbacks.any()
    if substeps:
        expected = {"three": 5.4e-5, "two": 3.6e-4, "cstr": 0.0256}[system]
        assert ((found - x)[:, 20:] ** 2).mean() == pytest.approx(expected, rel=0.02)  # two digits are given


@pytest.mark.long
def test_the_reactor_from_its_configuration(tmp_path):
    """The wrong start leads extended-kalman to negative states; bounds of the window prevent that."""
    loaded(tmp_path, "three")
    trials = rmpc_bench.run(load_config(tmp_path / "window.yaml"), directory=tmp_path / "out", jobs=1).trials.frame
    mean = trials.groupby("method")[["estimation_mse", "fallbacks"]].mean()
    assert mean.estimation_mse["M"] < 1e-4 and mean.estimation_mse["E"] > 0.1
    assert mean.fallbacks["M"] == 0.0 and set(trials.status) == {"ok"}


@pytest.mark.long
def test_a_run_does_not_depend_on_its_block(tmp_path):
    """Bit for bit, with error control, where another run has gaps and one has measurements that are no numbers."""
    estimator = pickle.loads(pickle.dumps(loaded(tmp_path, "cstr", solver="{}").methods[1].estimator))
    _, y, u = simulated(nonlinear_of(estimator), "cstr", runs=6)
    y, u = y[:, :16].copy(), u[:, :16]
    y[1, 3:6], y[2, 8] = np.nan, np.inf
    together = run(estimator, y, u)
    for i in (0, 1, 2, 5):
        for one, block in zip(run(estimator, y[i : i + 1], u[i : i + 1]), together, strict=True):
            np.testing.assert_array_equal(one[0], block[i])
    status = together[3]
    assert (np.delete(status, 2, axis=0) == Status.OK).all() and np.isfinite(np.delete(together[0], 2, axis=0)).all()
    # The window holds the infinite measurement; the last iterate is a number.
    assert (status[2, 8:] == Status.NOT_CONVERGED).all() and np.isfinite(together[0][2]).all()


def test_a_state_where_the_model_is_not_defined(tmp_path):
    """A level below 0 has no root: without bounds the run fails with a status, and its estimates are numbers."""

    def drain(x, u, p):
        return [x[0] - 0.1 * np.sqrt(x[0])]

    plant = ode(0.1, 10, ode=drain, states=["h"], x0=[1.0], discrete=True)
    model = nonlinear(0.1, plant, noise=DesignNoise(1e-2, 1e-4))
    start = {"x0": np.array([1.0]), "P0": np.array([[0.04]])}
    y = np.array([[[1.0], [0.9], [0.8]], [[-0.5], [-0.5], [-0.5]]])
    found, _, _, status, _ = run(horizon.design(model, 10, **start), y, np.zeros((2, 3, 0)))
    assert (status[0] == Status.OK).all() and status[1, 1] == Status.NOT_CONVERGED and np.isfinite(found).all()
    bounded = horizon.design(model, 10, **start, x=(0.0, None))
    found, _, fallbacks, status, _ = run(bounded, y, np.zeros((2, 3, 0)))
    assert (status == Status.OK).all() and (found >= 0.0).all() and not fallbacks.any()


def test_a_window_that_does_not_converge_is_a_fallback(tmp_path):
    """One iteration is not enough; the last iterate is the estimate."""
    methods = "{M: {estimator: {kind: nonlinear-moving-horizon, iterations: 1}}}"
    estimator = loaded(tmp_path, "three", methods=methods).methods[0].estimator
    _, y, u = simulated(nonlinear_of(estimator), "three", runs=2)
    found, iterations, fallbacks, status, _ = run(estimator, y[:, :5], u[:, :5])
    assert fallbacks.all() and (iterations == 1).all() and (status == Status.OK).all() and np.isfinite(found).all()


def test_design_errors(rng):
    model = random_model(rng, 2, 1, 1)
    start = {"x0": np.zeros(2), "P0": np.eye(2)}
    silent = LinearModel(model.A, model.B, model.C, np.diag([1.0, 0.0]), model.R_v)
    with pytest.raises(DesignError, match="Q_w is singular: give every state process noise"):
        horizon.design(silent, 5, **start)
    with pytest.raises(DesignError, match="give every initial state a variance"):
        horizon.design(model, 5, x0=np.zeros(2), P0=np.diag([1.0, 0.0]))
    with pytest.raises(DesignError, match="has 1 pairs, and 2 are required"):
        horizon.design(model, 5, **start, x=[(0.0, 1.0)])
