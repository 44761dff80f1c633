"""Small tables of trials, written by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from data_frames import arrays
from data_frames import series as series_of

from rmpc_bench.analysis.traces import Traces
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import MetricInfo

MSE = MetricInfo("mse", "rad^2", "lower")


def legend(figure):
    """Texts of the legend."""
    return [words for text in figure.legends[0].get_texts() if (words := text.get_text())]


@pytest.fixture(scope="session")
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
            columns=arrays(pd.DataFrame(rows)),
            over_time=(),
            baseline=methods[0],
            confidence=0.95,
            relevant=0.01,
            seed=7,
        )

    return make


@pytest.fixture(scope="session")
def make_sweep():
    """Return a function that makes a sweep from ``[(point, table)]``."""

    def make(*points):
        tables = tuple(replace(table, point=point) for point, table in points)
        return replace(tables[0], paths=tuple(points[0][0]), points=tables, point={}, traces={})

    return make


@pytest.fixture(scope="session")
def record():
    """Return a function that adds recorded runs to a table, from ``{method: number of runs}``, and the reference."""

    def add(trials, counts, n_steps=40, Ts=0.5, seed=5):
        rng = np.random.default_rng(seed)
        traces = {}
        for method, n in counts.items():
            signals = {"y": 1, "u": 1, "x": 3, "x_hat": 2}
            arrays = {name: rng.normal(size=(n, n_steps + (name != "u"), width)) for name, width in signals.items()}
            r = np.where(np.arange(n_steps + 1) // 10 % 2 == 0, 1.0, -1.0)[:, None]
            traces[method] = Traces(np.arange(n), arrays, r)
        return replace(trials, traces=traces, Ts=Ts, units={"y": "rad", "u": "V"})

    return add


@pytest.fixture(scope="session")
def with_series():
    """Return a function that adds series to a table, each as (method, quantity, component, values over k, n)."""

    def add(trials, *series):
        parts = [
            pd.DataFrame({**dict(zip(names, head, strict=True)), "k": np.arange(len(values)), "value": values, "n": n})
            for *head, values, n in series
        ]
        return replace(trials, over_time=[*trials.over_time, *series_of(pd.concat(parts))])

    names = ("method", "quantity", "component")
    return add
