"""Tables as CSV files: the bytes of pandas in less than half of its time, and numbers that every CPU writes alike.

See `rmpc_bench.analysis.rounding` for the rules of the tables for version control; trials.csv keeps full precision.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rmpc_bench.analysis.rounding import NEGLIGIBLE, rounded
from rmpc_bench.analysis.runs import RunNotes
from rmpc_bench.analysis.statistics import NUMBERS
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.replaced_file import replaced
from rmpc_bench.types import Array

ROWS = 20_000  # rows that are texts at the same time


def write_csv(frame: pd.DataFrame, path: Path) -> None:
    """Write a table so that equal tables give equal bytes and every float reads back as itself.

    Floats are their shortest repr, inf where an event did not occur, empty for missing.  The index is left out.
    """
    with replaced(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        file.writelines(csv_lines(frame))


def csv_lines(frame: pd.DataFrame) -> Iterator[str]:
    """Yield a table without its index as blocks of lines, the names of the columns first."""
    names = [_quoted(str(name)) for name in frame.columns]
    if len(names) < 2:
        # An empty field that stands alone has quotes.
        yield frame.to_csv(index=False, lineterminator="\n")
        return
    yield ",".join(names) + "\n"
    # Floats and whole numbers stay as they are, all others are objects.
    series = [frame.iloc[:, place] for place in range(len(names))]
    are_numbers = [isinstance(each.dtype, np.dtype) and each.dtype.kind in "fiu" for each in series]
    columns = [np.asarray(each, None if known else object) for each, known in zip(series, are_numbers, strict=True)]
    for first in range(0, len(frame), ROWS):
        texts = [_texts(column[first : first + ROWS]) for column in columns]
        yield "\n".join(map(",".join, zip(*texts, strict=True))) + "\n"


def _texts(values: Array) -> Iterable[str]:
    if values.dtype.kind in "iu":
        return map(str, values.tolist())
    if values.dtype.kind == "f":
        if values.dtype.itemsize < 8:
            return ["" if np.isnan(value) else str(value) for value in values]
        missing = np.isnan(values)
        texts = map(repr, values.tolist())
        return ["" if gone else text for gone, text in zip(missing, texts, strict=True)] if missing.any() else texts
    quoted, unknown = cache(_quoted), pd.NA
    return ["" if each is None or each is unknown or each != each else quoted(str(each)) for each in values.tolist()]


def _quoted(text: str) -> str:
    """Put a field in quotes where a reader would not find its end."""
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in ',"\r\n') else text


def trials_csv(trials: Trials, path: Path) -> None:
    """Write the table of trials with the sweep columns, `method, run, status` and one column per metric.

    Where a component may hold failed steps, `held_steps` follows the status.  Where a controller optimises and goes on
    after a failed step, `failed_steps` and `worst_step` follow, the worst status of the steps of the run.
    """

    def known() -> Iterator[tuple[int, RunNotes | None]]:
        for table in trials.each:
            for method, run in zip(table.frame["method"], table.frame["run"], strict=True):
                yield run, table.notes.get(method)

    steps: dict[str, list[Any]] = {}
    if any(each.holds for table in trials.each for each in table.notes.values()):
        steps["held_steps"] = [each.held.get(run, 0) if each else 0 for run, each in known()]
    if any(each.optimises for table in trials.each for each in table.notes.values()):
        steps["failed_steps"] = [each.n_failed_of(run) if each else 0 for run, each in known()]
        steps["worst_step"] = [each.worst_step_of(run) if each else "ok" for run, each in known()]
    columns = [*trials.paths, "method", "run", "status", *steps, *(info.name for info in trials.metrics)]
    write_csv(trials.frame.assign(**steps)[columns], path)


MIDDLE = ["median", "q25", "q75"]
CHANGES = ["change_pct", "ci_low", "ci_high", "geometric_pct", "geometric_low", "geometric_high"]
CHANGES += ["mean_pct", "mean_low", "mean_high"]
SHARES = ["superiority", "ci_level", "superiority_low", "superiority_high", "failed_low", "failed_high"]
SHARES += ["far_worse_upper", "baseline_far_worse_upper"]
DIFFERENCES = ["difference", "difference_low", "difference_high"]
UNRELIABLE = 1e-12  # digits of a small metric that may be rounding errors of the numbers whose difference it is


def summary_table(described: pd.DataFrame) -> pd.DataFrame:
    """Return the content of summary.csv, from `Summary.described`; numbers are rounded, counts and texts are exact.

    The scale of a row is its largest quartile, that of a metric the largest quartile of all rows of the metric.
    Minimum and maximum do not count, as those of a single run may be enormous.  Where the scale of a row is below
    `NEGLIGIBLE` of that of its metric, those of its numbers that are, too, are written as 0.  A row above it keeps its
    small numbers, such as the error of its mean.  No digit is kept below `NEGLIGIBLE` of the scale of the row or below
    `UNRELIABLE` of that of the metric.
    """
    table = described.drop(columns="did_not_occur")
    numbers = table[NUMBERS].to_numpy(dtype=float)
    sizes = np.abs(table[MIDDLE].to_numpy(dtype=float))
    of_row = np.max(np.where(np.isfinite(sizes), sizes, 0.0), axis=1, initial=0.0)[:, None]
    groups = pd.Series(of_row[:, 0]).groupby(table["metric"].to_numpy())
    of_metric = groups.transform("max").to_numpy(dtype=float)[:, None]
    found = rounded(numbers, np.maximum(of_row, UNRELIABLE / NEGLIGIBLE * of_metric))
    smallest = NEGLIGIBLE * of_metric
    table[NUMBERS] = np.where((of_row < smallest) & (np.abs(numbers) < smallest), 0.0, found)
    return table


def comparisons_table(compared: pd.DataFrame) -> pd.DataFrame:
    """Return the content of comparisons.csv, from `Summary.compared`; counts and texts are exact."""
    table = compared.copy()
    # Beside 100 per cent and 1; differences are rounded beside the numbers that they were computed from already.
    for names, scale in ((CHANGES, 100.0), (SHARES, 1.0), (DIFFERENCES, 0.0)):
        table[names] = rounded(table[names].to_numpy(dtype=float), scale)
    return table
