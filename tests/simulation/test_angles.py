"""Outputs and states that count modulo a period: filters, laws, metrics and figures, from the YAML."""

import numpy as np
import pytest
import yaml
from conftest import ROUND, SOLVER

import rmpc_bench
from rmpc_bench import load_config, run_one
from rmpc_bench.analysis.estimation_errors import recorded_errors
from rmpc_bench.figures.recorded_runs import signal_of
from rmpc_bench.metrics.estimation import EstimationMse
from rmpc_bench.metrics.tracking import SettlingTime, SteadyStateError, Tracking
from rmpc_bench.simulation.angles import _chosen, _joined
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.linear_loop import applies
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.types import Command, ConfigError, Estimate, Journal, MetricLayout, Record
from rmpc_bench.types.angles import near, turns, wrapped

TURN = 2.0 * np.pi
PLANT = """
import numpy as np


def rhs(x, u, p):
    return [x[0] + 0.1 * x[1] + 0.005 * u[0], x[1] + 0.1 * u[0]]


def free(x, u, p):
    return [x[0] + 0.1 * x[1], x[1]]


def cut(x, p):
    return [np.arctan2(np.sin(x[0]), np.cos(x[0]))]


def straight(x, p):
    return [x[0]]
"""
TEXT = """
version: 1
name: turning
runs: 20
time: {step: 0.1, steps: 100}
plant:
  ode: turning.py:free
  output: turning.py:OUTPUT
  discrete: true
  states: {theta: rad, omega: rad/s}
  outputs: {angle: rad}
  ANGLES
model: {nonlinear: plant, noise: {process: [1.0e-6, 1.0e-4], measurement: 2.5e-3}}
noise: same
initial: {x: [2.5, 1], x_hat: [2.5, 1], P: 0.01}
methods:
  EKF: {estimator: {kind: extended-kalman}}
  spread: {estimator: {kind: extended-kalman, spread: 1}}
  UKF: {estimator: {kind: unscented-kalman}}
  MHE: {estimator: {kind: nonlinear-moving-horizon, window: 5}}
metrics: [estimation_mse, nees]
figures: []
"""
DRIVEN = TEXT.replace("turning.py:free", "turning.py:rhs").replace("  outputs:", "  inputs: [f]\n  outputs:")


def config_of(folder, text, *, angles="angles: [theta, angle]", output="cut"):
    """Configuration of the wrapped plant, or of the straight one without angles."""
    (folder / "turning.py").write_text(PLANT, encoding="utf-8")
    path = folder / f"{output}.yaml"
    path.write_text(text.replace("OUTPUT", output).replace("ANGLES", angles), encoding="utf-8")
    return load_config(path)


def pair(folder, text):
    """The wrapped plant with angles, and the one that measures theta itself, without."""
    return config_of(folder, text), config_of(folder, text, angles="", output="straight")


NEES = 1
"""Place of the metric in TEXT."""


def simulated(config, name, runs=range(20)):
    """Trajectories and metrics of some runs, as one block."""
    experiment, method = config.experiment, config.experiment.method(name)
    draws = experiment.scenario.draw(experiment.plant, runs, experiment.n_steps)
    r = experiment.scenario.reference.sample(experiment.n_steps + 1 + method.preview)
    record, status = simulate(
        experiment.plant, method, draws, r, experiment.n_steps, with_P=True, info=["e"],
        start=RunStart(experiment.scenario.seed, tuple(runs), Journal()),
    )  # fmt: skip
    assert not status.any()
    record = record._replace(experiment=experiment.metric_layout)
    return record, np.array([metric.evaluate(record) for metric in experiment.metrics])


def test_filters_of_the_issue(tmp_path):
    """Oracle: the filters of y = theta without angles; without `angles` the wrapped output destroys the estimate."""
    wrapped_, straight = pair(tmp_path, TEXT)
    # A derivative by differences has ten digits.
    tolerances = {
        "EKF": {"rtol": 1e-8, "atol": 1e-9},
        "spread": {**ROUND, "atol": 1e-12},
        "UKF": {**ROUND, "atol": 1e-12},
        # The last step is below 1e-6 of a standard deviation.
        "MHE": {**SOLVER, "atol": 1e-7},
    }
    for name, tolerance in tolerances.items():
        (one, metrics), (other, _) = simulated(wrapped_, name), simulated(straight, name)
        assert (one.x[:, -1, 0] > TURN).all() and np.abs(one.y).max() < np.pi
        np.testing.assert_allclose(one.x_hat, other.x_hat, **tolerance)
        np.testing.assert_allclose(one.P, other.P, **tolerance)
        np.testing.assert_allclose(one.info["e"], other.info["e"], rtol=1e-6, atol=1e-7)
        assert (metrics[NEES] < 5.0).all()
    bare = config_of(tmp_path, TEXT, angles="", output="cut")
    assert max(simulated(bare, name)[1][NEES].max() for name in ("spread", "EKF")) > 50.0


