"""Stored trials as tables, and the verbs of the Python API that end in them."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas as pd

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.experiment.config import ExperimentConfig, load_config
from rmpc_bench.experiment.progress import Progress
from rmpc_bench.experiment.runner import RESOLVED, compute, method_key, metric_keys
from rmpc_bench.experiment.store import FILE, MissingError, Store
from rmpc_bench.types import Array, Method, Status


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
    with Store(directory, writable=False) as store:
        store.check(config.hash, config.shared)
        frames = [_frame(config, store, method.name) for method in config.experiment.methods]
    filled = [frame for frame in frames if len(frame)]
    if not filled:
        raise MissingError(f"{directory}: no trial of this configuration is stored; continue with `rmpc-bench run`")
    methods = tuple(str(frame["method"].iloc[0]) for frame in filled)
    return Trials(
        name=config.name,
        methods=methods,
        labels=config.labels,
        metrics=tuple(metric.info for metric in config.experiment.metrics),
        frame=pd.concat(filled, ignore_index=True),
        series=series([method for method in config.experiment.methods if method.name in methods]),
        baseline=config.baseline if config.baseline in methods else methods[0],
        confidence=config.statistics.confidence,
        relevant=config.statistics.relevant,
        seed=config.experiment.scenario.seed,
    )


def _frame(config: ExperimentConfig, store: Store, name: str) -> pd.DataFrame:
    key = method_key(config, name)
    runs, status = store.column(key, config.experiment.n_runs)
    columns = {metric: store.values(key, stored, runs) for metric, stored in metric_keys(config).items()}
    return pd.DataFrame({"method": name, "run": np.array(runs, dtype=np.int64), "status": status, **columns})


def n_complete(config: ExperimentConfig, directory: Path) -> dict[str, int]:
    """How many runs of every method are stored with all metrics of the configuration."""
    keys, n_runs = metric_keys(config).values(), config.experiment.n_runs
    with Store(directory, writable=False) as store:
        return {
            method.name: sum(run < n_runs for run in store.finished(method_key(config, method.name), keys))
            for method in config.experiment.methods
        }


def uncertainty(config: ExperimentConfig, directory: Path) -> pd.DataFrame:
    """Every sampled value of the named uncertain quantities: columns ``run`` and one per quantity."""
    with Store(directory, writable=False) as store:
        rows = store.uncertainty(config.experiment.n_runs)
    table = pd.DataFrame(rows, columns=["run", "name", "value"]).pivot(index="run", columns="name", values="value")
    return table.reindex(columns=list(config.experiment.scenario.uncertainty)).reset_index().rename_axis(columns=None)


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


def _long(method: str, quantity: str, values: Array) -> pd.DataFrame:
    """Spread an array with axis 0 = k over rows, one per k and component."""
    n_samples, inner = len(values), values.shape[1:]
    components = [",".join(map(str, index)) for index in np.ndindex(*inner)]
    flat = values.reshape(n_samples, -1)
    return pd.DataFrame(
        {
            "method": method,
            "quantity": quantity,
            "component": np.repeat(np.array(components, dtype=object), n_samples),
            "k": np.tile(np.arange(n_samples), len(components)),
            "n": 0,
            "value": flat.T.ravel(),
        }
    )


def n_failed(trials: Trials) -> int:
    """Failed trials over all methods."""
    return int((trials.frame["status"] != Status.OK.word).sum())
