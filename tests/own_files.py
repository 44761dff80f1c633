"""Python files of a user for tests, and a small experiment that names them."""

from pathlib import Path

import small_experiment

from rmpc_bench import load_config

ESTIMATOR = '''
import numpy as np
from rmpc_bench import Estimator
from rmpc_bench.types import Estimate, Positive


class Own(Estimator):
    """Copies the first state from the measurement."""

    def __init__(self, model, x0, *, gain: Positive = 0.1):
        """Make it.

        Parameters
        ----------
        gain : how much of the innovation counts
        """
        self.model, self.x0, self.gain = model, x0, gain

    def init(self, n_runs):
        return np.tile(self.x0, (n_runs, 1))

    def correct(self, k, state, y):
        error = y - np.einsum("ij,rj->ri", self.model.C, state)
        x_hat = state + self.gain * error.sum(axis=1, keepdims=True)
        return x_hat, Estimate(x_hat, None, None, np.zeros(len(y), dtype=np.int8), {})

    def predict(self, k, state, u):
        return np.einsum("ij,rj->ri", self.model.A, state) + np.einsum("ij,rj->ri", self.model.B, u)
'''
METHODS = "{KF: {estimator: {kind: kalman}}, Own: {estimator: %s}}"


def write(directory, files=None, *, estimator="{file: own.py:Own}", **keys):
    """Write Python files and a configuration with the method `Own`; return the path of the configuration."""
    directory.mkdir(parents=True, exist_ok=True)
    for name, text in {"own.py": ESTIMATOR, **(files or {})}.items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_text(text, encoding="utf-8")
    return small_experiment.write(directory, **{"methods": METHODS % estimator, "runs": 4, **keys})


def own_estimator(path, **options):
    """Load a configuration and return the estimator of its method `Own`."""
    return load_config(Path(path), **options).experiment.method("Own").estimator
