"""Runs of a linear system, recorded in csv files, and configurations that replay them."""

import numpy as np

from rmpc_bench import load_config, run

SYSTEM = "A: [[0.9, 0.2], [0, 0.7]], B: [[0], [1]], C: [[1, 0]]"
N_RUNS, N = 5, 20
TEXT = """
version: 1
name: {name}
seed: 3
runs: {runs}
time: {{step: 0.1, steps: 20}}
plant: {plant}
model: {{kind: linear, {system}, P_w: 0.01, P_v: 0.04}}
{more}
methods: {methods}
metrics: {metrics}
record: {{runs: all, signals: [u, x, x_hat]}}
figures: []
"""
METHODS = "{KF: {estimator: {kind: kalman}}}"
REPLAY = "{data: 'runs/*.csv', columns: {y: level, u: voltage}, t: time}"
WITH_STATE = "{data: 'runs/*.csv', columns: {y: level, u: voltage, x: [x1, x2]}, t: time}"
SIMULATED = f"{{kind: linear, {SYSTEM}}}"


def write(directory, plant=REPLAY, *, name="replay", runs=N_RUNS, more="", methods=METHODS, metrics="[nis]"):
    """Write a configuration and return its path."""
    path = directory / f"{name}.yaml"
    values = {"name": name, "runs": runs, "plant": plant, "system": SYSTEM, "more": more}
    path.write_text(TEXT.format(**values, methods=methods, metrics=metrics), encoding="utf-8")
    return path


def record(directory):
    """Simulate the runs, record them in runs/run-I.csv and return their signals, with the measured y."""
    more = "noise: same\ninput: {kind: sine, amplitude: 1, period: 1}"
    config = load_config(write(directory, SIMULATED, name="original", more=more, metrics="[estimation_mse, nis]"))
    results = run(config, directory=directory / "original", jobs=1)
    signals = dict(next(iter(results.traces.values())).signals)
    experiment = config.points[0].experiment
    v = experiment.scenario.draw(experiment.plant, range(N_RUNS), N).v
    signals["y"] = signals["x"][:, :, :1] + v
    (directory / "runs").mkdir()
    for i in range(N_RUNS):
        write_run(directory / "runs" / f"run-{i}.csv", *(signals[name][i] for name in ("u", "y", "x")))
    return signals, results.trials.frame


def write_run(path, u, y, x, times=None):
    """Write a recorded run; NaN is an empty cell."""
    times = 0.1 * np.arange(len(y)) if times is None else times
    rows = [
        ",".join("" if np.isnan(v) else repr(float(v)) for v in (t, u[min(k, len(u) - 1), 0], y[k, 0], *x[k]))
        for k, t in enumerate(times)
    ]
    path.write_text("time,voltage,level,x1,x2\n" + "\n".join(rows) + "\n", encoding="utf-8")
