"""Each library alone on the draws of an experiment: two inputs and outputs, gaps, a failed run, two processes.

The experiment runs with one and with two processes (`two_by_two.simulated`).  Run 2 of the library's method fails.
"""

import shutil
from datetime import datetime, timedelta

import numpy as np
import pytest
from adapters.two_by_two import LINEARISED, RUNS, SIGNALS, STEPS, TS, A, simulated
from scipy.integrate import solve_ivp

from rmpc_bench.adapters.xarray import traces
from rmpc_bench.components.transport import recipe_of
from rmpc_bench.extras import is_installed

FINISHED = [run for run in range(RUNS) if run != 2]

FILTERPY = """
import numpy as np
from filterpy.kalman import KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from rmpc_bench.adapters.filterpy import filterpy_estimator

class Bridging:
    def update(self, z, *more, **keys):
        self.n = getattr(self, "n", 0) + 1
        if self.n == 5 and self.number == 2:
            raise ValueError("run 2 fails")
        super().update(None if np.isnan(z).any() else z, *more, **keys)

class Linear(Bridging, KalmanFilter):
    pass

class Unscented(Bridging, UnscentedKalmanFilter):
    pass

def matrices(made, model, x0, P0, run=-1):
    made.x, made.P, made.Q, made.R, made.number = x0, P0, model.Q_w, model.R_v, run
    return made

@filterpy_estimator(bridges_missing=True, deviation=True)
def kf(model, x0, P0, run):
    made = matrices(Linear(2, 2, 2), model, x0, P0, run)
    made.F, made.B, made.H = model.A, model.B, model.C
    return made

def sigma(kind, model, Ts):
    points = MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0)
    hx, fx = lambda x: model.C @ x + model.d0, lambda x, dt, u: model.A @ x + model.B @ u + model.f0
    return kind(2, 2, Ts, hx, fx, points)

@filterpy_estimator(bridges_missing=True)
def ukf(model, Ts, x0, P0, run):
    return matrices(sigma(Unscented, model, Ts), model, x0, P0, run)
"""


def design_model(found):
    """Return the linearised design model of an experiment, and its first estimate."""
    designs = [part for each in found.experiment.methods for part in (each.estimator, each.controller)]
    given = dict(item for recipe in map(recipe_of, designs) if recipe for item in recipe.provided.items())
    return given["model"], given.get("x0"), given.get("P0")


@pytest.mark.long
def test_filterpy(tmp_path):
    """In deviations with constant matrices, and with the constant parts in the functions of sigma points."""
    pytest.importorskip("filterpy")
    from filterpy.kalman import KalmanFilter, UnscentedKalmanFilter

    named = {"KF": "{estimator: {file: own.py:kf}}", "UKF": "{estimator: {file: own.py:ukf}}"}
    methods = "".join(f", {name}: {text}" for name, text in named.items())
    found = simulated(tmp_path, {"own.py": FILTERPY}, methods=methods)
    model, x0, P0 = design_model(found)
    own = {}
    exec(FILTERPY, own)  # the functions of the user, without the adapter
    point = model.operating_point
    for run in FINISHED:
        u = found.traces["KF"].signals["u"][run]
        kf = own["matrices"](KalmanFilter(2, 2, 2), model, x0 - point.x, P0)
        kf.F, kf.B, kf.H = model.A, model.B, model.C
        ukf = own["matrices"](own["sigma"](UnscentedKalmanFilter, model, TS), model, x0, P0)
        ukf.sigmas_f = ukf.points_fn.sigma_points(ukf.x, ukf.P)
        for k, y in enumerate(found.y["Kalman"][run]):
            if k:
                kf.predict(u[k - 1] - point.u)
                ukf.predict(u=u[k - 1])
            kf.update(None if np.isnan(y).any() else y - point.y)
            ukf.update(None if np.isnan(y).any() else y)
            for name, x_hat in (("KF", kf.x + point.x), ("UKF", ukf.x), ("Kalman", kf.x + point.x)):
                theirs = found.traces[name].signals["x_hat"][run, k]
                np.testing.assert_allclose(theirs, x_hat, rtol=0, atol=1e-10, err_msg=f"{name} {run} {k}")


