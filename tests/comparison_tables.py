"""Tables of trials made of arrays, for comparisons of two experiments."""

from dataclasses import replace

import numpy as np
import pandas as pd
from data_frames import arrays

from rmpc_bench.analysis.runs import Extent, PointExtent
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import MetricInfo


def extent_of(trials, planned=None):
    """Return how many of the planned runs there are in every table; those that one of them has unless given."""
    sizes = [len(table.runs) for table in trials.each]
    points = [PointExtent(table.title, table.point, n, ()) for table, n in zip(trials.each, sizes, strict=True)]
    return Extent(max(sizes) if planned is None else planned, points)


def table(values, *, name="a", seed=7, first=0, metric="m", unit="", direction="lower", may_not_occur=False, **others):
    """Return the table of methods -> (n,) values of one metric; NaN is a failed run."""
    methods = tuple(values)
    n = len(next(iter(values.values())))
    flat = np.concatenate([np.asarray(values[method], dtype=float) for method in methods])
    frame = pd.DataFrame(
        {
            "method": np.repeat(methods, n),
            "run": np.tile(np.arange(first, first + n), len(methods)),
            "status": np.where(np.isnan(flat), "diverged", "ok"),
            metric: flat,
        }
    )
    return Trials(
        name=name,
        methods=methods,
        labels={},
        metrics=(MetricInfo(metric, unit, direction, may_not_occur=may_not_occur),),
        columns=arrays(frame),
        over_time=(),
        baseline=methods[0],
        confidence=0.95,
        relevant=0.01,
        seed=seed,
        **others,
    )


def drawn(make_trials, n=60, *, laws=None, seed=0, values=None, fails=None, **changes):
    """Return trials in which A differs from B by a function of two uniform quantities and some noise."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, (n, 2))
    b = np.exp(0.3 * u[:, 0] + rng.normal(0, 0.05, n))
    a = b * np.exp(-0.1 + 0.2 * u[:, 0] + 0.1 * u[:, 1] ** 2 + 0.02 * rng.standard_normal(n))
    if fails is not None:
        a = np.where(fails(u), np.nan, a)
    trials = make_trials({"mse": {"A": a, "B": b}} if values is None else values(u))
    quantities = {"run": np.arange(n), "eps": u[:, 0], "eta": u[:, 1]}
    unit = {"dist": "uniform", "low": -1, "high": 1}
    known = {"eps": unit, "eta": unit} if laws is None else laws
    return replace(trials, quantities=quantities, laws=known, random_besides=("noise",), **changes)
