"""The packed rows beside those of a new computation, and the tables that follow from them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.received.arrays import check_width
from rmpc_bench.types import Array

TOLERANCE = 1e-9
"""Largest relative difference of equal values on two machines."""
_TEXT = ("method", "metric", "status", "quantity", "component", "phase", "worst_step")
_DIGITS = 5.1e-6
"""Largest relative difference of two numbers with equal six digits, one of them unrounded."""
_COUNTS = ("run", "k", "n", "calls", "held_steps", "failed_steps")


def read_rows(path: Path) -> pd.DataFrame:
    """Read a table: texts and the columns of a sweep, before `method`, as they are, every float as it was written."""
    check_width(path)
    table = pd.read_csv(path, dtype=str, keep_default_na=False, encoding="utf-8")
    texts = {*_TEXT, *table.columns[: list(table.columns).index("method")]}
    kinds = {name: np.int64 if name in _COUNTS else np.float64 for name in table if name not in texts}
    # Python reads every float as it was written; the readers of pandas differ between its versions.
    numbers = {name: np.array([float(text or "nan") for text in table[name]]) for name in kinds}
    return table.assign(**{name: values.astype(kinds[name]) for name, values in numbers.items()})


def with_rows(trials: Trials, rows: pd.DataFrame) -> Trials:
    """Return a table of trials with other rows, such as the packed ones; methods without a row are left out."""
    if not trials.points:
        return _with_rows(trials, rows)
    points = tuple(_with_rows(table, rows[_at(rows, table.point)]) for table in trials.points)
    here = pd.concat([rows[_at(rows, table.point)] for table in trials.points])
    columns = [name for name in trials.frame.columns if name in here.columns]
    return replace(trials, points=points, frame=here[columns].reset_index(drop=True))


def _at(rows: pd.DataFrame, point: Mapping[str, str]) -> Array:
    found: Array = np.ones(len(rows), dtype=bool)
    for path, value in point.items():
        found &= (rows[path] == value).to_numpy() if path in rows else False
    return found


def _with_rows(table: Trials, rows: pd.DataFrame) -> Trials:
    columns = [name for name in table.frame.columns if name in rows.columns]
    present = {*rows["method"]}
    methods = tuple(name for name in table.methods if name in present) if len(table.frame) else table.methods
    metrics = tuple(info for info in table.metrics if info.name in rows.columns)
    order = {name: number for number, name in enumerate(methods)}
    frame = rows[rows["method"].isin(methods)][columns]
    frame = frame.iloc[np.lexsort((frame["run"], frame["method"].map(order)))].reset_index(drop=True)
    return replace(table, methods=methods, metrics=metrics, frame=frame)


def without_moved(packed: Trials, here: Trials, ends: Mapping[str, float]) -> tuple[Trials, dict[str, int]]:
    """Replace the values of threshold metrics that have moved by one sample by those of the new computation.

    Such a metric is a time at which a threshold is crossed, or a count of samples: a difference in the last digits of a
    trajectory moves it by one sample.  `ends` is the length of a run at each point; the values are counted by metric.
    """
    moved: dict[str, int] = {}
    others = {table.title: table for table in here.each}
    tables = tuple(
        _without_moved(table, others[table.title], ends.get(table.title, math.inf), moved)
        if table.title in others
        else table
        for table in packed.each
    )
    return (replace(packed, points=tables) if packed.points else tables[0]), moved


def _without_moved(packed: Trials, here: Trials, end: float, moved: dict[str, int]) -> Trials:
    key = ["method", "run"]
    other = packed.frame[key].merge(here.frame, on=key, how="left")
    frame = packed.frame.copy()
    for info in packed.metrics:
        a = frame[info.name].to_numpy(dtype=float)
        b = other[info.name].to_numpy(dtype=float) if info.name in other else np.full(len(a), math.nan)
        step = _sample(info.may_not_occur, a, b, packed.Ts)
        if step is None:
            continue
        # What did not occur may have occurred at the last sample.
        late = [np.where(np.isposinf(each), end, each) for each in (a, b)]
        apart = np.abs(late[0] - late[1])
        close = (a != b) & (apart <= step * (1 + TOLERANCE)) & (apart > TOLERANCE * np.abs(late[0]))
        close |= (a != b) & (np.isinf(a) != np.isinf(b)) & (apart <= step * (1 + TOLERANCE))
        if close.any():
            moved[info.name] = moved.get(info.name, 0) + int(close.sum())
            frame[info.name] = np.where(close, b, a)
    return replace(packed, frame=frame)


def _sample(may_not_occur: bool, a: Array, b: Array, Ts: float) -> float | None:
    """Return by how much one sample changes a metric; None for a metric without a threshold."""
    if may_not_occur:
        return Ts or 1.0
    finite = np.concatenate([a[np.isfinite(a)], b[np.isfinite(b)]])
    return 1.0 if len(finite) and np.all(finite == np.rint(finite)) else None


def rows_against_summary(rows: pd.DataFrame, summary: pd.DataFrame) -> list[str]:
    """Compute the numbers of summary.csv again from the packed rows, and name those that do not follow."""
    if len(rows) and not len(summary):
        return ["summary.csv has no line"]
    paths = [name for name in summary.columns[: list(summary.columns).index("method")] if name in rows]
    return [
        f"{' '.join(str(line[name]) for name in [*paths, 'method', 'metric'])} {what}: "
        f"summary.csv {stated:g}, its rows {found:.6g}"
        for _, line in summary.iterrows()
        for what, stated, found in _against_rows(rows, line, paths)
    ]


def _against_rows(rows: pd.DataFrame, line: pd.Series, paths: Sequence[str]) -> Iterator[tuple[str, float, float]]:
    """Yield what differs in a line of summary.csv: what it is, the stated number, and that of the rows."""
    chosen = rows["method"] == line["method"]
    for path in paths:
        chosen &= rows[path] == line[path]
    if line["metric"] not in rows:
        yield "column", 1.0, 0.0
        return
    column = rows.loc[chosen, line["metric"]].dropna().to_numpy(dtype=float)
    finite = column[np.isfinite(column)]
    scale = float(np.max(np.abs(finite), initial=0.0))
    computed = {"n": float(len(column)), "n_failed": float(chosen.sum() - len(column))}
    if len(column):
        with np.errstate(invalid="ignore"):
            numbers = {"mean": np.mean(column), "median": np.median(column), "min": column.min(), "max": column.max()}
        computed |= {name: float(value) for name, value in numbers.items()}
    for what, found in computed.items():
        stated = float(line[what])
        same = stated == found or abs(stated - found) <= _DIGITS * abs(found) + TOLERANCE * scale
        if not (math.isnan(stated) or math.isnan(found) or same):
            yield what, stated, found
