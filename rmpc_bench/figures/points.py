"""Points of a sweep that a figure shows: their selection, their titles, and the rows of a metric at each of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.analysis.shown_numbers import Estimate
from rmpc_bench.figures.labels import metric_of, short_title
from rmpc_bench.types import DesignError
from rmpc_bench.types.figure import PointValues, SweepFigure
from rmpc_bench.types.result_layout import texts_of
from rmpc_bench.types.sweep_points import lies_at, no_such_point

if TYPE_CHECKING:
    from rmpc_bench.analysis.comparison import Levels
    from rmpc_bench.analysis.result_rows import Form, ResultRow, ResultTable
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.types import MetricInfo


def points_at(trials: Trials, at: Sequence[PointValues] | None) -> Sequence[Trials]:
    """Select, once each, the points that have the values by path of an entry of `at`; all points if it is not given.

    Without a sweep it is the whole table.  Raises a DesignError when `at` names no point.
    """
    if at is None:
        return trials.each
    points: list[Trials] = []
    for values in at:
        points += [point for point in _having(trials, values) if point not in points]
    return points


def point_at(trials: Trials, at: PointValues | None) -> tuple[Trials, str]:
    """Return the first point that has the given values by path, or the first one of all, and its title.

    The title is empty where there is no sweep.  Raises a DesignError when `at` names no point.
    """
    points = trials.each if at is None else _having(trials, at)
    of_several = f" (first of {len(points)} points)" if len(points) > 1 else ""
    return points[0], short_title(points[0]) + of_several


def _having(trials: Trials, values: PointValues) -> Sequence[Trials]:
    texts = texts_of(values)
    if message := no_such_point([point.point for point in trials.each], texts):
        raise DesignError(message, "at")
    return [point for point in trials.each if lies_at(point.point, texts)]


MOST_POINTS = 6  # points below each other that a reader can still compare
_tables: WeakKeyDictionary[Trials, dict[tuple[MetricInfo, Levels], ResultTable]] = WeakKeyDictionary()
"""Table of trials -> metric and levels -> rows; an entry ends with its table."""


def tables_of(results: Trials, points: Sequence[Trials], info: MetricInfo) -> list[ResultTable]:
    """Collect the rows of a metric at points of the results, with the levels of intervals that all results have."""
    from rmpc_bench.analysis.comparison import comparisons, levels
    from rmpc_bench.analysis.result_rows import in_one_form, result_table
    from rmpc_bench.analysis.statistics import summary

    of, found = levels(results), []
    for point in points:
        known = _tables.setdefault(point, {})
        if (info, of) not in known:
            primary = point.primary or point.metrics[0].name
            one = point.with_numbers(metrics=(info,), primary=primary)
            known[info, of] = result_table(one, summary(one), comparisons(one, of), info)
        found.append(known[info, of])
    return in_one_form(found)


def common_form(tables: Sequence[ResultTable]) -> Form:
    """Return what compares the rows of tables in one form."""
    return next((table.form for table in tables if table.form != "alone"), "alone")


def shown_change(row: ResultRow, form: Form) -> Estimate:
    """Return the change of a row in the form that all rows of a figure have; a ratio is relative to 1."""
    if form == "share":
        return Estimate(*(each / 100 for each in row.superiority))
    return Estimate(*(1 + each / 100 for each in row.change)) if form == "ratio" else row.change


def first_tables(figure: SweepFigure, metric: str | None, results: Trials) -> tuple[list[ResultTable], str]:
    """Collect the rows of as many points as stand below each other in a figure, and say where there are more."""
    figure.require(layout_of(results))
    points = points_at(results, figure.at)
    more = len(points) > MOST_POINTS
    words = f" at the first {MOST_POINTS} of {len(points)} points" if more else ""
    return tables_of(results, points[:MOST_POINTS], metric_of(results, metric)), words


def shown_rows(table: ResultTable, first: ResultTable, order: Sequence[str] | None) -> list[ResultRow]:
    """Return the rows of a point in the order of the figure, which is that of the first point."""
    from rmpc_bench.analysis.result_rows import NOT_COMPUTED

    found = []
    for name in order or [row.method for row in first.ordered]:
        row, named = table.row_of(name), first.row_of(name)
        if row is None and named is not None:
            row = named._replace(n=0, mean=Estimate(), quantiles=(), word=NOT_COMPUTED, compared={})
        found += [] if row is None else [row]
    return found
