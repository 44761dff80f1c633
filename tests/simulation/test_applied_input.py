"""One meaning of u: what acts on the plant, for metrics, estimators and laws that remember their input."""

import numpy as np
import pytest
from small_experiment import arrays_of, cli, ran, text

from rmpc_bench import load_config, single_run
from rmpc_bench.conformance.subject import subject_of
from rmpc_bench.diagnostics.run_warnings import unlimited_inputs
from rmpc_bench.models.linearised import LinearisedModel
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.simulation.linear_loop import applies
from rmpc_bench.types import Command, Controller, Method, OperatingPoint

BOUND, N, TS = 0.4, 40, 0.1
A, B = np.array([[1.0, 0.1], [0.0, 0.95]]), np.array([0.005, 0.1])
CODE = """
def rhs(x, u, p):
    return [x[0] + 0.1 * x[1] + 0.005 * u[0], 0.95 * x[1] + 0.1 * u[0]]

def out(x, p):
    return [x[0]]
"""
ODE = (
    "{ode: m.py:rhs, output: m.py:out, states: [a, b], inputs: [f], outputs: [h], discrete: true, "
    "bounds: {f: [-0.4, 0.4]}}"
)
MODEL = "{linearise: plant, at: {x: [0, 0], u: 0}, noise: {process: 1e-4, measurement: 1e-4}}"
PID = "kind: pid, Kp: 4, Ki: 3"
LAWS = {
    "back-calculation": f"{PID}, Tt: 1.3333333333333333",
    "clamping": f"{PID}, anti_windup: clamping",
    "none": f"{PID}, anti_windup: none",
    "mpc": "kind: mpc, Hp: 10, Hu: 3, Q: 1, R: 0.01",
    "lqg": "kind: lqg, Q_y: 1, Q_i: 0.1, R_u: 0.1",
    "tracking": "kind: lqg, Q_y: 1, Q_i: 0.1, R_u: 0.1, anti_windup: back-calculation, Tt: 0.5",
    "gpc": "kind: gpc, Np: 10, Q_yw: 1, Q_u: 0.03, limits: {du: [-0.3, 0.3]}",
}
METRICS = (
    "[mse, estimation_mse, input_peak, input_power, {kind: largest, of: f}, {kind: violation, of: f, limit: 0.4}, "
    "{kind: sample, of: y.0}, {kind: largest, name: sent, of: u_command}, {kind: sample, name: last, of: u_command.0}, "
    "{kind: violation, name: beyond, of: u_command, limit: 0.4, what: largest}]"
)
EXPECTED = {
    "back-calculation": (0.370332791, 0.152419609, 1.395246146),
    "clamping": (0.364120194, 0.151243901, 1.334292465),
    "none": (0.416167065, 0.159762642, 1.885559203),
}
"""mse, input_power and y(N) by an independent computation, to nine digits."""


