"""The table of trials as arrays over the points, methods and runs, and with six digits for figures of every CPU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.analysis.rounding import rounded
from rmpc_bench.analysis.traces import Traces
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array, MetricInfo

METHOD, RUN = "method", "run"
ROWS = 100_000
"""Numbers of a column that are rounded together, which takes twenty times their memory."""


class Points(NamedTuple):
    """The dimensions of the arrays, and the tables that fill them."""

    dims: tuple[str, ...]  # dimensions of the sweep; empty without one
    shape: tuple[int, ...]
    places: tuple[tuple[int, ...], ...]  # place of every table among them
    tables: tuple[Trials, ...]
    coordinates: Mapping[str, Any]
    uncertainty: Mapping[str, Any]
    methods: tuple[str, ...]
    runs: Int[Array, " runs"]


def table_of(trials: Any) -> Trials:
    """Return the table of trials of results, or the table itself."""
    return getattr(trials, "trials", trials)  # type: ignore[no-any-return]


def points_of(table: Trials) -> Points:
    """Return the dimensions of a table: one per path where the points of the sweep are a full grid."""
    tables = table.each
    runs = np.unique(np.concatenate([each.runs for each in tables]))
    values = {path: list(dict.fromkeys(each.point[path] for each in tables)) for path in table.paths}
    n_grid = int(np.prod([len(each) for each in values.values()]))
    dims: tuple[str, ...] = table.paths
    shape: tuple[int, ...] = tuple(len(each) for each in values.values())
    # Without a sweep there are no dimensions, and one place.
    places = tuple(tuple(values[path].index(each.point[path]) for path in dims) for each in tables)
    coordinates: dict[str, Any] = {path: _numbers(texts) for path, texts in values.items()}
    if n_grid != len(tables):
        dims, shape, places = ("point",), (len(tables),), tuple((i,) for i in range(len(tables)))
        by_point = {path: _numbers([each.point[path] for each in tables]) for path in table.paths}
        coordinates = {"point": [each.title for each in tables]} | {path: ("point", v) for path, v in by_point.items()}
    found = Points(dims, shape, places, tables, coordinates, {}, table.methods, runs)
    return found._replace(uncertainty=_uncertainty(found))


def _numbers(texts: Sequence[str]) -> list[Any]:
    """Return the values of a path as numbers where all of them are numbers."""
    try:
        return [float(text) for text in texts]
    except ValueError:
        return list(texts)


def values_of(points: Points, column: str) -> Array:
    """Return a column of the table as an array over sweep, method and run; NaN, or no text, where a row is missing."""
    is_text = column == "status"
    shape = (*points.shape, len(points.methods), len(points.runs))
    # Texts of one length: netCDF has no objects.
    values: Array = np.full(shape, "", dtype="<U16") if is_text else np.full(shape, np.nan)
    for place, table in zip(points.places, points.tables, strict=True):
        columns = table.columns
        method = np.array([points.methods.index(name) for name in columns[METHOD]], dtype=int)
        values[place][method, np.searchsorted(points.runs, columns[RUN])] = columns[column]
    return values


def _uncertainty(points: Points) -> dict[str, Any]:
    """Return the uncertain quantities: over the runs, or over sweep and runs where points differ."""
    names = dict.fromkeys(name for table in points.tables for name in table.quantities if name != RUN)
    found: dict[str, Any] = {}
    for name in names:
        values = np.full((*points.shape, len(points.runs)), np.nan)
        for place, table in zip(points.places, points.tables, strict=True):
            columns = table.quantities
            rows = np.isin(columns[RUN], points.runs) if name in columns else np.zeros(0, dtype=bool)
            if rows.any():
                values[place][np.searchsorted(points.runs, columns[RUN][rows])] = columns[name][rows]
        flat = values.reshape(-1, len(points.runs))
        same = all(np.array_equal(row, flat[0], equal_nan=True) for row in flat)
        found[name] = (RUN, flat[0]) if same else ((*points.dims, RUN), values)
    return found


def metric_attributes(info: MetricInfo) -> dict[str, str]:
    """Return unit, words and direction of a metric."""
    return {"units": info.unit, "long_name": info.words, "better": info.direction}


def recorded(table: Trials) -> tuple[Array, Array, dict[str, Float[Array, "methods runs samples n"]], Array]:
    """Return recorded runs, time indices, signals and reference of a table; NaN after the end of a failed run.

    A ValueError says that no run is recorded, or the trials are those of a whole sweep.
    """
    if table.points:
        raise ValueError("the trials are those of a sweep; take the recorded runs of one of its points")
    traces = table.exported_traces()
    if not traces:
        raise ValueError("no run is recorded; `record: {runs: 5, signals: [y, u]}` of the configuration records some")
    runs = np.unique(np.concatenate([each.runs for each in traces.values()]))
    r = next(iter(traces.values())).r
    sizes: dict[str, int] = {}
    for each in traces.values():
        for name, values in each.signals.items():
            sizes[name] = max(sizes.get(name, 0), values.shape[2])
    signals = {name: np.full((len(table.methods), len(runs), len(r), n), np.nan) for name, n in sizes.items()}
    for method, trace in traces.items():
        rows = np.searchsorted(runs, trace.runs)
        for name, values in trace.signals.items():
            signals[name][table.methods.index(method), rows, : values.shape[1], : values.shape[2]] = values
    return runs, np.arange(len(r)), signals, r


def rounded_trials(trials: Trials) -> Trials:
    """Round all numbers to six digits; nothing becomes 0, which a logarithmic axis cannot show."""
    # Points of a sweep share the series of designs that do not depend on it.
    return _rounded(trials, [info.name for info in trials.metrics], {})


def _rounded(trials: Trials, metrics: list[str], known: dict[int, Array]) -> Trials:
    # Columns that stay are shared with the other table, and parts of a column need little memory.
    for each in trials.over_time:
        if id(each.values) not in known:
            known[id(each.values)] = _rounded_column(each.values.ravel()).reshape(each.values.shape)
    return trials.with_numbers(
        columns={**trials.columns, **{name: _rounded_column(trials.columns[name]) for name in metrics}},
        over_time=[each._replace(values=known[id(each.values)]) for each in trials.over_time],
        quantities={
            name: column if name == RUN else _rounded_column(column) for name, column in trials.quantities.items()
        },
        traces={method: _rounded_traces(traces) for method, traces in trials.traces.items()},
        points=tuple(_rounded(point, metrics, known) for point in trials.points),
    )


def _rounded_column(values: Array) -> Array:
    parts = [rounded(values[first : first + ROWS]) for first in range(0, len(values), ROWS)]
    return np.concatenate(parts) if parts else values


def _rounded_traces(traces: Traces) -> Traces:
    signals = {signal: rounded(values) for signal, values in traces.signals.items()}
    return traces._replace(signals=signals, r=rounded(traces.r))
