"""Random trajectories with estimates, and methods whose estimator gives a constant."""

import numpy as np
from conftest import random_psd
from simulation.toy import Halfway, Proportional, Walk

from rmpc_bench.types import Estimate, Estimator, Method, MetricLayout, Record

TOY = Method("toy", Halfway(), Proportional())
N, RUNS, NX = 6, 4, 3
LAYOUT = MetricLayout(N, 0.5, "rad", "V")


def trajectories(rng, runs=RUNS, n_steps=N, nx=NX, per_run=None):
    """Random trajectories, with random P and M that are shared (False), per run (True) or not there (None)."""
    x, x_hat = rng.standard_normal((2, runs, n_steps + 1, nx))
    y, u = rng.standard_normal((runs, n_steps + 1, 2)), rng.standard_normal((runs, n_steps, 1))
    P = M = None
    if per_run is not None:
        shape = (runs, n_steps + 1) if per_run else (n_steps + 1,)
        P = np.array([random_psd(rng, nx) for _ in range(np.prod(shape))]).reshape(*shape, nx, nx)
        M = np.array([8.0 * random_psd(rng, nx) for _ in range(np.prod(shape))]).reshape(*shape, nx, nx)
    r = rng.standard_normal((n_steps + 1, 2))
    return Record(0.5, x, y, x_hat, u, r, P, M, experiment=LAYOUT._replace(n_steps=n_steps))


def plant(nx):
    """Toy plant with another number of states."""
    made = Walk()
    made.nx = nx
    return made


class Constant(Estimator):
    """An estimator that estimates 0 and reports constant matrices or none."""

    def __init__(self, nx, P, M):
        self.nx, self.P, self.M = nx, P, M

    def init(self, n_runs):
        """Nothing to remember."""

    def correct(self, k, state, y):
        """Estimate 0."""
        return state, Estimate(np.zeros((len(y), self.nx)), self.P, self.M, np.zeros(len(y), dtype=np.int8), {})


def method(nx, *, P=None, M=None, name="M"):
    """Pair with a constant estimator."""
    return Method(name, Constant(nx, P, M), TOY.controller)
