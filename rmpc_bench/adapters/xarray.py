"""Trials as data sets of xarray: labelled arrays over sweep, method and run, which can be saved as netCDF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rmpc_bench.analysis.trial_arrays import metric_attributes, points_of, recorded, table_of, values_of
from rmpc_bench.extras import library

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.results.results import Results


def dataset(trials: Trials | Results | str | Path) -> Any:
    """Return metrics and statuses as an `xarray.Dataset` over the points of a sweep, method and run.

    Parameters
    ----------
    trials : a directory of results, or what `load_trials`, `load_results` or `run` returns

    Returns
    -------
    A variable per metric (NaN where the run failed or is missing, inf where an event did not occur) with `units`,
    `long_name` and `better`, and the variable `status` (empty where the run is missing).  The uncertain quantities are
    coordinates of the run.  A full grid of a sweep has a dimension per path; other sweeps have the dimension `point`.
    Select with ``sel({"method": "Kalman"})``, not with ``sel(method=..)``, whose argument is an option of xarray.

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> config = rmpc_bench.load_config("configs/quickstart.yaml", runs=4)
    >>> dataset(rmpc_bench.run(config, directory=tempfile.mkdtemp(), jobs=1))["mse"].dims
    ('method', 'run')
    """
    table = _table(trials)
    points = points_of(table)
    dims = (*points.dims, "method", "run")
    variables: dict[str, Any] = {"status": (dims, values_of(points, "status"))}
    for info in table.metrics:
        variables[info.name] = (dims, values_of(points, info.name), metric_attributes(info))
    coordinates = {**points.coordinates, "method": list(points.methods), "run": points.runs, **points.uncertainty}
    coordinates["label"] = ("method", [table.labels.get(name, name) for name in points.methods])
    return library("xarray").Dataset(variables, coordinates, {"name": table.name, "Ts": float(table.Ts)})


def traces(trials: Trials | Results | str | Path) -> Any:
    """Return recorded runs as an `xarray.Dataset`.

    Parameters
    ----------
    trials : as for `dataset`, with recorded runs; in a sweep one of ``trials.points``

    Returns
    -------
    A variable per recorded signal over method, run, time and its components, the reference `r` over time, and the
    variable `status`.  An entry is NaN where a signal has none: u at the last sample, a signal of other methods, and
    all samples after that at which a run has failed.

    Raises
    ------
    ValueError
        If no run is recorded, or the trials are those of a whole sweep.
    """
    table = _table(trials)
    runs, k, signals, r = recorded(table)
    variables = {name: (("method", "run", "time", f"{name}_component"), values) for name, values in signals.items()}
    time = k * (table.Ts or 1.0)
    coordinates = {"method": list(table.methods), "run": runs, "time": time, **_components(table.names, signals)}
    points = points_of(table)
    status = values_of(points, "status")[:, np.isin(points.runs, runs)]
    more = {"r": (("time", "y_component"), r), "status": (("method", "run"), status)}
    made = library("xarray").Dataset({**variables, **more}, coordinates)
    for name in signals:
        made[name].attrs = {"units": table.units.get(name, "")}
    return made


def _table(trials: Trials | Results | str | Path) -> Trials:
    from rmpc_bench.results.results import load_trials

    return load_trials(trials) if isinstance(trials, str | Path) else table_of(trials)


def _components(names: Mapping[str, str], signals: Mapping[str, Any]) -> dict[str, Sequence[str]]:
    sizes = {name: np.shape(values)[-1] for name, values in signals.items()}
    return {f"{name}_component": [names.get(f"{name}.{i}", str(i)) for i in range(n)] for name, n in sizes.items()}
