"""The comparison of the methods in one metric at one point, computed once for all pictures and captions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeAlias
from weakref import WeakKeyDictionary

if TYPE_CHECKING:
    from rmpc_bench.analysis.comparison import Levels
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.types import MetricInfo

Rows: TypeAlias = "Mapping[str, Mapping[str, Any]]"
_rows: WeakKeyDictionary[Trials, dict[tuple[MetricInfo, Levels | None], Rows]] = WeakKeyDictionary()
"""Table -> metric and levels -> rows; an entry ends with its table."""


def compared_rows(point: Trials, info: MetricInfo, of: Levels | None = None) -> Rows:
    """Compare every method with the baseline, as `rmpc_bench.analysis.comparison.comparisons` does for the tables.

    Methods without a run, as in an interrupted sweep, have no row.  Levels of intervals are those of this table alone
    unless `of` is given.
    """
    from rmpc_bench.analysis.comparison import comparisons

    known = _rows.setdefault(point, {})
    if (info, of) not in known:
        primary = point.primary or point.metrics[0].name
        table = comparisons(point.with_numbers(point.frame, metrics=(info,), primary=primary), of)
        known[info, of] = {
            row["method"]: {str(key): value for key, value in row.items()} for row in table.to_dict("records")
        }
    return known[info, of]
