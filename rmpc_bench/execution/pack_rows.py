"""The packed rows beside those of a new computation, and the tables that follow from them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.received.arrays import check_width
from rmpc_bench.types import Array, Status

TOLERANCE = 1e-9
"""Largest relative difference of equal values on two machines."""
_TEXT = ("method", "metric", "status", "quantity", "component", "phase", "worst_step")
_DIGITS = 5.1e-6
"""Largest relative difference of two numbers with equal six digits, one of them unrounded."""
_COUNTS = ("run", "k", "n", "calls", "held_steps", "failed_steps")


def read_rows(path: Path, most: int = 1_000_000) -> pd.DataFrame:
    """Read a table: texts and the columns of a sweep, before `method`, as they are, every float as it was written."""
    check_width(path)
    table = pd.read_csv(path, dtype=str, keep_default_na=False, encoding="utf-8", nrows=most + 1)
    if len(table) > most:
        raise ValueError(f"has more than {most} rows")
    texts = {*_TEXT, *table.columns[: list(table.columns).index("method")]}
    kinds = {name: np.int64 if name in _COUNTS else np.float64 for name in table if name not in texts}
    # Python reads every float as it was written; the readers of pandas differ between its versions.
    numbers = {name: np.array([float(text or "nan") for text in table[name]]) for name in kinds}
    return table.assign(**{name: values.astype(kinds[name]) for name, values in numbers.items()})


def wrong_row(rows: pd.DataFrame, points: Sequence[tuple[Mapping[str, str], Collection[str]]], n_runs: int) -> str:
    """Name the first row of no trial of these points with their methods, or of one that has a row; empty for none."""
    paths = [*dict.fromkeys(path for point, _ in points for path in point)]
    if [*rows.columns[: len(paths) + 1]] != [*paths, "method"]:
        return f"the first columns must be {', '.join([*paths, 'method'])}"
    known = np.zeros(len(rows), dtype=bool)
    for point, methods in points:
        known |= _at(rows, point) & rows["method"].isin(methods).to_numpy()
    known &= rows["run"].between(0, n_runs - 1).to_numpy() & rows["status"].isin([each.word for each in Status])
    twice = rows.duplicated([*paths, "method", "run"]).to_numpy()
    for number in np.flatnonzero(~known | twice)[:1]:
        return f"row {number + 1}: " + ("is given twice" if known[number] else "is of no trial of the configuration")
    return ""


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


def rows_against_summary(rows: pd.DataFrame, summary: pd.DataFrame) -> list[str]:
    """Compute the numbers of summary.csv again from the packed rows, and name those that do not follow."""
    if len(rows) and not len(summary):
        return ["summary.csv has no line"]
    paths = [name for name in summary.columns[: list(summary.columns).index("method")] if name in rows]
    rows = _common(rows, paths)
    return [
        f"{' '.join(str(line[name]) for name in [*paths, 'method', 'metric'])} {what}: "
        f"summary.csv {stated:g}, its rows {found:.6g}"
        for _, line in summary.iterrows()
        for what, stated, found in _against_rows(rows, line, paths)
    ]


def _common(rows: pd.DataFrame, paths: Sequence[str]) -> pd.DataFrame:
    """Leave out the runs that not every method of a point has; summary.csv rests on the others."""
    n_methods = rows.groupby(paths)["method"].transform("nunique") if paths else rows["method"].nunique()
    return rows[rows.groupby([*paths, "run"])["method"].transform("nunique") == n_methods]


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
        # The mean of what may not occur is not stated.
        same = stated == found or (math.isnan(stated) and (what == "mean" or not math.isfinite(found)))
        same |= math.isfinite(found) and abs(stated - found) <= _DIGITS * abs(found) + TOLERANCE * scale
        if not same:
            yield what, stated, found
