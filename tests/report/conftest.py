"""Small tables of trials, written by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import MetricInfo

MSE = MetricInfo("mse", "rad^2", "lower")


@pytest.fixture
def make_trials():
    """Return a function that makes Trials from ``{metric: {method: values}}``; a text in a value is a failed status."""

    def make(metrics, infos=(MSE,), labels=None):
        methods = tuple(next(iter(metrics.values())))
        rows = []
        for method in methods:
            columns = {name: values[method] for name, values in metrics.items()}
            for run in range(len(next(iter(columns.values())))):
                cells = {name: values[run] for name, values in columns.items()}
                words = [cell for cell in cells.values() if isinstance(cell, str)]
                numbers = {name: np.nan if words else float(cell) for name, cell in cells.items()}
                rows.append({"method": method, "run": run, "status": words[0] if words else "ok", **numbers})
        return Trials(
            name="tiny",
            methods=methods,
            labels={method: method for method in methods} | (labels or {}),
            metrics=tuple(infos),
            frame=pd.DataFrame(rows),
            series=pd.DataFrame([], columns=["method", "quantity", "component", "k", "n", "value"]),
            baseline=methods[0],
            confidence=0.95,
            relevant=0.01,
            seed=7,
        )

    return make