STONESOUP = """
import numpy as np
from stonesoup.models.control.linear import LinearControlModel
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.updater.kalman import KalmanUpdater
from rmpc_bench.adapters.stonesoup import stonesoup_estimator

class Outputs(LinearGaussian):
    C = None
    def matrix(self, **ignored):
        return self.C

class Bridging(KalmanUpdater):
    number, n = -1, 0
    def update(self, hypothesis, **keys):
        self.n += 1
        if self.n == 5 and self.number == 2:
            raise ValueError("run 2 fails")
        if np.isnan(np.asarray(hypothesis.measurement.state_vector, dtype=float)).any():
            return hypothesis.prediction
        return super().update(hypothesis, **keys)

def parts(model):
    transition = LinearGaussianTimeInvariantTransitionModel(transition_matrix=model.A, covariance_matrix=model.Q_w)
    outputs = Outputs(ndim_state=2, mapping=[0, 1], noise_covar=model.R_v)
    outputs.C = model.C
    return KalmanPredictor(transition, LinearControlModel(model.B)), outputs

@stonesoup_estimator(bridges_missing=True, deviation=True)
def kf(model, run):
    predictor, outputs = parts(model)
    updater = Bridging(outputs)
    updater.number = run
    return predictor, updater
"""


@pytest.mark.long
def test_stone_soup(tmp_path):
    """A filter in deviations, with times of its own."""
    pytest.importorskip("stonesoup")
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState, State
    from stonesoup.updater.kalman import KalmanUpdater

    found = simulated(tmp_path, {"own.py": STONESOUP}, methods=", KF: {estimator: {file: own.py:kf}}")
    model, x0, P0 = design_model(found)
    own, point = {}, model.operating_point
    exec(STONESOUP, own)
    predictor, outputs = own["parts"](model)
    updater = KalmanUpdater(outputs)
    for run in FINISHED:
        now = datetime(2020, 5, 17)
        state = GaussianState(x0 - point.x, P0, timestamp=now)
        for k, y in enumerate(found.y["Kalman"][run]):
            if k:
                now += timedelta(seconds=TS)
                u = State(found.traces["KF"].signals["u"][run, k - 1] - point.u, timestamp=now)
                state = predictor.predict(state, timestamp=now, control_input=u)
            if not np.isnan(y).any():
                state = updater.update(SingleHypothesis(state, Detection(y - point.y, timestamp=now)))
            theirs = found.traces["KF"].signals["x_hat"][run, k]
            np.testing.assert_allclose(theirs, np.ravel(state.mean) + point.x, rtol=0, atol=1e-11)


DO_MPC = """
import numpy as np
from rmpc_bench.adapters.do_mpc import do_mpc_controller, do_mpc_estimator, do_mpc_model

def law_of(model):
    import casadi, do_mpc
    made = do_mpc_model(model)
    law = do_mpc.controller.MPC(made)
    law.settings.n_horizon = 4
    error = casadi.sumsqr(made.aux["y"] - made.tvp["r"])
    law.set_objective(lterm=error, mterm=error)
    law.set_rterm(u=0.1)
    law.bounds["lower", "_u", "u"], law.bounds["upper", "_u", "u"] = 0.2, 1.1
    return law

@do_mpc_controller
def mpc(model, run):
    law = law_of(model)
    if run == 2:
        law.settings.nlpsol_opts = {"ipopt.max_iter": 0}
    return law

@do_mpc_estimator
def mhe(model, P0, run, Ne: int = 6):
    import do_mpc
    made = do_mpc.estimator.MHE(do_mpc_model(model))
    made.settings.n_horizon = Ne
    if run == 2:
        made.settings.nlpsol_opts = {"ipopt.max_iter": 0}
    P_x, P_w, P_v = (np.linalg.inv(each) for each in (P0, model.Q_w, model.R_v))
    made.set_default_objective(P_x, P_v, P_w=P_w)
    return made
"""


