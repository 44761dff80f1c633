"""Records of runs under bursts, and a plant with outputs in different units."""

import math

import numpy as np
from simulation.toy import Walk

from rmpc_bench.metrics.input import InputPeak, InputRms, InputVariation
from rmpc_bench.types import MetricLayout, Record

N, RUNS, Ts = 60, 4, 0.5
LAYOUT = MetricLayout(N, Ts, "m", "V", bursts=True)
INPUTS = {
    InputVariation: lambda u, ks: sum(np.abs(u[k] - u[k - 1]).sum() for k in ks) / len(ks),
    InputRms: lambda u, ks: math.sqrt(sum((u[k] ** 2).sum() for k in ks) / (len(ks) * u.shape[1])),
    InputPeak: lambda u, ks: max(np.abs(u[k]).max() for k in ks),
}
"""Metric of inputs -> the same, sample by sample."""
PARTS = [{}, {"during": "bursts"}, {"during": "quiet"}]
PARTS += [{"during": "bursts", "memory": 1.2}, {"during": "quiet", "memory": 1.0}]
SPANS = [[(10, 14), (30, 31)], [(0, 3)], [(55, 60)], [(7, 7), (9, 20)]]
"""Samples in bursts, first and last, of every run."""


def trajectories(rng, runs=RUNS, n_steps=N, spans=SPANS):
    """Random trajectories of three outputs and two inputs, under bursts."""
    x, x_hat = rng.standard_normal((2, runs, n_steps + 1, 2))
    y, u = rng.standard_normal((runs, n_steps + 1, 3)), rng.standard_normal((runs, n_steps, 2))
    k = np.arange(n_steps + 1)
    bursts = np.array([[any(a <= each <= b for a, b in spans[i % len(spans)]) for each in k] for i in range(runs)])
    layout = LAYOUT._replace(n_steps=n_steps)
    return Record(Ts, x, y, x_hat, u, rng.standard_normal((n_steps + 1, 3)), bursts=bursts, experiment=layout)


def counts(i, k, during="all", memory=0.0):
    """Whether sample k of run i is one that a metric with these keys counts."""
    inside = any(a <= k <= b + memory / Ts for a, b in SPANS[i])
    return during == "all" or inside == (during == "bursts")


class Mixed(Walk):
    """A plant of three outputs in different units."""

    ny, y_unit, u_unit = 3, "", "N m"
    has_singular_poses = True
    units = {"y.0": "m", "y.1": "m", "y.2": "rad", "x.0": "V"}

    def manipulability(self, y):
        """Distance of the first output from 0."""
        return np.abs(y[:, 0])
