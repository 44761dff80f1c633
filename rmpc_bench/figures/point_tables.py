"""The rows of a metric at the points that a figure shows, computed once for picture and caption."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from rmpc_bench.analysis.shown_numbers import Estimate

if TYPE_CHECKING:
    from rmpc_bench.analysis.comparison import Levels
    from rmpc_bench.analysis.result_rows import Form, ResultRow, ResultTable
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.types import MetricInfo

MOST_POINTS = 6
"""Points below each other that a reader can still compare."""
_tables: WeakKeyDictionary[Trials, dict[tuple[MetricInfo, Levels], ResultTable]] = WeakKeyDictionary()
"""Table of trials -> metric and levels -> rows; an entry ends with its table."""


def tables_of(results: Trials, points: Sequence[Trials], info: MetricInfo) -> list[ResultTable]:
    """Collect the rows of a metric at points of the results, with the levels of intervals that all results have."""
    from rmpc_bench.analysis.comparison import comparisons, levels
    from rmpc_bench.analysis.result_rows import result_table
    from rmpc_bench.analysis.statistics import summary

    of, found = levels(results), []
    for point in points:
        known = _tables.setdefault(point, {})
        if (info, of) not in known:
            primary = point.primary or point.metrics[0].name
            one = point.with_numbers(point.frame, metrics=(info,), primary=primary)
            known[info, of] = result_table(one, summary(one), comparisons(one, of), info)
        found.append(known[info, of])
    return found


def common_form(tables: Sequence[ResultTable]) -> Form:
    """Find what compares the rows of all tables; shares of the runs where they differ, as these always exist."""
    forms = {table.form for table in tables} - {"alone"}
    return forms.pop() if len(forms) == 1 else "share" if forms else "alone"


def shown_change(row: ResultRow, form: Form) -> Estimate:
    """Return the change of a row in the form that all rows of a figure have; a ratio is relative to 1."""
    if form == "share":
        return Estimate(*(each / 100 for each in row.superiority))
    return Estimate(*(1 + each / 100 for each in row.change)) if form == "ratio" else row.change


def row_of(table: ResultTable, method: str) -> ResultRow | None:
    """Return the row of a method; None where the point does not have it."""
    return next((row for row in table.rows if row.method == method), None)


def first_points(points: Sequence[Trials]) -> tuple[Sequence[Trials], str]:
    """Return as many points as a figure shows below each other, and say where there are more."""
    more = len(points) > MOST_POINTS
    return points[:MOST_POINTS], f" at the first {MOST_POINTS} of {len(points)} points" if more else ""


def shown_rows(table: ResultTable, first: ResultTable, order: Sequence[str] | None) -> list[ResultRow]:
    """Return the rows of a point in the order of the figure, which is that of the first point."""
    from rmpc_bench.analysis.result_rows import NOT_COMPUTED

    found = []
    for name in order or [row.method for row in first.ordered]:
        row, named = row_of(table, name), row_of(first, name)
        if row is None and named is not None:
            row = named._replace(n=0, mean=Estimate(), quantiles=(), word=NOT_COMPUTED, compared={})
        found += [] if row is None else [row]
    return found
