"""Tables of trials made of arrays, for comparisons of two experiments."""

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
