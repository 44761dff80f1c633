"""Tables as CSV files: the bytes of pandas without its import, and numbers that every CPU writes alike.

See `rmpc_bench.analysis.rounding` for the rules of the tables for version control; trials.csv keeps full precision.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from rmpc_bench.analysis.columns import Columns, n_rows
from rmpc_bench.analysis.comparison import ADJUSTED
from rmpc_bench.analysis.rounding import NEGLIGIBLE, rounded
from rmpc_bench.analysis.runs import RunNotes
from rmpc_bench.analysis.statistics import NUMBERS
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.replaced_file import replaced
from rmpc_bench.report.point_tables import rounded_columns
from rmpc_bench.types import Array

ROWS = 20_000  # rows that are texts at the same time


def write_csv(columns: Columns, path: Path) -> None:
    """Write a table so that equal tables give equal bytes and every float reads back as itself.

    Floats are their shortest repr, inf where an event did not occur, empty for missing.
    """
    with replaced(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        file.writelines(csv_lines(columns))


def csv_lines(columns: Columns) -> Iterator[str]:
    """Yield a table as blocks of lines, the names of the columns first."""
    yield ",".join(map(_quoted, columns)) + "\n"
    arrays = [*map(_array, columns.values())]
    for first in range(0, n_rows(columns), ROWS):
        texts = [_texts(array[first : first + ROWS]) for array in arrays]
        if len(texts) == 1:
            # An empty field that stands alone has quotes.
            texts = [[text or '""' for text in texts[0]]]
        yield "\n".join(map(",".join, zip(*texts, strict=True))) + "\n"


def _array(cells: Sequence[object] | Array) -> Array:
    """Return cells as an array: floats and whole numbers stay as they are, all others are objects."""
    found = np.asarray(cells)
    return found if found.dtype.kind in "fiu" else np.asarray(cells, dtype=object)


def _texts(values: Array) -> Iterable[str]:
    if values.dtype.kind in "iu":
        return map(str, values.tolist())
    if values.dtype.kind == "f":
        if values.dtype.itemsize < 8:
            return ["" if np.isnan(value) else str(value) for value in values]
        missing = np.isnan(values)
        texts = map(repr, values.tolist())
        return ["" if gone else text for gone, text in zip(missing, texts, strict=True)] if missing.any() else texts
    quoted = cache(_quoted)
    return ["" if each is None or each != each else quoted(str(each)) for each in values.tolist()]


def _quoted(text: str) -> str:
    """Put a field in quotes where a reader would not find its end."""
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in ',"\r\n') else text


def trials_csv(trials: Trials, path: Path) -> None:
    """Write the table of trials with the sweep columns, `method, run, status` and one column per metric.

    Where the runs were made elsewhere, `run_name` has their original names.  Where a component may hold failed steps,
    `held_steps` follows the status.  Where a controller optimises and goes on after a failed step, `failed_steps` and
    `worst_step` follow, the worst status of the steps of the run.
    """

    def known() -> Iterator[tuple[int, RunNotes | None]]:
        for table in trials.each:
            for method, run in zip(table.columns["method"], table.columns["run"].tolist(), strict=True):
                yield run, table.notes.get(method)

    steps: dict[str, list[Any]] = {}
    if any(each.holds for table in trials.each for each in table.notes.values()):
        steps["held_steps"] = [each.held.get(run, 0) if each else 0 for run, each in known()]
    if any(each.optimises for table in trials.each for each in table.notes.values()):
        steps["failed_steps"] = [each.n_failed_of(run) if each else 0 for run, each in known()]
        steps["worst_step"] = [each.worst_step_of(run) if each else "ok" for run, each in known()]
    original = {"run_name": [trials.run_names[run] for run in trials.columns["run"]]} if trials.run_names else {}
    head = [*trials.paths, "method", "run", *original, "status"]
    columns = {**trials.columns, **steps, **original}
    names = [*head, *steps, *(info.name for info in trials.metrics)]
    write_csv({name: columns[name] for name in names}, path)


MIDDLE = ["median", "q25", "q75"]
CHANGES = ["change_pct", "ci_low", "ci_high", "geometric_pct", "geometric_low", "geometric_high"]
CHANGES += ["mean_pct", "mean_low", "mean_high"]
CHANGES += [name for name in ADJUSTED if name.startswith(("geometric_", "mean_"))]
SHARES = ["superiority", "ci_level", "superiority_low", "superiority_high", "failed_low", "failed_high"]
SHARES += ["far_worse_upper", "baseline_far_worse_upper"]
DIFFERENCES = ["difference", "difference_low", "difference_high"]
DIFFERENCES += [name for name in ADJUSTED if name.startswith("difference_")]
UNRELIABLE = 1e-12  # digits of a small metric that may be rounding errors of the numbers whose difference it is


def summary_table(described: Columns) -> Columns:
    """Return the content of summary.csv, from `Summary.described_columns`; counts and texts are exact.

    The scale of a row is its largest quartile, that of a metric the largest quartile of all rows of the metric.
    Minimum and maximum do not count, as those of a single run may be enormous.  Where the scale of a row is below
    `NEGLIGIBLE` of that of its metric, those of its numbers that are, too, are written as 0.  A row above it keeps its
    small numbers, such as the error of its mean.  No digit is kept below `NEGLIGIBLE` of the scale of the row or below
    `UNRELIABLE` of that of the metric.
    """
    numbers, middle = (np.array([described[name] for name in names], dtype=float).T for names in (NUMBERS, MIDDLE))
    sizes = np.abs(middle)
    of_row = np.max(np.where(np.isfinite(sizes), sizes, 0.0), axis=1, initial=0.0)[:, None]
    largest: dict[str, float] = {}
    for name, size in zip(described["metric"], of_row[:, 0], strict=True):
        largest[name] = max(size, largest.get(name, 0.0))
    of_metric = np.array([largest[name] for name in described["metric"]])[:, None]
    found = rounded(numbers, np.maximum(of_row, UNRELIABLE / NEGLIGIBLE * of_metric))
    smallest = NEGLIGIBLE * of_metric
    found = np.where((of_row < smallest) & (np.abs(numbers) < smallest), 0.0, found)
    columns = {name: cells for name, cells in described.items() if name != "did_not_occur"}
    return columns | dict(zip(NUMBERS, found.T, strict=True))


def comparisons_table(compared: Columns) -> Columns:
    """Return the content of comparisons.csv, from `Summary.compared_columns`; counts and texts are exact."""
    if "adjusted" not in compared["rests_on"]:
        # Where nothing is adjusted the file is that of an earlier version.
        compared = {name: cells for name, cells in compared.items() if name not in ADJUSTED}
    # Beside 100 per cent and 1; differences are rounded beside the numbers that they were computed from already.
    for names, scale in ((CHANGES, 100.0), (SHARES, 1.0), (DIFFERENCES, 0.0)):
        compared = rounded_columns(compared, [name for name in names if name in compared], scale)
    return compared