@pytest.mark.parametrize(("factor", "angles"), [(1.0, "[theta]"), (180.0 / np.pi, "{theta: 360}")])
def test_one_correction(factor, angles, tmp_path):
    """Oracle: the numbers of the issue: e = 2 pi - 6.2, gain 0.8; a period of 360 in degrees is the same."""
    (tmp_path / "still.py").write_text("def rhs(x, u, p):\n    return [0.0]\n", encoding="utf-8")
    noise = f"{{process: 1.0e-9, measurement: {0.01 * factor**2}}}"
    config = {
        "version": 1, "name": "still", "runs": 1, "time": {"step": 0.1, "steps": 1},
        "plant": {"ode": f"{tmp_path}/still.py:rhs", "states": ["theta"], "angles": yaml.safe_load(angles)},
        "model": {"nonlinear": "plant", "noise": yaml.safe_load(noise)},
        "initial": {"x_hat": [3.1 * factor], "P": 0.04 * factor**2},
        "methods": {"UKF": {"estimator": {"kind": "unscented-kalman"}}}, "figures": [],
    }  # fmt: skip
    ukf = load_config(config, allow_code=tmp_path).experiment.method("UKF").estimator
    estimate = ukf.correct(0, ukf.init(1), np.array([[-3.1 * factor]]))[1]
    np.testing.assert_allclose(estimate.info["e"], [[0.083185307 * factor]], rtol=1e-8)
    np.testing.assert_allclose(estimate.x_hat, [[3.166548246 * factor]], rtol=1e-9)


LINEAR = "{kind: linear, A: [[1, 0.1], [0, 1]], B: [[0.005], [0.1]], C: [[1, 0]], P_w: [1.0e-6, 1.0e-4], P_v: 2.5e-3}"
FILTERS = {
    "kalman": "", "kalman-predictor": "", "robust-kalman": ", c: 0.01", "risk-sensitive": ", theta: 0.1",
    "fading-kalman": ", alpha: 1.05", "gated-kalman": "", "huber-kalman": "", "correntropy-kalman": ", sigma: 3",
    "student-kalman": ", dof: 5", "wasserstein-kalman": ", radius: 0.01", "h-infinity": ", gamma: 1000",
    "kalman-disturbance": ", D0: 1.0e-6", "moving-horizon": ", window: 5", "lp-window": "", "mixed": "",
    "extended-kalman": "", "unscented-kalman": "",
}  # fmt: skip


@pytest.mark.long
def test_every_filter_of_a_linear_model(tmp_path):
    """Oracle: the same filter of the straight output: measurements differ by whole periods only."""
    methods = "".join(f"  {kind}: {{estimator: {{kind: {kind}{keys}}}}}\n" for kind, keys in FILTERS.items())
    text = DRIVEN[: DRIVEN.index("methods:")] + f"methods:\n{methods}metrics: [estimation_mse]\nfigures: []\n"
    model = text.index("model:")
    text = text[:model] + f"model: {LINEAR}" + text[text.index("\n", model) :]
    wrapped_, straight = pair(tmp_path, text.replace("runs: 20", "runs: 2"))
    for kind in FILTERS:
        one, other = run_one(wrapped_, kind, 1), run_one(straight, kind, 1)
        assert one.status == other.status == "ok", kind
        # Measurements that differ by a turn are rounded differently; windows and iterations enlarge this.
        np.testing.assert_allclose(one.x_hat, other.x_hat, rtol=1e-7, atol=1e-7, err_msg=kind)
        np.testing.assert_allclose(one.metrics["estimation_mse"], other.metrics["estimation_mse"], **SOLVER)


LAWS = {
    "pid": "kind: pid, Kp: 2, Ki: 0.5, Kd: 1, Tf: 0.1",
    "pid of the estimate": "kind: pid, Kp: 2, Ki: 0.5, Kd: 1, on: estimate",
    "lqg": "kind: lqg, Q_x: [1, 0.1], Q_i: 0.1, R_u: 0.1",
    "lqg of the estimate": "kind: lqg, Q_x: [1, 0.1], Q_i: 0.1, R_u: 0.1, on: estimate",
    "mpc": "kind: mpc, Hp: 10, Hu: 3, Q: 1, R: 0.1, limits: {u: [-1, 1]}",
    "qp": "kind: mpc, Hp: 10, Hu: 3, Q: 1, R: 0.1, limits: {u: [-1, 1], enforce: qp}",
    "gpc": "kind: gpc, Np: 10, Q_yw: 1, Q_u: 0.1",
    "mpc at every sample": "kind: mpc, Hp: 10, Hu: 3, Q: 1, R: 0.1, preview: false",
}
LINEARISED = "model: {linearise: plant, at: {x: [0, 0], u: 0}, noise: {process: [1.0e-6, 1.0e-4], measurement: 2.5e-3}}"


