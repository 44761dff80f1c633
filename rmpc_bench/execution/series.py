"""Series of an experiment as a table: time-dependent data of the designs and of the ensemble of runs."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence

import numpy as np
import pandas as pd

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.sweep_point import SweepPoint
from rmpc_bench.execution.store import Store
from rmpc_bench.simulation.ensemble import Group, joined
from rmpc_bench.simulation.moments import Moments, exact_laws, exact_moments, signals
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Array, Method
from rmpc_bench.types.sweep_points import relevant_paths

COLUMNS = ["method", "quantity", "component", "k", "n", "value"]


class SeriesReader:
    """Makes the series of an experiment; points of a sweep that share a series get the same table.

    Parameters
    ----------
    config : the experiment
    store : its open store, for the moments of the ensemble
    """

    def __init__(self, config: ExperimentConfig, store: Store) -> None:
        self._config, self._store = config, store
        self._cache: dict[tuple[tuple[str, str], ...], pd.DataFrame] = {}

    def at_point(self, point: SweepPoint, methods: Sequence[str]) -> pd.DataFrame:
        """Series of some methods at one point of the sweep, with the columns `COLUMNS`."""
        key = tuple((name, self._key(point, name)) for name in methods)
        if key not in self._cache and len(methods) > 1:
            parts = [self.at_point(point, [name]) for name in methods]
            self._cache[key] = pd.concat(parts, ignore_index=True)
        elif key not in self._cache:
            method = point.experiment.method(methods[0]) if methods else None
            parts = [series([method])] if method is not None else [series([])]
            if method is not None and point.experiment.recording.ensemble:
                groups = self._store.ensemble(point.method_keys[method.name], point.experiment.n_runs)
                parts += ensembles(point.experiment, method, groups, exact="moments" in self._config.evaluate)
            self._cache[key] = pd.concat(parts, ignore_index=True)
        return self._cache[key]

    def of_sweep(self, methods: Sequence[str]) -> pd.DataFrame:
        """Series of some methods at all points, each once: columns of paths it does not depend on are empty."""
        config, parts = self._config, []
        for name in methods:
            rows = [(point.coordinates, self._key(point, name)) for point in config.points]
            paths = relevant_paths(rows, config.axes)
            seen: set[tuple[str, ...]] = set()
            for point in config.points:
                where = {path: point.coordinates[path] if path in paths else "" for path in config.paths}
                if tuple(where.values()) not in seen:
                    seen.add(tuple(where.values()))
                    parts.append(with_point(self.at_point(point, [name]), where))
        return pd.concat(parts, ignore_index=True)

    def _key(self, point: SweepPoint, name: str) -> str:
        """Return what the series of a method depend on; those of an ensemble depend on all that its trials do."""
        if point.experiment.recording.ensemble:
            return point.method_keys[name]
        design = {key: value for key, value in point.methods[name].items() if key != "controller"}
        return json.dumps([design, point.experiment.n_steps, point.experiment.plant.Ts], sort_keys=True)


def with_point(frame: pd.DataFrame, point: Mapping[str, str]) -> pd.DataFrame:
    """Put the columns of a sweep in front of a table."""
    return pd.concat([pd.DataFrame(dict(point), index=frame.index, dtype=object), frame], axis=1)


def ensembles(experiment: Experiment, method: Method, groups: Sequence[Group], *, exact: bool) -> list[pd.DataFrame]:
    """Mean and covariance of state, estimate and error over the runs: exact where they can be, and from groups of runs.

    Parameters
    ----------
    experiment : what the method runs in
    method : the pair
    groups : stored groups of its runs, in their order
    exact : whether exact moments are wanted
    """
    parts, nx = [], experiment.plant.nx
    laws = exact_laws(experiment.plant, method, experiment.scenario)
    schedule = method.estimator.gain_schedule
    if exact and schedule is not None and not isinstance(laws, str):
        found = exact_moments(experiment.plant, schedule, laws, experiment.n_steps)
        # The error of an unstable estimator may grow until it overflows.
        with np.errstate(over="ignore", invalid="ignore"):
            parts += [_long(method.name, name, values) for name, values in signals(found, nx).items()]
    if groups:
        n, mean, cov = joined(groups)
        sampled = signals(Moments(mean, cov), nx) if n > 1 else {}
        parts += [_long(method.name, name, values, n) for name, values in sampled.items()]
    return parts


def series(methods: Collection[Method]) -> pd.DataFrame:
    """Collect the series of the designs over k: gains, covariances, multipliers.

    Returns
    -------
    Columns ``method, quantity, component, k, n, value``; n = 0 means that the value is exact.
    """
    parts = [
        _long(method.name, quantity, np.asarray(values))
        for method in methods
        for quantity, values in method.estimator.series().items()
    ]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=COLUMNS)


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