def methods():
    """Every law without limits and with limits of its own that equal the bounds of the plant."""
    found = {}
    for name, law in LAWS.items():
        found[name] = f"{{controller: {{{law}}}}}"
        own = law if "limits" in law else f"{law}, limits: {{}}"
        own = own.replace("limits: {", "limits: {u: [-0.4, 0.4], ")
        found[f"{name} limited"] = f"{{controller: {{{own}}}}}"
    return "{" + ", ".join(f"{name}: {each}" for name, each in found.items()) + "}"


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Return the example of a map with a bounded input, in which the state is known."""
    path = tmp_path_factory.mktemp("applied") / "applied.yaml"
    path.with_name("m.py").write_text(CODE, encoding="utf-8")
    keys = {"runs": 2, "time": f"{{step: {TS}, steps: {N}}}", "plant": ODE, "model": MODEL, "uncertainty": None}
    keys |= {"noise": None, "initial": None, "reference": "{kind: constant, value: 1}", "controller": None}
    keys |= {"estimator": "{kind: kalman}", "methods": methods(), "metrics": METRICS}
    path.write_text(text(**keys, record="{runs: 1, signals: [y, u, u_command]}"), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def results(file):
    """Return method -> metric -> value of run 0, and method -> recorded signals."""
    experiment = load_config(file).experiment
    names = [metric.name for metric in experiment.metrics]
    blocks = {method.name: simulate_block(experiment, method, range(2)) for method in experiment.methods}
    assert not any(block.status.any() for block in blocks.values())
    values = {name: dict(zip(names, block.metrics[:, 0], strict=True)) for name, block in blocks.items()}
    return values, {name: block.traces for name, block in blocks.items()}


def replayed(law):
    """Replay a PID law with anti-windup in plain Python; return y, the input that acts and the command."""
    x, integral, y, u, sent = np.zeros(2), 0.0, [], [], []
    for _ in range(N):
        e = 1.0 - x[0]
        raw = integral + 3.0 * TS * e
        v = 4.0 * e + raw
        applied = min(max(v, -BOUND), BOUND)
        if law == "back-calculation":
            integral = raw + TS / (4.0 / 3.0) * (applied - v)
        else:
            integral = integral if law == "clamping" and e * (applied - v) < 0.0 else raw
        y.append(x[0])
        u.append(applied)
        sent.append(v)
        x = A @ x + B * applied
    return np.array([*y, x[0]]), np.array(u), np.array(sent)


def replayed_mpc():
    """Replay predictive control by the normal equations of its cost; return y, the input that acts and the command."""
    hp, hu, R = 10, 3, 0.01
    powers = [np.linalg.matrix_power(A, j) for j in range(hp + 1)]
    step = [sum((powers[i] @ B)[0] for i in range(j)) for j in range(hp + 1)]
    M = np.array([[step[j - i] if j > i else 0.0 for i in range(hu)] for j in range(1, hp + 1)])
    x, before, y, u, sent = np.zeros(2), 0.0, [], [], []
    for _ in range(N):
        free = np.array([(powers[j] @ x)[0] + step[j] * before for j in range(1, hp + 1)])
        v = before + np.linalg.solve(M.T @ M + R * np.eye(hu), M.T @ (1.0 - free))[0]
        y.append(x[0])
        before = min(max(v, -BOUND), BOUND)
        u.append(before)
        sent.append(v)
        x = A @ x + B * before
    return np.array([*y, x[0]]), np.array(u), np.array(sent)


@pytest.mark.parametrize("law", ["back-calculation", "clamping", "none", "mpc"])
def test_metrics_and_records_have_the_input_that_acts(results, law):
    """Oracle: a replay in plain Python, and EXPECTED where it has values."""
    y, u, sent = replayed_mpc() if law == "mpc" else replayed(law)
    values, traces = results[0][law], results[1][law]
    for signal, expected in (("y", y), ("u", u), ("u_command", sent)):
        np.testing.assert_allclose(traces[signal][0, :, 0], expected, rtol=1e-9, atol=1e-12)
    assert values["estimation_mse"] < 1e-25
    assert values["input_peak"] == values["largest"] == BOUND
    assert values["violation"] == 0.0
    expected = {"mse": np.mean((1.0 - y[:N]) ** 2), "input_power": np.mean(u**2), "sample": y[N]}
    expected |= {"sent": np.abs(sent).max(), "last": sent[-1], "beyond": np.abs(sent).max() - BOUND}
    for name, value in expected.items():
        np.testing.assert_allclose(values[name], value, rtol=1e-9)
    if law in EXPECTED:
        found = [values[name] for name in ("mse", "input_power", "sample")]
        np.testing.assert_allclose(found, EXPECTED[law], rtol=0, atol=5e-10)


@pytest.mark.parametrize("law", LAWS)
def test_bounds_of_the_plant_are_limits_of_the_law(results, law):
    """Oracle: the same law with limits of its own, bit for bit; the memory of a law has the input that acts."""
    values, traces = results
    free, limited = traces[law], traces[f"{law} limited"]
    assert np.abs(limited["u"]).max() == BOUND
    for signal in ("y", "u"):
        np.testing.assert_array_equal(free[signal], limited[signal])
    np.testing.assert_array_equal(limited["u_command"], limited["u"])
    assert {n: v for n, v in values[law].items() if n not in ("sent", "last", "beyond")} == {
        n: v for n, v in values[f"{law} limited"].items() if n not in ("sent", "last", "beyond")
    }


def test_check_names_laws_without_limits(file):
    """Oracle: the laws of the file; those with equal limits are not named."""
    laws, plant = ", ".join(map(repr, LAWS)), "the plant limits `f` to [-0.4, 0.4]"
    limited = ", ".join(repr(f"{each} limited") for each in LAWS)
    way = "; it counts on inputs that do not act: give the controller `limits: {u: [..]}`"
    no_limits = f"{plant}; the controller of {laws} has no limits{way}"
    experiment = load_config(file).experiment
    assert [*unlimited_inputs(experiment.plant, experiment.methods)] == [no_limits]
    given = file.read_text(encoding="utf-8").replace("u: [-0.4, 0.4]", "u: [-0.4, 0.5]")
    (wider := file.with_name("wider.yaml")).write_text(given, encoding="utf-8")
    other = f"{plant}; the controller of {limited} has wider limits, [-0.4, 0.5]{way}"
    experiment = load_config(wider).experiment
    assert [*unlimited_inputs(experiment.plant, experiment.methods)] == [no_limits, other]
    given = file.read_text(encoding="utf-8").replace(methods(), f"{{A: {{controller: {{{LAWS['none']}}}}}}}")
    wider.write_text(given, encoding="utf-8")
    assert f"{plant}; the controller of 'A' has no limits{way}" in " ".join(cli("check", wider).stdout.split())


def test_commands_reach_files_figures_and_show(file, tmp_path):
    """Oracle: the trace of the store; the figure draws both signals with the unit and the name of the input."""
    keys = {"inputs: [f]": "inputs: {f: N}", "figures: []": "figures: [{kind: signals, signals: [u, u_command]}]"}
    given = file.read_text(encoding="utf-8").replace(methods(), f"{{none: {{controller: {{{LAWS['none']}}}}}}}")
    for old, new in keys.items():
        given = given.replace(old, new)
    (path := file.with_name("figures.yaml")).write_text(given, encoding="utf-8")
    ran(path, tmp_path / "out")
    shown = cli("show", tmp_path / "out", "--run", "0", "--method", "none", "--export", tmp_path / "run.npz")
    assert shown.exit_code == 0, shown.output
    assert "u_command" in shown.stdout and "bit for bit as stored" in shown.stdout
    arrays = arrays_of(tmp_path / "run.npz")
    y, u, sent = replayed("none")
    np.testing.assert_allclose(arrays["u"][:, 0], u, rtol=1e-9)
    np.testing.assert_allclose(arrays["u_command"][:, 0], sent, rtol=1e-9)
    svg = next((tmp_path / "out" / "figures").glob("*.svg")).read_text(encoding="utf-8")
    assert "f, command" in svg


def test_a_sequence_of_inputs_is_limited_and_counted(file):
    """The section `input` gives the command; oracle: np.clip."""
    given = file.read_text(encoding="utf-8")
    start, end = given.index("methods:"), given.index("metrics:")
    given = f"{given[:start]}input: {{kind: steps, times: [0], values: [0.7]}}\nmethods: {{K: {{}}}}\n{given[end:]}"
    given = given.replace("[mse, estimation_mse", "[estimation_mse").replace("reference", "# reference")
    (path := file.with_name("given.yaml")).write_text(given, encoding="utf-8")
    experiment = load_config(path).experiment
    block = simulate_block(experiment, experiment.methods[0], range(2))
    np.testing.assert_array_equal(block.traces["u"], np.full((1, N, 1), BOUND))
    np.testing.assert_array_equal(block.traces["u_command"], np.full((1, N, 1), 0.7))
    assert block.metrics[0, 0] < 1e-25
    assert block.journal.warnings["input f limited to [-0.4, 0.4]"] == 2 * N


def test_the_compiled_loop_leaves_bounds_to_the_other_one(file):
    """Oracle: the capabilities of the components alone."""
    experiment = load_config(file).experiment
    assert not any(applies(experiment, method) for method in experiment.methods)


def test_own_laws_and_filters_get_the_input_that_acts(file):
    """Oracle: np.clip of what the law returns; trap: a law with `deviation` works in u - u_op."""
    sent, seen = 0.1 * np.arange(1, N + 1), {"law": [], "filter": [], "batch": []}

    @single_run
    class Law:
        deviation = True

        def control(self, x_hat, r, u_previous, k):
            seen["law"].append(u_previous)
            return sent[k] - 0.3

    @single_run
    class Filter:
        def update(self, y, u_previous):
            seen["filter"].append(u_previous)
            return np.zeros(2)

    class Batch(Controller):
        def init(self, n_runs):
            return None

        def control(self, k, state, y, estimate, r):
            return state, Command(np.full((len(y), 1), sent[k]))

        def applied(self, k, state, u):
            seen["batch"].append(u[0])
            return state

    experiment, point = load_config(file).experiment, OperatingPoint(np.array([1.0, 0.0]), np.array([0.3]), np.ones(1))
    model = LinearisedModel(
        A, B[:, None], np.array([[1.0, 0.0]]), 1e-4 * np.eye(2), np.array([[1e-4]]), point=point, drift=np.zeros(2)
    )
    provided = {"model": model, "Ts": TS, "n_steps": N, "x0": np.zeros(2), "P0": np.eye(2), "M0": np.eye(2)}
    law, filter_ = (
        subject_of(each, group).made(group, provided) for each, group in ((Law, "controllers"), (Filter, "estimators"))
    )
    for controller in (law, Batch()):
        method = Method("own", filter_, controller)
        block = simulate_block(experiment, method, range(1))
        np.testing.assert_allclose(block.traces["u"][0, :, 0], np.minimum(sent, BOUND), rtol=1e-15)
        np.testing.assert_allclose(block.traces["u_command"][0, :, 0], sent, rtol=1e-15)
    applied = np.minimum(sent, BOUND)
    np.testing.assert_allclose(np.ravel(seen["law"][1:]), applied[:-1] - 0.3, rtol=1e-14)
    np.testing.assert_allclose(np.ravel(seen["filter"][1 : N + 1]), applied, rtol=1e-15)
    np.testing.assert_allclose(np.ravel(seen["batch"]), applied, rtol=1e-15)
