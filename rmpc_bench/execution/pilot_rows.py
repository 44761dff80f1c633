"""Results with as many rows as an experiment will have, from those of its first runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from rmpc_bench.execution.results import Results


def enlarged(results: Results, n_runs: int) -> Results:
    """Repeat the rows of the first runs up to a number of runs, to measure what a report of so many costs."""
    trials = results.stored
    n = max((len(table.runs) for table in trials.each), default=0)
    if not n or n >= n_runs:
        return results

    def repeated(frame: pd.DataFrame) -> pd.DataFrame:
        return _repeated(frame, n, n_runs)

    points = tuple(
        replace(table, frame=_sorted(repeated(table.frame), trials.methods), uncertainty=repeated(table.uncertainty))
        for table in trials.points
    )
    frame = _sorted(repeated(trials.frame), trials.methods)
    larger = replace(trials, frame=frame, uncertainty=repeated(trials.uncertainty), points=points)
    return replace(results, stored=larger, uncertainty=repeated(results.uncertainty))


def _repeated(frame: pd.DataFrame, n: int, n_runs: int) -> pd.DataFrame:
    """Put copies of a table with runs 0 to n - 1 below each other, with the next indices of runs."""
    if "run" not in frame:
        return frame
    copies = [frame.assign(run=frame["run"] + i * n) for i in range(math.ceil(n_runs / n))]
    table = pd.concat(copies, ignore_index=True)
    return table[table["run"] < n_runs].reset_index(drop=True)


def _sorted(frame: pd.DataFrame, methods: Sequence[str]) -> pd.DataFrame:
    """Sort rows by point, method and run, as `Trials` needs them."""
    head = list(frame.columns[: list(frame.columns).index("method")])
    order = {name: number for number, name in enumerate(methods)}
    rows = frame.assign(_order=frame["method"].map(order))
    first = {tuple(key): number for number, key in enumerate(frame[head].drop_duplicates().itertuples(index=False))}
    rows["_point"] = [first[tuple(key)] for key in frame[head].itertuples(index=False)] if head else 0
    rows = rows.sort_values(["_point", "_order", "run"], kind="stable")
    return rows.drop(columns=["_order", "_point"]).reset_index(drop=True)