def driven(reference, **changes):
    """Text of the closed loops with all laws, with a Kalman filter of the linearised model."""
    methods = "".join(f"  {name.replace(' ', '-')}: {{controller: {{{keys}}}}}\n" for name, keys in LAWS.items())
    text = DRIVEN[: DRIVEN.index("methods:")].replace(
        "model: {nonlinear: plant, noise: {process: [1.0e-6, 1.0e-4], measurement: 2.5e-3}}", LINEARISED
    )
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    return (
        f"{text}reference: {reference}\nestimator: {{kind: kalman}}\nmethods:\n{methods}"
        "metrics: [mse, settling_time, steady_state_error, {kind: tracking, norm: peak}]\nfigures: []\n"
    )


@pytest.mark.long
def test_laws_follow_the_nearest_turn(tmp_path):
    """Oracle: the law of the straight output with a reference up to 4.5 rad, which the other file has modulo 2 pi."""
    text = driven("{kind: square, values: [3, 4.5], period: 4}")
    start = ("initial: {x: [2.5, 1], x_hat: [2.5, 1], P: 0.01}", "initial: {x: [3, 0], x_hat: [3, 0], P: 0.01}")
    (tmp_path / "a").mkdir(), (tmp_path / "b").mkdir()
    straight = config_of(tmp_path / "b", text.replace(*start), angles="", output="straight")
    cut = driven(f"{{kind: square, values: [3, {4.5 - TURN}], period: 4}}")
    turned = config_of(tmp_path / "a", cut.replace(*start))
    for name in straight.methods:
        for run in range(3):
            one, other = run_one(turned, name, run), run_one(straight, name, run)
            np.testing.assert_allclose(one.u, other.u, rtol=1e-7, atol=1e-8, err_msg=name)
            np.testing.assert_allclose(one.x, other.x, rtol=1e-8, atol=1e-8, err_msg=name)
            for metric, value in other.metrics.items():
                np.testing.assert_allclose(one.metrics[metric], value, rtol=1e-6, atol=1e-9, err_msg=f"{name} {metric}")


@pytest.mark.long
def test_runs_with_different_turns_do_not_depend_on_their_block(tmp_path):
    """Oracle: some runs alone.  Runs turn in both directions at once, so that laws are called for groups of them."""
    wild = ("noise: same", "noise: {process: {gaussian: {std: [0.3, 0.5]}}, measurement: same}")
    config = config_of(tmp_path, driven("{kind: constant, value: 3}", noise=wild))
    final = np.empty(20)
    for name in config.methods:
        whole, metrics = simulated(config, name)
        for run in range(0, 20, 4):
            alone, own = simulated(config, name, range(run, run + 1))
            for signal in ("x", "x_hat", "y", "u"):
                np.testing.assert_array_equal(getattr(alone, signal)[0], getattr(whole, signal)[run], err_msg=name)
            np.testing.assert_array_equal(own[:, 0], metrics[:, run], err_msg=name)
        final = whole.x[:, -1, 0] if name == "mpc" else final
    assert len({*np.rint(final / TURN).tolist()}) > 2
    method = config.experiment.method("mpc")
    assert method.period is not None and not applies(config.experiment, method)


def test_metrics():
    """Oracle: by hand; -6.2 is 0.0832 away from 0."""
    angles = {"x.0": TURN, "y.0": TURN}
    record = Record.of_run(x=[0.1, 6.3, 0.0], x_hat=[6.3, 0.1, 0.0], y=[-3.1, -3.1, -3.1], r=3.1)
    record = record._replace(experiment=MetricLayout(2, angles=angles))
    np.testing.assert_allclose(EstimationMse().evaluate(record), (TURN - 6.2) ** 2, rtol=1e-12)
    for metric in (Tracking(norm="peak"), SteadyStateError(share=1.0, to=1.0)):
        np.testing.assert_allclose(metric.evaluate(record), TURN - 6.2, rtol=1e-12)
    settled = Record.of_run(y=[0.0, 3.0, -3.1], r=[3.1, 3.1, 3.1])._replace(experiment=MetricLayout(2, angles=angles))
    assert SettlingTime().evaluate(settled).item() == 1.0
    assert SettlingTime().evaluate(settled._replace(experiment=MetricLayout(2))).item() == np.inf
    assert turns(np.array([[np.nan, 7.0]]), np.array([TURN, 0.0])).tolist() == [[0.0, 0.0]]
    z = np.array([np.inf, 2.0])
    assert wrapped(z, None) is z
    around = near(lambda x: np.arctan2(np.sin(x), np.cos(x)), np.array([np.pi - 1e-3]), np.array([TURN]))
    np.testing.assert_allclose(around(np.array([np.pi + 1e-3])), np.pi + 1e-3, rtol=1e-12)