@pytest.mark.long
def test_do_mpc(tmp_path):
    """The MPC alone on the estimates of the run; the MHE of a window as long as the run is the Kalman filter.

    do-mpc alone fills a window with copies of the first measurement, so that its MHE has no oracle of its own here.
    """
    pytest.importorskip("do_mpc")
    from rmpc_bench.adapters.do_mpc import quiet, set_up

    methods = ", MPC: {estimator: {kind: kalman}, controller: {file: own.py:mpc}}, MHE: {estimator: {file: own.py:mhe}}"
    driven = "reference: {kind: constant, value: [1.05, 2.1]}\ncontroller: {kind: mpc, Hp: 4, Hu: 2, Q: 1, R: 0.1}"
    found = simulated(tmp_path, {"own.py": DO_MPC}, methods=methods, driven=driven, runs=3, steps=6)
    model, x0, P0 = design_model(found)
    own, point = {}, model.operating_point
    exec(DO_MPC, own)

    def inputs(x_hat):
        law = own["law_of"](model)
        template = law.get_tvp_template()
        template["_tvp", :, "r"] = np.array([1.05, 2.1])
        law.set_tvp_fun(lambda t: template)
        set_up(law, TS)
        law.x0, law.u0 = x_hat[0], point.u
        law.set_initial_guess()
        return np.array([np.ravel(law.make_step(x[:, None])) for x in x_hat[:-1]])

    limited = 0
    for run in (0, 1):
        trace = found.traces["MPC"].signals
        expected = quiet(inputs)(trace["x_hat"][run])
        np.testing.assert_allclose(trace["u"][run], expected, rtol=0, atol=1e-6)
        limited += (np.abs(expected - 1.1) < 1e-6).sum()
        trace = found.traces["MHE"].signals
        y = found.y["MHE"][run]
        x, P = x0, P0
        for k in range(7):
            if k:
                x, P = model.A @ x + model.B @ trace["u"][run, k - 1] + model.f0, model.A @ P @ model.A.T + model.Q_w
                if not np.isnan(y[k]).any():
                    L = P @ model.C.T @ np.linalg.inv(model.C @ P @ model.C.T + model.R_v)
                    x, P = x + L @ (y[k] - model.C @ x - model.d0), P - L @ model.C @ P
            np.testing.assert_allclose(trace["x_hat"][run, k], x, rtol=0, atol=1e-7, err_msg=f"{run} {k}")
    assert limited > 0


EXPLICIT = '''
from types import SimpleNamespace
import numpy as np
from rmpc_bench.adapters.explicit_mpc import explicit_controller

K = np.array([[0.9, 0.1], [0.2, 0.7]])
CUT = 0.05

@explicit_controller(deviation=True)
def law(model):
    """u = -K x where x_1 is not above CUT, else -K x - 1; the regions end at 0.2."""
    half = [SimpleNamespace(A=-K, b=np.zeros(2), E=np.array([[1.0, 0.0]]), f=np.array([CUT]))]
    return half + [SimpleNamespace(A=-K, b=-np.ones(2), E=np.array([[-1.0, 0.0], [1.0, 0.0]]), f=np.array([-CUT, 0.2]))]
'''


@pytest.mark.long
def test_explicit_mpc(tmp_path):
    """Oracle: the affine law of two regions, in deviations; a run whose estimate leaves both is infeasible."""
    driven = "reference: {kind: constant, value: [1.0, 2.0]}\ncontroller: {kind: mpc, Hp: 4, Hu: 2, Q: 1, R: 0.1}"
    methods = ", law: {estimator: {kind: kalman}, controller: {file: own.py:law}}"
    found = simulated(tmp_path, {"own.py": EXPLICIT}, methods=methods, driven=driven, all_fail_alike=False, runs=8,
                      initial="x: {gaussian: {mean: [1.0, 1.0], cov: 0.04}}, ")  # fmt: skip
    model, _, _ = design_model(found)
    own, point = {}, model.operating_point
    exec(EXPLICIT, own)
    words, regions = found.status["law"], set()
    assert {"ok", "infeasible"} == {*words}
    for run, word in enumerate(words):
        trace = found.traces["law"].signals
        for k in range(STEPS):
            z = trace["x_hat"][run, k] - point.x
            if z[0] > 0.2 + 1e-6:
                assert word == "infeasible" and np.isnan(trace["u"][run, k + 1 :]).all()
                break
            regions.add(above := bool(z[0] > own["CUT"]))
            np.testing.assert_allclose(trace["u"][run, k] - point.u, -own["K"] @ z - above, rtol=0, atol=1e-9)
    assert regions == {True, False}
    if is_installed("xarray"):
        data = traces(found.results)
        assert data["status"].sel({"method": "law"}).values.tolist() == words
        for name in ("x", "y", "u", "x_hat"):
            values = data[name].sel({"method": "law"}).values[:, : STEPS + (name != "u")]
            np.testing.assert_array_equal(values, found.traces["law"].signals[name])


