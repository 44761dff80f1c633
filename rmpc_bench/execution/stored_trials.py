"""The stored trials of an experiment as tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from rmpc_bench.analysis.common_runs import common_runs
from rmpc_bench.analysis.looks import number_of_look
from rmpc_bench.analysis.run_groups import RunGroups
from rmpc_bench.analysis.run_notes import RunNotes
from rmpc_bench.analysis.trials import Trials, stacked_rows, with_point
from rmpc_bench.execution import manifest
from rmpc_bench.execution.other_code import rows_kept_apart
from rmpc_bench.execution.series import SeriesReader, groups_within
from rmpc_bench.execution.step_times import with_step_times
from rmpc_bench.execution.stored_experiment import StoredExperiment, StoredPoint
from rmpc_bench.execution.traces import traces_of, with_estimates
from rmpc_bench.received.store import MissingError
from rmpc_bench.store.store import WORDS, Store
from rmpc_bench.types import Array


def stored_trials(experiment: StoredExperiment, store: Store) -> Trials:
    """Read the stored trials of an experiment, without methods that have no stored run.

    Raises a MissingError if there are none.
    """
    frames = [{name: _frame(experiment, point, store, name) for name in point.methods} for point in experiment.points]
    common = [common_runs(frame["run"].to_numpy() for frame in found.values()) for found in frames]
    series = SeriesReader(experiment, store, common)
    quantities: dict[str, pd.DataFrame] = {}
    tables = [
        _table(experiment, number, store, found, series, common[number], quantities)
        for number, found in enumerate(frames)
    ]
    filled = [table for table in tables if len(table.methods)]
    if not filled:
        apart = other_code(experiment, store)
        stored = f"{apart}; no trial" if apart else "no trial of this configuration"
        raise MissingError(f"{store.directory}: {stored} is stored; continue with `rmpc-bench run`")
    n_runs = max(len(table.common.runs) for table in filled)
    if experiment.has_runs and not n_runs:
        text = "no run is stored of every method yet; continue with `rmpc-bench run`"
        raise MissingError(f"{store.directory}: {text}")
    look = number_of_look(manifest.looks_of_store(store), n_runs)
    filled = [replace(table, look=look) for table in filled]
    return _joined(experiment, filled, series) if experiment.paths else filled[0]


def _joined(experiment: StoredExperiment, tables: Sequence[Trials], series: SeriesReader) -> Trials:
    """Put the tables of all points of a sweep into one."""
    whole = replace(
        tables[0],
        methods=experiment.methods,
        baseline=experiment.baseline,
        traces={},
        paths=experiment.paths,
        alike=experiment.alike,
        point={},
        title="",
        keys={},
    ).with_points(tables)
    return replace(whole, series=series.of_sweep(whole.methods))


def _table(
    experiment: StoredExperiment,
    number: int,
    store: Store,
    frames: Mapping[str, pd.DataFrame],
    series: SeriesReader,
    common: Array | None,
    quantities: dict[str, pd.DataFrame],
) -> Trials:
    """Read the table of one point; `quantities` keeps what points share."""
    point = experiment.points[number]
    methods = tuple(name for name, frame in frames.items() if len(frame) or not experiment.has_runs)
    notes = {name: _notes(experiment, point, store, name) for name in methods}
    traces = {name: trace for name in methods if (trace := traces_of(point, store, name)) is not None}
    return Trials(
        name=experiment.name,
        methods=methods,
        labels=experiment.labels,
        metrics=point.metrics,
        frame=stacked_rows([*frames.values()]),
        series=series.at_point(number, methods),
        baseline=experiment.baseline if experiment.baseline in methods else (*methods, "")[0],
        confidence=experiment.level,
        planned=None if experiment.stop is None else experiment.stop.planned,
        relevant=experiment.relevant,
        margins=experiment.margins,
        primary=experiment.primary,
        average=experiment.average,
        headline=experiment.headline,
        lost=experiment.lost,
        ranked=experiment.axes if experiment.ranks else None,
        seed=point.seed,
        Ts=point.Ts,
        units=with_estimates(point, point.units, traces.values()),
        names=with_estimates(point, point.names, traces.values()),
        traces=traces,
        point=point.coordinates,
        title=point.title,
        keys={name: method.key for name, method in point.methods.items()},
        oracles=frozenset(name for name, method in point.methods.items() if method.is_oracle),
        groups={
            name: groups for name in methods if (groups := _groups(experiment, point, store, name, common)) is not None
        },
        with_verdicts=not experiment.is_smoke,
        expected_failures=experiment.expected_failures,
        notes=with_step_times(notes, experiment, point, store),
        declared=tuple(experiment.methods),
        uncertainty=_quantities(experiment, point, store, quantities),
        random_besides=point.random_besides,
        limitations=point.limitations,
        requirements=experiment.requirements,
        parameters=experiment.origins,
        limits={name: method.limits for name, method in point.methods.items()},
    )


def _notes(experiment: StoredExperiment, point: StoredPoint, store: Store, name: str) -> RunNotes:
    """Read what happened in the runs of a method besides their numbers."""
    method, n_runs = point.methods[name], experiment.n_runs
    failures = tuple(store.failures(method.key, n_runs))
    held, warnings = store.held(method.key, n_runs), store.warnings(method.key, n_runs)
    failed = store.failed_steps(method.key, n_runs)
    return RunNotes(point.n_steps, method.holds, failures, held, warnings, None, method.optimises, failed)


def _groups(
    experiment: StoredExperiment, point: StoredPoint, store: Store, name: str, common: Array | None
) -> RunGroups | None:
    """Read the moments over the runs, group by group; None where none are stored, or fewer than two groups."""
    if not point.has_ensemble:
        return None
    stored = groups_within(store.ensemble(point.methods[name].key, experiment.n_runs), common)
    parts = [part for part in stored if part.n]
    whole = [part for part in parts if not part.is_single] or parts
    if len(whole) < 2:
        return None
    runs = tuple(np.arange(part.first, part.stop) for part in whole)
    zero = np.zeros((whole[0].mean.shape[0], *whole[0].mean.shape[1:], whole[0].mean.shape[1]))
    second = np.array([zero if part.is_single else part.second for part in whole])
    n, mean = np.array([part.n for part in whole]), np.array([part.mean for part in whole])
    return RunGroups(runs, n, mean, second, point.nx)


def _frame(experiment: StoredExperiment, point: StoredPoint, store: Store, name: str) -> pd.DataFrame:
    key = point.methods[name].key
    runs, status = store.statuses(key, experiment.n_runs)
    columns = {metric: store.values(key, stored, runs) for metric, stored in point.metric_keys.items()}
    return pd.DataFrame({"method": name, "run": runs, "status": WORDS[status], **columns})


def other_code(experiment: StoredExperiment, store: Store) -> str:
    """Describe the stored rows of other code that are missing in the tables; empty where there are none."""
    return str(rows_kept_apart(experiment.stored_methods, store, experiment.n_runs))


def n_complete(experiment: StoredExperiment, store: Store) -> dict[str, int]:
    """Count the runs of every method that are stored with all metrics and traces, at the point where fewest are."""
    counts: dict[str, int] = {}
    for point in experiment.points:
        for name, method in point.methods.items():
            done = store.finished(method.key, point.metric_keys.values(), point.recording(name), experiment.n_runs)
            counts[name] = min(counts.get(name, experiment.n_runs), len(done))
    return counts


def uncertainty(experiment: StoredExperiment, store: Store) -> pd.DataFrame:
    """Read every sampled value of the named uncertain quantities: sweep columns, ``run`` and one per quantity."""
    tables: list[pd.DataFrame] = []
    cached: dict[str, pd.DataFrame] = {}
    for point in experiment.points:
        table = _quantities(experiment, point, store, cached)
        tables.append(with_point(table, point.coordinates) if point.coordinates else table)
    return stacked_rows(tables)


def _quantities(
    experiment: StoredExperiment, point: StoredPoint, store: Store, cached: dict[str, pd.DataFrame]
) -> pd.DataFrame:
    """Read the sampled values at one point: ``run`` and one column per quantity."""
    if point.uncertainty_key not in cached:
        runs, columns = store.uncertainty(point.uncertainty_key, experiment.n_runs)
        names = [*point.uncertainty, *(name for name in columns if name not in point.uncertainty)]
        missing = np.full(len(runs), np.nan)
        table = pd.DataFrame({"run": runs, **{name: columns.get(name, missing) for name in names}})
        cached[point.uncertainty_key] = table
    return cached[point.uncertainty_key]
