"""An experiment of two inputs and outputs around an operating point, with missing samples, and what it drew."""

from typing import Any, NamedTuple

import numpy as np

import rmpc_bench

TS, STEPS, RUNS, A = 0.1, 12, 5, 1.2
U_OP = np.array([1.0, 0.5])
CONFIGURATION = """
version: 1
name: alone
runs: {runs}
time: {{step: {Ts}, steps: {steps}}}
uncertainty: {{eps: +-30%}}
plant: {plant}
model: {model}
noise:
  process: {process}
  measurement: {{sum: [{{gaussian: {{std: [0.02, 0.03]}}}}, {{missing: {{probability: 30%}}}}]}}
initial: {{{initial}x_hat: [1.1, 1.2], P: 0.04}}
{driven}
methods: {{Kalman: {{estimator: {{kind: kalman}}}}{methods}}}
metrics: [estimation_mse]
record: {{runs: {runs}, signals: [x, y, u, x_hat]}}
figures: []
"""
RHS = """
def rhs(x, u, p):
    return [u[0] - p.a * x[0] * abs(x[0]) + 0.3 * x[1], u[1] - 0.8 * x[1] + 0.2 * x[0]]

def output(x, p):
    return [x[0], x[0] + x[1]]
"""
SIGNALS = "states: [a1, a2], inputs: [u1, u2], outputs: [y1, y2], parameters: {a: 1.2}, perturb: {a: 1 + eps}"
ODE = f"{{ode: rhs.py:rhs, output: rhs.py:output, {SIGNALS}}}"
NOISE = "{process: [1e-4, 4e-4], measurement: [4e-4, 9e-4]}"
LINEARISED = f"{{linearise: plant, at: {{u: [1.0, 0.5], guess: 1.0}}, noise: {NOISE}}}"
PRBS = "input: {kind: prbs, low: [0.8, 0.4], high: [1.2, 0.6], hold: 0.3}"


class Simulated(NamedTuple):
    """Results of an experiment, and what it drew."""

    results: Any
    experiment: Any
    traces: Any
    status: dict[str, list[str]]
    y: dict[str, np.ndarray]
    """Method -> (runs, samples, 2) what is measured, NaN where it is missing."""
    draws: Any
    eps: np.ndarray


def complete(trace, n_runs):
    """Return recorded runs with NaN for those that are not recorded, as an exception has ended their simulation."""
    signals = {name: np.full((n_runs, *values.shape[1:]), np.nan) for name, values in trace.signals.items()}
    for name, values in trace.signals.items():
        signals[name][trace.runs] = values
    return trace._replace(runs=np.arange(n_runs), signals=signals)


def simulated(directory, files=(), *, all_fail_alike=True, **keys):
    """Run an experiment with one and with two processes, whose tables are equal; run 2 of all but Kalman fails."""
    given = {"plant": ODE, "model": LINEARISED, "process": "{gaussian: {std: [0.01, 0.02]}}", "methods": ""}
    given |= {"driven": PRBS, "initial": "x: [1.0, 1.0], ", "runs": RUNS, "Ts": TS, "steps": STEPS, **keys}
    for name, text in {"rhs.py": RHS, **dict(files)}.items():
        (directory / name).write_text(text)
    path = directory / "alone.yaml"
    path.write_text(CONFIGURATION.format(**given))
    config = rmpc_bench.load_config(path)
    one, two = (rmpc_bench.run(config, directory=directory / f"j{n}", jobs=n, engine="joblib") for n in (1, 2))
    assert one.trials.frame.equals(two.trials.frame)
    for name, trace in one.traces.items():
        for signal, values in trace.signals.items():
            np.testing.assert_array_equal(values, two.traces[name].signals[signal])
    status = {name: part["status"].tolist() for name, part in one.trials.frame.groupby("method")}
    experiment, n_steps = config.experiment, given["steps"]
    draws = experiment.scenario.draw(experiment.plant, range(given["runs"]), n_steps)
    y, traces = {}, {name: complete(trace, given["runs"]) for name, trace in one.traces.items()}
    for name, trace in one.trials.traces.items():
        y_true = complete(trace, given["runs"]).signals["y"]
        measured = [draws.altered(k, y_true[:, k] + draws.v[:, k]) for k in range(n_steps + 1)]
        y[name] = np.stack(measured, axis=1)
        assert 0.05 < np.isnan(y[name]).mean() < 0.6
    if all_fail_alike:
        words = {name: [each == "ok" for each in words] for name, words in status.items() if name != "Kalman"}
        assert all(each == [run != 2 for run in range(given["runs"])] for each in words.values()), status
    return Simulated(two, experiment, traces, status, y, draws, one.trials.uncertainty["eps"].to_numpy())
