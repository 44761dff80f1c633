"""A table of trials with six digits, from which figures are drawn, so that another CPU draws the same picture."""

from __future__ import annotations

import pandas as pd

from rmpc_bench.analysis.rounding import rounded
from rmpc_bench.analysis.traces import Traces
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array


def rounded_trials(trials: Trials) -> Trials:
    """Round all numbers to six digits; nothing becomes 0, which a logarithmic axis cannot show."""
    metrics = [info.name for info in trials.metrics]
    # Points of a sweep share the series of designs that do not depend on it.
    series: dict[int, pd.DataFrame] = {}
    return _rounded(trials, metrics, series)


def _rounded(trials: Trials, metrics: list[str], series: dict[int, pd.DataFrame]) -> Trials:
    # Columns that stay are shared with the other table, and one column at a time needs little memory.
    columns = {name: rounded(trials.frame[name].to_numpy(dtype=float)) for name in metrics}
    if id(trials.series) not in series:
        values: Array = rounded(trials.series["value"].to_numpy(dtype=float))
        series[id(trials.series)] = trials.series.assign(value=values)
    return trials.with_numbers(
        trials.frame.assign(**columns),
        series=series[id(trials.series)],
        uncertainty=_rounded_quantities(trials.uncertainty),
        traces={method: _rounded_traces(traces) for method, traces in trials.traces.items()},
        points=tuple(_rounded(point, metrics, series) for point in trials.points),
    )


def _rounded_quantities(table: pd.DataFrame) -> pd.DataFrame:
    columns = {name: rounded(table[name].to_numpy(dtype=float)) for name in table.columns if name != "run"}
    return table.assign(**columns)


def _rounded_traces(traces: Traces) -> Traces:
    signals = {signal: rounded(values) for signal, values in traces.signals.items()}
    return traces._replace(signals=signals, r=rounded(traces.r))
