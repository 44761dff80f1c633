"""A small experiment with components of a user: a filter that fails, one that holds, one that warns."""

MODULE = '''
import numpy as np

from rmpc_bench import SolverError, single_run


@single_run
class Filter:
    """Observer with a constant gain."""

    def __init__(self, model, gain: float = 0.4, fails: str = ""):
        self.model, self.gain, self.fails = model, gain, fails

    def start(self, x0):
        self.x_pred = x0

    def update(self, y, u_previous, k, run):
        if self.fails == "raise" and run in (2, 5) and k == 4:
            level = -1.0
            raise ValueError(f"negative level {level}")
        if self.fails == "solver" and run == 3 and k in (2, 6):
            raise SolverError("maximum number of iterations reached")
        if self.fails == "warn":
            np.sqrt(np.array([-1.0]))
        x_hat = self.x_pred + self.gain * (y - self.x_pred)
        self.x_pred = 0.9 * x_hat
        return x_hat
'''
CONFIG = """
version: 1
name: own
seed: 3
runs: 8
time: {step: 0.5, steps: 10}
uncertainty: {eps: +-10%}
plant: {kind: uncertain-linear, A: 0.9, B: [[1]], C: [[1]], Bw: [[1]], Dv: 1, H_A: [[0.05]], G_x: [[1]],
        uncertainty: {law: uniform, low: -1, high: 1}}
model: {kind: linear, A: 0.9, B: [[1]], C: [[1]], P_w: 0.01, P_v: 0.04}
noise: {process: {gaussian: {std: 0.1}}, measurement: {gaussian: {std: 0.2}}}
methods:
  KF: {estimator: {kind: kalman}}
  good: {estimator: {file: mine.py:Filter}}
  raises: {estimator: {file: mine.py:Filter, fails: raise}}
  holds: {estimator: {file: mine.py:Filter, fails: solver, on_failure: hold, max_held: 30%}}
  stops: {estimator: {file: mine.py:Filter, fails: solver}}
  warns: {estimator: {file: mine.py:Filter, fails: warn}}
metrics: [estimation_mse]
figures: []
execution: {max_failures: 3}
"""


def write_own(directory, *, module=MODULE, config=CONFIG):
    """Write both files and return the configuration."""
    (directory / "mine.py").write_text(module, encoding="utf-8")
    path = directory / "own.yaml"
    path.write_text(config, encoding="utf-8")
    return path
