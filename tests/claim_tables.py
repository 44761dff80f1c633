"""Small tables of trials, written by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from data_frames import LONG, arrays
from data_frames import series as series_of

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import MetricInfo


@pytest.fixture
def make_trials():
    """Return a function that makes Trials from ``{metric: {method: values}}``; None in a value marks a failed run."""

    def make(metrics, series=(), directions=None, relevant=0.01):
        directions = directions or {}
        methods = tuple(next(iter(metrics.values())))
        rows = []
        for method in methods:
            columns = {name: values[method] for name, values in metrics.items()}
            for run in range(len(next(iter(columns.values())))):
                cells = {name: values[run] for name, values in columns.items()}
                failed = None in cells.values()
                status = "diverged" if failed else "ok"
                numbers = {name: np.nan if failed else float(value) for name, value in cells.items()}
                rows.append({"method": method, "run": run, "status": status, **numbers})
        return Trials(
            name="tiny",
            methods=methods,
            labels={method: method for method in methods},
            metrics=tuple(MetricInfo(name, "", directions.get(name, "lower")) for name in metrics),
            columns=arrays(pd.DataFrame(rows)),
            over_time=series_of(pd.DataFrame(list(series), columns=LONG)),
            baseline=methods[-1],
            confidence=0.95,
            relevant=relevant,
            seed=7,
        )

    return make