def test_linearised_at_the_cut(tmp_path):
    """Oracle: the derivative of y = theta, 1, where atan2 jumps by a turn within the steps of the difference."""
    text = TEXT.replace("{nonlinear: plant,", "{linearise: plant, at: {x: [3.141592653589793, 0], u: []},")
    text = text.replace("extended-kalman, spread: 1", "kalman").replace("kind: extended-kalman", "kind: kalman")
    config = config_of(tmp_path, text.replace("unscented-kalman", "kalman"))
    np.testing.assert_allclose(config.experiment.method("EKF").estimator.C[0], [[1.0, 0.0]], rtol=1e-9, atol=1e-9)


@pytest.mark.long
def test_figures_and_ensembles(tmp_path):
    """Errors that figures draw are wrapped, of recorded runs and of the ensemble; estimates keep their turns."""
    text = driven("{kind: constant, value: -3.1}").replace("x_hat: [2.5, 1]", f"x_hat: [{2.5 - TURN}, 1]")
    text = text.replace("figures: []", "figures: [{kind: signals, signals: [e, error]}]")
    text += "record: {runs: 5, signals: [y, u, x, x_hat, P]}\nevaluate: [runs, ensemble]\n"
    config = config_of(tmp_path, text)
    rmpc_bench.run(config, directory=tmp_path / "out", progress=False)
    trials = rmpc_bench.load_trials(tmp_path / "out")
    traces = trials.traces["mpc"]
    assert np.abs(traces.signals["x"] - traces.signals["x_hat"])[:, 0, 0].min() > 6.0
    assert np.abs(signal_of(traces, "e", 0)).max() <= np.pi
    assert np.abs(recorded_errors(trials, "mpc").e[:, :, 0]).max() < 1.0
    for groups in (trials.groups["mpc"], traces.groups(traces.runs)):
        assert np.abs(groups.series("mean(e)")[:, 0]).max() < 1.0
    assert trials.metrics and (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("angles", "message"),
    [
        ("angles: [thta]", r"plant.angles: 'thta' is not a known state or output of this plant; did you mean 'theta'"),
        ("angles: [theta, theta]", r"plant.angles: must name each signal once \(got theta, theta\)"),
        ("angles: {theta: 360, x.0: 6.28}", r"plant.angles: names 'x.0' twice"),
        ("angles: {theta: 0}", r"plant.angles.theta: must be > 0"),
        ("angles: theta", r"plant.angles: (expected|must be)"),
    ],
)
def test_what_is_no_angle(angles, message, tmp_path):
    """Names of states and outputs, with positive periods."""
    with pytest.raises(ConfigError, match=message):
        config_of(tmp_path, TEXT, angles=angles)


def test_a_model_with_its_own_angles(tmp_path):
    """An `ode` model may say which of its signals are angles; others take those of the plant."""
    noise = "noise: {process: 1.0e-4, measurement: 2.5e-3}"
    own = f"{{ode: turning.py:free, output: turning.py:cut, discrete: true, OWN {noise}}}"
    given = "{nonlinear: plant, noise: {process: [1.0e-6, 1.0e-4], measurement: 2.5e-3}}"
    for keys, angles, expected in (
        ("", "angles: {angle: 360}", [360.0]),
        ("angles: {angle: 2*pi},", "", [TURN]),
        ("angles: [theta],", "angles: {angle: 360}", [360.0]),
        ("", "", None),
    ):
        config = config_of(tmp_path, TEXT.replace(given, own.replace("OWN", keys)), angles=angles)
        period = config.experiment.method("UKF").period
        assert period is expected if expected is None else period.tolist() == expected
    with pytest.raises(ConfigError, match=r"model.angles: 'omga' is not a known state or output of this model"):
        config_of(tmp_path, TEXT.replace(given, own.replace("OWN", "angles: [omga],")))


