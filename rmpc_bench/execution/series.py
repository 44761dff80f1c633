"""Series of an experiment as a table: time-dependent data of the designs and of the ensemble of runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from rmpc_bench.analysis.trials import stacked_rows, with_point
from rmpc_bench.execution.stored_experiment import StoredExperiment, StoredPoint
from rmpc_bench.simulation.ensemble import Group, joined
from rmpc_bench.simulation.moments import Moments, signals
from rmpc_bench.store.store import Store
from rmpc_bench.types import Array
from rmpc_bench.types.sweep_points import relevant_paths

COLUMNS = ["method", "quantity", "component", "k", "n", "value"]


class SeriesReader:
    """Reads the series of an experiment; points of a sweep that share a series get the same table.

    An ensemble has the common runs of its point: in the order of the points, None where these are all runs.
    """

    def __init__(self, experiment: StoredExperiment, store: Store, common: Sequence[Array | None]) -> None:
        self._experiment, self._store, self._common = experiment, store, common
        self._cache: dict[tuple[tuple[str, str, bytes], ...], pd.DataFrame] = {}

    def at_point(self, number: int, methods: Sequence[str]) -> pd.DataFrame:
        """Series of some methods at one point of the sweep, with the columns `COLUMNS`."""
        point, runs = self._experiment.points[number], self._common[number]
        chosen = runs.tobytes() if runs is not None and point.has_ensemble else b""
        key = tuple((name, point.methods[name].series_key, chosen) for name in methods)
        if key not in self._cache and len(methods) > 1:
            self._cache[key] = stacked_rows([self.at_point(number, [name]) for name in methods])
        elif key not in self._cache:
            parts = (
                [*self._of_design(point, methods[0]), *self._of_ensemble(point, methods[0], runs)] if methods else []
            )
            self._cache[key] = stacked_rows(parts or [pd.DataFrame(columns=COLUMNS)])
        return self._cache[key]

    def of_sweep(self, methods: Sequence[str]) -> pd.DataFrame:
        """Series of some methods at all points, each once: columns of paths it does not depend on are empty."""
        points, parts = self._experiment.points, []
        for name in methods:
            rows = [(point.coordinates, point.methods[name].series_key) for point in points]
            paths = relevant_paths(rows, self._experiment.axes)
            seen: set[tuple[str, ...]] = set()
            for number, point in enumerate(points):
                where = {path: point.coordinates[path] if path in paths else "" for path in self._experiment.paths}
                if tuple(where.values()) not in seen:
                    seen.add(tuple(where.values()))
                    parts.append(with_point(self.at_point(number, [name]), where))
        return stacked_rows(parts)

    def _of_design(self, point: StoredPoint, method: str) -> list[pd.DataFrame]:
        """Gains, covariances, multipliers of a design over k."""
        series = point.methods[method].series
        return [_long(method, quantity, self._store.array(name)) for quantity, name in series.items()]

    def _of_ensemble(self, point: StoredPoint, method: str, runs: Array | None) -> list[pd.DataFrame]:
        """Mean and covariance of state, estimate and error over the runs: exact where they can be, and from groups."""
        parts, exact = [], point.methods[method].moments
        if exact is not None:
            moments = Moments(*(self._store.array(name) for name in exact))
            # The error of an unstable estimator may grow until it overflows.
            with np.errstate(over="ignore", invalid="ignore"):
                parts += [_long(method, name, values) for name, values in signals(moments, point.nx).items()]
        groups = []
        if point.has_ensemble:
            groups = groups_within(self._store.ensemble(point.methods[method].key, self._experiment.n_runs), runs)
        if groups:
            n, mean, cov = joined(groups)
            sampled = signals(Moments(mean, cov), point.nx) if n > 1 else {}
            parts += [_long(method, name, values, n) for name, values in sampled.items()]
        return parts


def groups_within(groups: Sequence[Group], runs: Array | None) -> list[Group]:
    """Return the groups of which all runs are among some; None for all runs."""
    return [each for each in groups if runs is None or np.isin(np.arange(each.first, each.stop), runs).all()]


def _long(method: str, quantity: str, values: Array, n: int = 0) -> pd.DataFrame:
    """Spread an array with axis 0 = k over rows, one per k and component; n = 0 means exact."""
    n_samples, inner = len(values), values.shape[1:]
    components = [",".join(map(str, index)) for index in np.ndindex(*inner)]
    flat = values.reshape(n_samples, -1)
    return pd.DataFrame(
        {
            "method": method,
            "quantity": quantity,
            "component": np.repeat(np.array(components, dtype=object), n_samples),
            "k": np.tile(np.arange(n_samples), len(components)),
            "n": n,
            "value": flat.T.ravel(),
        }
    )
