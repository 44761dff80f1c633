"""The stored trials of a configuration as tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from rmpc_bench.analysis.looks import number_of_look
from rmpc_bench.analysis.run_groups import RunGroups
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.sweep_point import SweepPoint
from rmpc_bench.execution import manifest
from rmpc_bench.execution.database import FILE, MissingError
from rmpc_bench.execution.other_code import rows_of_other_code
from rmpc_bench.execution.series import SeriesReader, with_point
from rmpc_bench.execution.store import Store
from rmpc_bench.execution.traces import traces_of, units_of
from rmpc_bench.simulation.recording import kept


def stored_trials(config: ExperimentConfig, directory: Path, *, with_verdicts: bool = True) -> Trials:
    """Read the trials of a configuration that are stored in a directory.

    Methods without a single stored run are left out.

    Parameters
    ----------
    config : the experiment
    directory : where its trials.sqlite lies
    with_verdicts : whether comparisons have a verdict

    Raises
    ------
    MissingError
        If there is no store, or nothing in it belongs to the configuration.
    StoreError
        If it is another experiment's.
    """
    if not (directory / FILE).exists():
        raise MissingError(f"{directory}: there is no {FILE}; fill the directory with `rmpc-bench run`")
    with Store(directory, writable=False) as store:
        store.check(config.hash, config.shared)
        series = SeriesReader(config, store)
        tables = [_table(config, point, store, series) for point in config.points]
        tables = [replace(table, with_verdicts=with_verdicts) for table in tables]
        filled = [table for table in tables if len(table.methods)]
        if not filled:
            apart = rows_of_other_code(config, store, config.methods)
            stored = f"{apart}; no trial" if apart else "no trial of this configuration"
            raise MissingError(f"{directory}: {stored} is stored; continue with `rmpc-bench run`")
        look = number_of_look(manifest.looks(directory), max(len(table.runs) for table in filled))
        filled = [replace(table, look=look) for table in filled]
        return _joined(config, filled, series) if config.paths else filled[0]


def _joined(config: ExperimentConfig, tables: Sequence[Trials], series: SeriesReader) -> Trials:
    """Put the tables of all points of a sweep into one."""
    present = {method for table in tables for method in table.methods}
    methods = tuple(method.name for method in config.experiment.methods if method.name in present)
    return replace(
        tables[0],
        methods=methods,
        frame=pd.concat([with_point(table.frame, table.point) for table in tables], ignore_index=True),
        series=series.of_sweep(methods),
        baseline=config.baseline if config.baseline in methods else methods[0],
        traces={},
        paths=config.paths,
        points=tuple(tables),
        alike=all(point.methods == config.methods for point in config.points),
        point={},
        title="",
        keys={},
    )


def _table(config: ExperimentConfig, point: SweepPoint, store: Store, series: SeriesReader) -> Trials:
    """Read the table of one point."""
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
        metrics=point.experiment.metric_infos,
        frame=pd.concat(frames, ignore_index=True),
        series=series.at_point(point, methods),
        baseline=config.baseline if config.baseline in methods else (*methods, "")[0],
        confidence=config.statistics.confidence,
        relevant=config.statistics.relevant_change,
        margins=config.statistics.margins,
        primary=config.primary,
        average=config.statistics.average,
        headline=config.headline,
        seed=point.experiment.scenario.seed,
        Ts=0.0 if config.in_samples else plant.Ts,
        units=units_of(plant, traces.values()),
        traces=traces,
        point=point.coordinates,
        title=point.title,
        keys=point.method_keys,
        oracles=point.experiment.oracles,
        groups={name: groups for name in methods if (groups := _groups(point, store, name)) is not None},
    )


def _groups(point: SweepPoint, store: Store, name: str) -> RunGroups | None:
    """Read the moments over the runs, group by group; None where none are stored, or fewer than two groups."""
    if not point.experiment.recording.ensemble:
        return None
    stored = store.ensemble(point.method_keys[name], point.experiment.n_runs)
    parts = [part for part in stored if part.n]
    whole = [part for part in parts if not part.is_single] or parts
    if len(whole) < 2:
        return None
    runs = tuple(np.arange(part.first, part.stop) for part in whole)
    zero = np.zeros((whole[0].mean.shape[0], *whole[0].mean.shape[1:], whole[0].mean.shape[1]))
    second = np.array([zero if part.is_single else part.second for part in whole])
    n, mean = np.array([part.n for part in whole]), np.array([part.mean for part in whole])
    return RunGroups(runs, n, mean, second, point.experiment.plant.nx)


def _frame(point: SweepPoint, store: Store, name: str) -> pd.DataFrame:
    key = point.method_keys[name]
    runs, status = store.column(key, point.experiment.n_runs)
    columns = {metric: store.values(key, stored, runs) for metric, stored in point.metric_keys.items()}
    return pd.DataFrame({"method": name, "run": np.array(runs, dtype=np.int64), "status": status, **columns})


def other_code(config: ExperimentConfig, directory: Path) -> str:
    """Describe the stored rows of other code that are missing in the tables; empty where there are none."""
    with Store(directory, writable=False) as store:
        return rows_of_other_code(config, store, config.methods)


def n_complete(config: ExperimentConfig, directory: Path) -> dict[str, int]:
    """Count the runs of every method that are stored with all metrics and traces, at the point where fewest are."""
    counts: dict[str, int] = {}
    with Store(directory, writable=False) as store:
        for point in config.points:
            n_runs = point.experiment.n_runs
            for name, key in point.method_keys.items():
                done = store.finished(key, point.metric_keys.values(), kept(point.experiment, name), n_runs)
                counts[name] = min(counts.get(name, n_runs), sum(run < n_runs for run in done))
    return counts


def uncertainty(config: ExperimentConfig, directory: Path) -> pd.DataFrame:
    """Read every sampled value of the named uncertain quantities: sweep columns, ``run`` and one per quantity."""
    tables: list[pd.DataFrame] = []
    cached: dict[str, pd.DataFrame] = {}
    with Store(directory, writable=False) as store:
        for point in config.points:
            if point.uncertainty_key not in cached:
                rows = store.uncertainty(point.uncertainty_key, point.experiment.n_runs)
                cached[point.uncertainty_key] = _wide(rows, list(point.experiment.scenario.uncertainty))
            table = cached[point.uncertainty_key]
            tables.append(with_point(table, point.coordinates) if point.coordinates else table)
    return pd.concat(tables, ignore_index=True)


def _wide(rows: list[tuple[int, str, float]], names: list[str]) -> pd.DataFrame:
    table = pd.DataFrame(rows, columns=["run", "name", "value"]).pivot(index="run", columns="name", values="value")
    names = [*names, *sorted(name for name in table.columns if name not in names)]
    return table.reindex(columns=names).reset_index().rename_axis(columns=None)