def test_identity(tmp_path):
    """Angles are part of the plant; without them nothing is stored that was not."""
    bare, given = config_of(tmp_path, TEXT, angles=""), config_of(tmp_path, TEXT)
    assert "angles" not in bare.first_point["plant"] and given.first_point["plant"]["angles"]["theta"] == TURN
    assert bare.points[0].experiment_hash != given.points[0].experiment_hash
    same = config_of(tmp_path, TEXT, angles="angles: {theta: 2*pi, angle: 2*pi}")
    assert same.points[0].method_keys == given.points[0].method_keys
    assert bare.experiment.method("EKF").period is None
    assert given.experiment.angles == {"x.0": TURN, "y.0": TURN}


def test_pid_of_a_nonlinear_estimate(tmp_path):
    """Oracle: the loop of the linearised model, whose output is theta; h(x_hat) jumps at the cut, the loop does not."""
    laws = "methods:\n  EKF: {estimator: {kind: extended-kalman, spread: 1}}\nmetrics: [mse]\nfigures: []\n"
    pid = "controller: {kind: pid, Kp: 2, Ki: 0.5, Kd: 1, c: 1, on: estimate}\n"
    text = DRIVEN[: DRIVEN.index("methods:")] + "reference: {kind: constant, value: -2.9}\n" + pid + laws
    nonlinear = config_of(tmp_path, text)
    (tmp_path / "b").mkdir()
    straight = text.replace("value: -2.9", f"value: {TURN - 2.9}").replace(
        "{nonlinear: plant,", "{linearise: plant, at: {x: [0, 0], u: 0},"
    )
    linear = config_of(
        tmp_path / "b", straight.replace("extended-kalman, spread: 1", "kalman"), angles="", output="straight"
    )
    assert nonlinear.experiment.method("EKF").controller.linear_law() is None
    for run in range(3):
        one, other = run_one(nonlinear, "EKF", run), run_one(linear, "EKF", run)
        assert one.x[:, 0].max() > np.pi
        np.testing.assert_allclose(one.u, other.u, rtol=1e-8, atol=1e-9)


def test_groups_of_runs():
    """Oracle: the block as a whole; a status that some groups leave out is OK, and common matrices are not divided."""
    runs, rows = 4, [np.array([1, 3]), np.array([0, 2])]
    back = np.argsort(np.concatenate(rows))
    estimate = Estimate(
        np.arange(8.0).reshape(4, 2), np.eye(4), None, np.zeros(4, np.int8), {"e": np.arange(4.0)[:, None]}
    )
    parts = [_chosen(estimate, each) for each in rows]
    assert all(part.P is estimate.P and len(part.x_hat) == 2 for part in parts)
    whole = _joined(tuple(part._replace(P=None) for part in parts), back)
    np.testing.assert_array_equal(whole.x_hat, estimate.x_hat)
    np.testing.assert_array_equal(whole.info["e"], estimate.info["e"])
    commands = Command(np.ones((2, 1)), step_status=np.array([3, 4], np.int8)), Command(np.zeros((2, 1)))
    joined = _joined(commands, back)
    assert joined.step_status.tolist() == [0, 3, 0, 4] and joined.u.ravel().tolist() == [0.0, 1.0, 0.0, 1.0]
    assert len(joined.u) == runs and np.ndim(joined.status) == 0


@pytest.mark.long
def test_late_measurements_of_an_angle(tmp_path):
    """Oracle: the straight output, whose filters repeat the same late samples."""
    late = "noise: {process: same, measurement: {sum: [same, {delayed: [0, 3]}, {missing: {every: 2}}]}}"
    text = TEXT.replace("noise: same", late).replace("runs: 20", "runs: 2")
    wrapped_, straight = pair(tmp_path, text)
    for name in wrapped_.methods:
        one, other = run_one(wrapped_, name, 1), run_one(straight, name, 1)
        np.testing.assert_allclose(one.x_hat, other.x_hat, rtol=1e-6, atol=1e-7, err_msg=name)


def test_an_input_on_its_way_to_an_angle(tmp_path):
    """Oracle: the laws of the straight output with the same delay."""
    late = ("noise: same", "noise: {process: same, measurement: same, input: {delayed: 2}}")
    (tmp_path / "a").mkdir(), (tmp_path / "b").mkdir()
    text = driven("{kind: constant, value: 3}", noise=late).replace("runs: 20", "runs: 2")
    turned = config_of(tmp_path / "a", text.replace("value: 3", f"value: {3 - TURN}"))
    straight = config_of(tmp_path / "b", text, angles="", output="straight")
    for name in straight.methods:
        one, other = run_one(turned, name, 1), run_one(straight, name, 1)
        np.testing.assert_allclose(one.u, other.u, rtol=1e-7, atol=1e-8, err_msg=name)