CONTROL = """
import control, numpy as np

def update(t, x, u, params):
    a = np.where(params["a"] > 1.5, np.nan, params["a"])
    return np.array([u[0] - a * x[0] * abs(x[0]) + 0.3 * x[1], u[1] - 0.8 * x[1] + 0.2 * x[0]])

def output(t, x, u, params):
    return np.array([x[0], x[0] + x[1]])

names = {"states": ["a1", "a2"], "inputs": ["u1", "u2"], "outputs": ["y1", "y2"]}
tanks = control.nlsys(update, output, **names, params={"a": 1.2})
"""
CASADI = """
import casadi

x, u, a = casadi.SX.sym("x", 2), casadi.SX.sym("u", 2), casadi.SX.sym("a")
q = casadi.if_else(a > 1.5, float("nan"), a) * x[0] * casadi.fabs(x[0])
change = casadi.vertcat(u[0] - q + 0.3 * x[1], u[1] - 0.8 * x[1] + 0.2 * x[0])
tanks = casadi.Function("tanks", [a, u, x], [change], ["p", "u", "x"], ["dx"])
sums = casadi.Function("sums", [x], [casadi.vertcat(x[0], x[0] + x[1])], ["x"], ["y"])
"""
SCIPY = """
from scipy import signal

def tanks(a=1.2):
    if a > 1.5:
        raise ValueError("a is too large")
    return signal.StateSpace([[-a, 0.3], [0.2, -0.8]], [[1, 0], [0, 1]], [[1, 0], [1, 1]], [[0, 0], [0, 0]])
"""
GYMNASIUM = """
import gymnasium, numpy as np
from gymnasium.spaces import Box

class Tanks(gymnasium.Env):
    observation_space, action_space = Box(-9, 9, (2,), np.float64), Box(-9, 9, (2,), np.float64)

    def __init__(self, a=1.2):
        self.a = a

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = np.zeros(2)
        return self.x.copy(), {}

    def step(self, u):
        if self.a > 1.5:
            raise ValueError("a is too large")
        x = self.x
        self.x = x + 0.1 * np.array([u[0] - self.a * x[0] * abs(x[0]) + 0.3 * x[1], u[1] - 0.8 * x[1] + 0.2 * x[0]])
        return self.x.copy(), 0.0, False, False, {}

def sums(x, p):
    return [x[0], x[0] + x[1]]
"""
MATRICES = "{kind: linear, A: [[0.8, 0], [0, 0.9]], B: [[0.1, 0], [0, 0.1]], C: [[1, 0], [1, 1]], P_w: 1e-4, P_v: 1e-3}"


def plants(library, own):
    """Return the configuration of a plant, of its design model, and x(k+1) of (x, u, a) by the library alone."""
    if library == "control":

        def moved(x, u, a):
            slope = lambda t, x: own["tanks"].dynamics(t, x, u, params={"a": a})  # noqa: E731
            return solve_ivp(slope, (0.0, TS), x, rtol=1e-10, atol=1e-12).y[:, -1]

        return "{control: own.py:tanks, perturb: {a: 1 + eps}}", LINEARISED, moved
    if library == "casadi":
        import casadi

        x, u, a = casadi.SX.sym("x", 2), casadi.SX.sym("u", 2), casadi.SX.sym("a")
        ode = {"x": x, "u": u, "p": a, "ode": own["tanks"](a, u, x)}
        over = casadi.integrator("over", "cvodes", ode, 0.0, TS, {"reltol": 1e-10, "abstol": 1e-12})
        moved = lambda x, u, a: over(x0=x, u=u, p=a)["xf"].full().ravel()  # noqa: E731
        return f"{{casadi: own.py:tanks, output: own.py:sums, {SIGNALS}}}", LINEARISED, moved
    if library == "scipy":

        def moved(x, u, a):
            sampled = own["tanks"](a).to_discrete(TS)
            return sampled.A @ x + sampled.B @ u

        linearised = LINEARISED.replace(", guess: 1.0", "")
        return "{scipy: own.py:tanks, perturb: {a: 1 + eps}}", linearised, moved

    def moved(x, u, a):
        env = own["Tanks"](a)
        env.reset(seed=3)
        env.x = x
        return env.step(u)[0]

    text = SIGNALS.replace("outputs:", "output: own.py:sums, outputs:")
    return f"{{env: own.py:Tanks, state: x, start: initial, {text}}}", MATRICES, moved


