"""The table of trials: methods x runs x metrics, and the series of the designs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from rmpc_bench.types import Array, MetricInfo, Status


@dataclass(frozen=True, eq=False)
class Trials:
    """What an experiment left behind, ready for statistics.

    Parameters
    ----------
    name : name of the experiment
    methods : names in the order of the configuration
    labels : method name -> text for tables and figures
    metrics : one record per metric column of `frame`
    frame : columns `method, run, status` and one float column per metric (NaN where the run failed, inf for never),
        sorted by method (order of the configuration), then run
    series : columns `method, quantity, component, k, n, value`; `component` is a text such as "0,1", "2" or "" for
        scalars; n = 0 means exact
    baseline : the method that all others are compared with
    confidence : level of every interval, such as 0.95
    relevant : the smallest relative change that matters, such as 0.01
    seed : seed of the experiment
    """

    name: str
    methods: tuple[str, ...]
    labels: Mapping[str, str]
    metrics: tuple[MetricInfo, ...]
    frame: pd.DataFrame
    series: pd.DataFrame
    baseline: str
    confidence: float
    relevant: float
    seed: int

    @property
    def runs(self) -> Array:
        """The run indices of the table, ascending."""
        return np.unique(self.frame["run"].to_numpy(dtype=np.int64))

    def column(self, metric: str, method: str) -> Array:
        """Values of one metric of one method over all runs.

        Parameters
        ----------
        metric : name of a metric column
        method : name of a method

        Returns
        -------
        (n_runs,) values in the order of `runs`; NaN where the run failed or is absent, inf for never
        """
        rows = self.frame[(self.frame["method"] == method) & (self.frame["status"] == Status.OK.word)]
        values = pd.Series(rows[metric].to_numpy(dtype=float), index=rows["run"].to_numpy(dtype=np.int64))
        return np.array(values.reindex(self.runs), dtype=float)

    def pairs(self, metric: str, method: str, other: str) -> tuple[Array, Array]:
        """Values of two methods in the runs that both finished.

        Parameters
        ----------
        metric : name of a metric column
        method, other : names of the two methods

        Returns
        -------
        two arrays of shape (n_pairs,), entry i of both from the same run
        """
        a, b = self.column(metric, method), self.column(metric, other)
        both = ~(np.isnan(a) | np.isnan(b))
        return a[both], b[both]

    def n_failed(self, method: str) -> int:
        """Count the runs of `method` that ended with any status but ok."""
        status = self.frame.loc[self.frame["method"] == method, "status"]
        return int((status != Status.OK.word).sum())

    def matrix_series(self, quantity: str, method: str) -> Array:
        """Assemble a series of a design; where it exists exactly and from runs, the exact one counts.

        Parameters
        ----------
        quantity : name in the column `quantity`
        method : name of a method

        Returns
        -------
        (samples,), (samples, rows) or (samples, rows, columns) array with axis 0 = k, NaN where an entry is absent

        Raises
        ------
        KeyError
            when the method has no such series
        """
        rows = self.series[(self.series["quantity"] == quantity) & (self.series["method"] == method)]
        if rows.empty:
            raise KeyError(f"{method} has no series {quantity}")
        n = rows["n"].to_numpy(dtype=np.int64)
        rows = rows[n == (0 if (n == 0).any() else n.max())]
        entries = np.array([_indices(text) for text in rows["component"]], dtype=np.int64)
        samples, position = np.unique(rows["k"].to_numpy(dtype=np.int64), return_inverse=True)
        values = np.full((len(samples), *(entries.max(axis=0) + 1)), np.nan)
        values[(position, *entries.T)] = rows["value"].to_numpy(dtype=float)
        return values


def _indices(component: str) -> tuple[int, ...]:
    return tuple(int(part) for part in component.split(",")) if component else ()
