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
    """Compare every method with the baseline, as the tables do.

    Parameters
    ----------
    point : a table without points of a sweep
    info : the metric
    of : levels of the intervals of the experiment; of this table alone if not given

    Returns
    -------
    method -> row of `rmpc_bench.analysis.comparison.comparisons`; without the baseline, and without a method that has
    no run, as at some points of an interrupted sweep
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
