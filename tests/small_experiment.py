"""A small experiment as YAML text, ways to change it, and the command line in this process.

`KEYS` holds one line of YAML per top-level key, so that a test changes one thing and a mistake in `plant` is at the
line that `place` gives.
"""

import gc
import signal

import numpy as np
from click.testing import CliRunner

KEYS = {
    "version": "1",
    "name": "tiny",
    "seed": "7",
    "runs": "6",
    "time": "{step: 0.1, steps: 10}",
    "uncertainty": "{eps: +-20%}",
    "plant": "{kind: servo-linear, perturb: {J_l: 1 + eps}}",
    "model": "{kind: servo-linear, noise: {process: 1.0, measurement: 1.0}}",
    "noise": "{measurement: {gaussian: {std: 0.01}}}",
    "initial": "{x: 0, x_hat: 0, P: process}",
    "reference": "{kind: constant, value: pi/2}",
    "controller": "{kind: mpc, Hp: 10, Hu: 3, Q: 0.1, R: 0.1, scale: {u: 440, y: 2*pi}, limits: {u: [-220, 220]}}",
    "methods": "{S-MPC: {estimator: {kind: kalman}}, R-MPC: {estimator: {kind: robust-kalman, c: 0.1}}}",
    "metrics": "[mse, input_power]",
    "figures": "[]",
}


def text(**keys):
    """YAML text of the small experiment with some top-level keys replaced or added; None leaves a key out."""
    lines = KEYS | {name: str(value) for name, value in keys.items() if value is not None}
    return "".join(f"{name}: {value}\n" for name, value in lines.items() if keys.get(name, "") is not None)


def write(directory, *, file="tiny.yaml", **keys):
    """Write the text into a file and return its path."""
    path = directory / file
    path.write_text(text(**keys), encoding="utf-8")
    return path


def cli(*arguments):
    """Call the command line in this process; the result has `exit_code`, `stdout` and `stderr`."""
    from rmpc_bench.cli import main

    before, thresholds = signal.getsignal(signal.SIGTERM), gc.get_threshold()
    try:
        return CliRunner().invoke(main, [str(argument) for argument in arguments])
    finally:
        signal.signal(signal.SIGTERM, before)
        gc.set_threshold(*thresholds)
        gc.unfreeze()


def ran(path, directory, *options, jobs=1):
    """Call `rmpc-bench run` into a directory and return its trials.csv; anything but exit 0 fails the test."""
    # By themselves few runs would not start several workers.
    engine = ("--engine", "joblib") if jobs > 1 else ()
    result = cli("run", path, "-o", directory, "-j", jobs, "--progress", "none", *engine, *options)
    assert result.exit_code == 0, result.output
    return (directory / "trials.csv").read_bytes()


def spied(monkeypatch):
    """Return a list that gets (method, runs) of every block computed in this process from now on."""
    from rmpc_bench.engines import tasks

    blocks, simulate = [], tasks.simulate_block

    def spy(experiment, method, runs, *draws):
        blocks.append((method.name, [*runs]))
        return simulate(experiment, method, runs, *draws)

    monkeypatch.setattr(tasks, "simulate_block", spy)
    return blocks


def arrays_of(path):
    """Read all arrays of an npz file and close it."""
    with np.load(path) as file:
        return dict(file)
