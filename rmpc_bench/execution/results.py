"""Stored trials as tables, and the verbs of the Python API that end in them."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
import pandas as pd

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.load import load_config
from rmpc_bench.config.sweep_point import SweepPoint
from rmpc_bench.execution.progress import Progress
from rmpc_bench.execution.runner import RESOLVED, compute
from rmpc_bench.execution.store import FILE, MissingError, Store
from rmpc_bench.execution.traces import traces_of, units_of
from rmpc_bench.simulation.ensemble import Group, joined
from rmpc_bench.simulation.moments import Moments, exact_laws, exact_moments, signals
from rmpc_bench.simulation.recording import kept
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Array, Method
from rmpc_bench.types.sweep_points import relevant_paths

Known: TypeAlias = dict[tuple[tuple[str, str], ...], pd.DataFrame]
"""Series of methods, by their names and what these depend on."""


def run(
    config: ExperimentConfig,
    *,
    directory: str | Path,
    jobs: int | None = None,
    only: Collection[str] | None = None,
    progress: Progress | None = None,
) -> Trials:
    """Compute what is missing in a directory and return the trials; the same call continues an interrupted one.

    Parameters
    ----------
    config : from `load_config`
    directory : where trials.sqlite lies or will lie
    jobs : worker processes, 1 for none; the configuration's unless given
    only : names of the methods to compute; all unless given
    progress : display; silent unless given
    """
    compute(config, Path(directory), workers=jobs, only=only, progress=progress)
    return stored_trials(config, Path(directory))


def load_trials(directory: str | Path) -> Trials:
    """Trials of a directory that `rmpc-bench run` has filled.

    Raises
    ------
    MissingError
        If there is no store in the directory.
    """
    if not (Path(directory) / FILE).exists():
        raise MissingError(f"{directory}: there is no {FILE}; fill the directory with `rmpc-bench run`")
    return stored_trials(load_config(Path(directory) / RESOLVED), Path(directory))


def stored_trials(config: ExperimentConfig, directory: Path) -> Trials:
    """Trials of a configuration that are stored in a directory.

    Methods without a single stored run are left out.

    Raises
    ------
    MissingError
        If there is no store, or nothing in it belongs to the configuration.
    StoreError
        If it is another experiment's.
    """
    if not (directory / FILE).exists():
        raise MissingError(f"{directory}: there is no {FILE}; fill the directory with `rmpc-bench run`")
    known: Known = {}
    with Store(directory, writable=False) as store:
        store.check(config.hash, config.shared)
        tables = [_table(config, point, store, known) for point in config.points]
        filled = [table for table in tables if len(table.methods)]
        if not filled:
            raise MissingError(f"{directory}: no trial of this configuration is stored; continue with `rmpc-bench run`")
        return _joined(config, filled, store, known) if config.paths else filled[0]


def _joined(config: ExperimentConfig, tables: Sequence[Trials], store: Store, known: Known) -> Trials:
    """Put the tables of all points of a sweep into one."""
    present = {method for table in tables for method in table.methods}
    methods = tuple(method.name for method in config.experiment.methods if method.name in present)
    return replace(
        tables[0],
        methods=methods,
        frame=pd.concat([with_point(table.frame, table.point) for table in tables], ignore_index=True),
        series=_all_series(config, methods, store, known),
        baseline=config.baseline if config.baseline in methods else methods[0],
        traces={},
        paths=config.paths,
        points=tuple(tables),
        alike=all(point.methods == config.methods for point in config.points),
        point={},
        title="",
        keys={},
    )


def _table(config: ExperimentConfig, point: SweepPoint, store: Store, known: Known) -> Trials:
    """Read the table of one point; ``known`` keeps what points share."""
    frames = [_frame(point, store, method.name) for method in point.experiment.methods]
    names = [method.name for method in point.experiment.methods]
    without_runs = "runs" not in config.evaluate
    methods = tuple(name for name, frame in zip(names, frames, strict=True) if len(frame) or without_runs)
    plant = point.experiment.plant
    traces = {name: trace for name in methods if (trace := traces_of(point, store, name)) is not None}
    return Trials(
        name=config.name,
        methods=methods,
        labels=config.labels,
        metrics=tuple(metric.info for metric in point.experiment.metrics),
        frame=pd.concat(frames, ignore_index=True),
        series=_series(config, point, methods, store, known),
        baseline=config.baseline if config.baseline in methods else (*methods, "")[0],
        confidence=config.statistics.confidence,
        relevant=config.statistics.relevant,
        seed=point.experiment.scenario.seed,
        Ts=0.0 if config.in_samples else plant.Ts,
        units=units_of(plant, traces.values()),
        traces=traces,
        point=point.coordinates,
        title=point.title,
        keys=point.method_keys,
        oracles=point.experiment.oracles,
    )


def _series(
    config: ExperimentConfig, point: SweepPoint, methods: Sequence[str], store: Store, known: Known
) -> pd.DataFrame:
    """Series of some methods at a point; ``known`` keeps them for points that share them."""
    believed = tuple((name, _series_key(config, point, name)) for name in methods)
    if believed not in known and len(methods) > 1:
        parts = [_series(config, point, [name], store, known) for name in methods]
        known[believed] = pd.concat(parts, ignore_index=True)
    elif believed not in known:
        method = point.experiment.method(methods[0]) if methods else None
        parts = [series([method])] if method is not None else [series([])]
        if method is not None and point.experiment.recording.ensemble:
            groups = store.ensemble(point.method_keys[method.name], point.experiment.n_runs)
            parts += ensembles(point.experiment, method, groups, exact="moments" in config.evaluate)
        known[believed] = pd.concat(parts, ignore_index=True)
    return known[believed]


def _series_key(config: ExperimentConfig, point: SweepPoint, name: str) -> str:
    """What the series of a method depend on; those of an ensemble on all that its trials do."""
    if point.experiment.recording.ensemble:
        return point.method_keys[name]
    believed = {key: value for key, value in point.methods[name].items() if key != "controller"}
    return json.dumps([believed, point.experiment.n_steps, point.experiment.plant.Ts], sort_keys=True)


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
    if exact and not isinstance(laws, str):
        found = exact_moments(cast("Any", experiment.plant), cast("Any", method.estimator), laws, experiment.n_steps)
        with np.errstate(over="ignore", invalid="ignore"):  # of an error that grows beyond all bounds
            parts += [_long(method.name, name, values) for name, values in signals(found, nx).items()]
    if groups:
        n, mean, cov = joined(groups)
        sampled = signals(Moments(mean, cov), nx) if n > 1 else {}
        parts += [_long(method.name, name, values, n) for name, values in sampled.items()]
    return parts


def _frame(point: SweepPoint, store: Store, name: str) -> pd.DataFrame:
    key = point.method_keys[name]
    runs, status = store.column(key, point.experiment.n_runs)
    columns = {metric: store.values(key, stored, runs) for metric, stored in point.metric_keys.items()}
    return pd.DataFrame({"method": name, "run": np.array(runs, dtype=np.int64), "status": status, **columns})


def with_point(frame: pd.DataFrame, point: Mapping[str, str]) -> pd.DataFrame:
    """Put the columns of a sweep in front of a table."""
    return pd.concat([pd.DataFrame(dict(point), index=frame.index, dtype=object), frame], axis=1)


def n_complete(config: ExperimentConfig, directory: Path) -> dict[str, int]:
    """How many runs of every method are stored with all metrics and traces, at the point where fewest are."""
    counts: dict[str, int] = {}
    with Store(directory, writable=False) as store:
        for point in config.points:
            n_runs = point.experiment.n_runs
            for name, key in point.method_keys.items():
                done = store.finished(key, point.metric_keys.values(), kept(point.experiment, name), n_runs)
                counts[name] = min(counts.get(name, n_runs), sum(run < n_runs for run in done))
    return counts


def uncertainty(config: ExperimentConfig, directory: Path) -> pd.DataFrame:
    """Every sampled value of the named uncertain quantities: sweep columns, ``run`` and one per quantity."""
    tables, known = [], {}
    with Store(directory, writable=False) as store:
        for point in config.points:
            if point.uncertainty_key not in known:
                rows = store.uncertainty(point.uncertainty_key, point.experiment.n_runs)
                known[point.uncertainty_key] = _wide(rows, list(point.experiment.scenario.uncertainty))
            table = known[point.uncertainty_key]
            tables.append(with_point(table, point.coordinates) if point.coordinates else table)
    return pd.concat(tables, ignore_index=True)


def _wide(rows: list[tuple[int, str, float]], names: list[str]) -> pd.DataFrame:
    table = pd.DataFrame(rows, columns=["run", "name", "value"]).pivot(index="run", columns="name", values="value")
    names = [*names, *sorted(name for name in table.columns if name not in names)]
    return table.reindex(columns=names).reset_index().rename_axis(columns=None)


def _all_series(config: ExperimentConfig, methods: Sequence[str], store: Store, known: Known) -> pd.DataFrame:
    """Series of the designs at all points, each once: the columns of paths it does not depend on are empty."""
    parts = []
    for name in methods:
        rows = [(point.coordinates, _series_key(config, point, name)) for point in config.points]
        paths = relevant_paths(rows, config.axes)
        seen: set[tuple[str, ...]] = set()
        for point in config.points:
            where = {path: point.coordinates[path] if path in paths else "" for path in config.paths}
            if tuple(where.values()) not in seen:
                seen.add(tuple(where.values()))
                parts.append(with_point(_series(config, point, [name], store, known), where))
    return pd.concat(parts, ignore_index=True)


def series(methods: Collection[Method]) -> pd.DataFrame:
    """What the designs say about themselves over k: gains, covariances, multipliers.

    Returns
    -------
    Columns ``method, quantity, component, k, n, value``; n = 0 means that the value is exact.
    """
    parts = [
        _long(method.name, quantity, np.asarray(values))
        for method in methods
        for quantity, values in getattr(method.estimator, "series", dict)().items()
    ]
    columns = ["method", "quantity", "component", "k", "n", "value"]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)


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


def n_failed(trials: Trials) -> int:
    """Failed trials over all methods and points; what points share counts once."""
    failed: dict[tuple[str, str | None], int] = {}
    for table in trials.each:
        failed |= {(name, table.keys.get(name)): table.n_failed(name) for name in table.methods}
    return sum(failed.values())
