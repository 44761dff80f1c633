"""Trajectories and results that metrics and figures of users are checked with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rmpc_bench.types import MetricInfo, MetricLayout, Record

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

RUNS, STEPS = 11, 130
"""Size of the trajectories; 130 samples of three states make NumPy's sums pairwise."""
METRICS = (MetricInfo("mse", "m^2", "lower"), MetricInfo("power", "V^2", "lower"))


def example_record() -> Record:
    """Return trajectories with everything that a metric may read; P and M belong to a run."""
    rng = np.random.default_rng(21)
    x, x_hat, y = rng.standard_normal((3, RUNS, STEPS + 1, 3))
    u, r = rng.standard_normal((RUNS, STEPS, 2)), 0.1 * rng.standard_normal((STEPS + 1, 3))
    roots = rng.standard_normal((2, RUNS, STEPS + 1, 3, 3))
    P, M = np.eye(3) + np.einsum("...ij,...kj->...ik", roots, roots)
    bursts = rng.random((RUNS, STEPS + 1)) < 0.3
    return Record(0.5, x, y, x_hat, u, r, P, M, bursts=bursts, experiment=MetricLayout(STEPS, 0.5, "m", "V"))


def example_results() -> Trials:
    """Return results of two methods: two metrics, recorded runs, a reported matrix and ensemble moments."""
    # Imported here, since pandas takes long and the other kinds do not need it.
    import pandas as pd

    from rmpc_bench.analysis.traces import Traces
    from rmpc_bench.analysis.trials import Trials

    rng, runs, steps = np.random.default_rng(2), 6, 20
    k = np.arange(steps + 1.0)
    rows = [
        {"method": method, "run": run, "status": "ok", "mse": rng.uniform(1.0, 2.0), "power": rng.uniform(1.0, 2.0)}
        for method in "AB"
        for run in range(runs)
    ]
    entries = [
        {"method": method, "quantity": name, "component": component, "k": at, "n": 0, "value": value}
        for method in "AB"
        for name, component, values in _series(k)
        for at, value in enumerate(values)
    ]
    sizes = {"y": (2, steps + 1), "u": (1, steps), "x": (2, steps + 1), "x_hat": (2, steps + 1)}
    traces = {
        method: Traces(
            np.arange(runs),
            {name: rng.standard_normal((runs, n_samples, n)) for name, (n, n_samples) in sizes.items()},
            np.zeros((steps + 1, 2)),
        )
        for method in "AB"
    }
    return Trials(
        name="example",
        methods=("A", "B"),
        labels={"A": "A", "B": "B"},
        metrics=METRICS,
        frame=pd.DataFrame(rows),
        series=pd.DataFrame(entries),
        baseline="A",
        confidence=0.95,
        relevant=0.01,
        seed=7,
        traces=traces,
        Ts=0.5,
    )


def _series(k: np.ndarray) -> list[tuple[str, str, np.ndarray]]:
    """Return name, component and values of the series of a method."""
    matrices = [(name, f"{i},{j}", (2.0 + k) * (i == j)) for name in ("P", "cov(e)") for i in (0, 1) for j in (0, 1)]
    return matrices + [(name, f"{i}", np.sin(k) + i) for name in ("mean(x)", "mean(x_hat)") for i in (0, 1)]