@pytest.mark.parametrize(
    ("library", "source", "atol"),
    [("control", CONTROL, 1e-7), ("casadi", CASADI, 1e-7), ("scipy", SCIPY, 1e-12), ("gymnasium", GYMNASIUM, 1e-14)],
)
@pytest.mark.long
def test_plants(library, source, atol, tmp_path):
    """x(k+1) of the library from the state of the sample before, with the noise and the parameter of the run.

    The library refuses a > 1.5, which one run has.
    """
    if library != "scipy":
        pytest.importorskip(library)
    own = {}
    exec(source, own)
    plant, model, moved = plants(library, own)
    found = simulated(tmp_path, {"own.py": source}, plant=plant, model=model, all_fail_alike=False)
    a, trace = A * (1.0 + found.eps), found.traces["Kalman"].signals
    assert [each != "ok" for each in found.status["Kalman"]] == (a > 1.5).tolist()
    assert (a > 1.5).sum() == 1
    for run in np.flatnonzero(a <= 1.5):
        x = found.draws.x0[run]
        for k in range(STEPS + 1):
            np.testing.assert_allclose(trace["x"][run, k], x, rtol=0, atol=atol * (k + 1))
            np.testing.assert_allclose(trace["y"][run, k], [x[0], x[0] + x[1]], rtol=0, atol=2 * atol * (k + 1))
            if k < STEPS:
                x = moved(x, trace["u"][run, k], a[run]) + found.draws.w[run, k]
    assert np.isnan(trace["x"][a > 1.5, 1:]).all()


FMU = (
    "{{fmu: tanks{}.fmu, states: [h1, h2], inputs: [pump, second], outputs: [level, h1],"
    " parameters: {{k: 1.0}}, perturb: {{k: 1 - 12 * eps}}}}"
)


@pytest.mark.parametrize("version", [2, 3])
def test_fmu(version, tmp_path):
    """The unit alone, run by run; a tank that a negative gain empties is an error of the unit."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc compiles the units")
    fmpy = pytest.importorskip("fmpy")
    from adapters.fmu_units import build

    file = build(tmp_path, version)
    noise = {"process": "none", "initial": "x: [0.05, 0.1], ", "Ts": 5.0}
    driven = "input: {kind: prbs, low: [6, 1], high: [10, 3], hold: 10}"
    given = {"plant": FMU.format(version), "model": MATRICES, "driven": driven, "all_fail_alike": False, **noise}
    found = simulated(tmp_path, **given)
    trace, about = found.traces["Kalman"].signals, fmpy.read_model_description(file)
    kind = {2: fmpy.fmi2.FMU2Slave, 3: fmpy.fmi3.FMU3Slave}[version]
    directory = fmpy.extract(file, tmp_path / "unpacked")
    failed = []
    for run in range(RUNS):
        unit = kind(guid=about.guid, unzipDirectory=str(directory), modelIdentifier="tanks", instanceName=f"alone{run}")
        unit.instantiate()
        put, get = (getattr(unit, f"{verb}{'Real' if version == 2 else 'Float64'}") for verb in ("set", "get"))
        put([0, 1, 5], [0.05, 0.1, 1.0 - 12.0 * found.eps[run]])
        unit.enterInitializationMode()
        unit.exitInitializationMode()
        try:
            for k in range(STEPS + 1):
                np.testing.assert_array_equal(trace["x"][run, k], get([0, 1]))
                np.testing.assert_array_equal(trace["y"][run, k], get([6, 0]))
                if k < STEPS:
                    put([2, 7], trace["u"][run, k].tolist())
                    unit.doStep(k * 5.0, 5.0)
        except fmpy.fmi1.FMICallException:
            failed.append(run)
            assert np.isnan(trace["x"][run, k + 1 :]).all()
    assert [run for run, word in enumerate(found.status["Kalman"]) if word != "ok"] == failed
    assert 0 < len(failed) < RUNS
