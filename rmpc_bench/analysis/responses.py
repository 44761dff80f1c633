"""What is explained by the uncertain quantities: one number per run and method, from the primary metric.

For a method it is the log ratio to the baseline, for the baseline itself the log of the metric.  A metric without
logarithm has differences, or its values for the baseline.  Where an event does not occur in every run, it is the
indicator of the runs in which it does not, minus that of the baseline.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import Interval, student, wilson
from rmpc_bench.analysis.pairs import distance_from_best, is_signed
from rmpc_bench.analysis.rounding import NEGLIGIBLE
from rmpc_bench.analysis.superiority import shares_interval
from rmpc_bench.types import Array, MetricInfo

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

LOG_RATIO, LOG = "log ratio", "log"
DIFFERENCE, VALUE = "difference", "value"
SHARE_DIFFERENCE, SHARE = "difference in not occurring", "not occurring"


class Response(NamedTuple):
    """The response of one method."""

    method: str
    kind: str
    values: Array
    """(n_runs,) in the order of `Trials.runs`; NaN where the method or its baseline failed."""

    @property
    def known(self) -> Array:
        """(n_runs,) whether a run has a response."""
        return ~np.isnan(self.values)

    @property
    def has_spread(self) -> bool:
        """Whether the response differs between runs by more than rounding."""
        found = self.values[self.known]
        return len(found) > 1 and float(np.ptp(found)) > NEGLIGIBLE * max(1.0, float(np.abs(found).max()))

    def shown(self, value: float) -> float:
        """Return a mean response in the unit in which it is written: per cent, or the unit of the metric."""
        if self.kind == LOG_RATIO:
            return 100 * math.expm1(value)
        if self.kind == LOG:
            return math.exp(value)
        return 100 * value if self.kind in (SHARE, SHARE_DIFFERENCE) else value

    def interval(self, values: Array, level: float) -> Interval:
        """Interval of the mean of some of the responses: of a share where they count runs, else Student's."""
        if self.kind == SHARE:
            return wilson(int(values.sum()), len(values), level)
        if self.kind == SHARE_DIFFERENCE:
            return shares_interval(int((values > 0).sum()), int((values < 0).sum()), len(values), level)
        return student(values, level)

    def unit(self, info: MetricInfo) -> str:
        """Unit of `shown`."""
        if self.kind == SHARE_DIFFERENCE:
            return "percentage points"
        return info.unit if self.kind in (LOG, DIFFERENCE, VALUE) else "%"


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def response_of(trials: Trials, method: str, info: MetricInfo) -> Response:
    """Return the response of a method.

    Parameters
    ----------
    trials : the table of an experiment without sweep, or of one point
    method : name of the method
    info : the metric
    """
    is_baseline = method == trials.baseline
    a = distance_from_best(trials.column(info.name, method), info.direction)
    b = distance_from_best(trials.column(info.name, trials.baseline), info.direction)
    known = ~(np.isnan(a) | np.isnan(b))
    columns = [column[known] for column in ((a,) if is_baseline else (a, b))]
    if any(np.isinf(column).any() for column in columns):
        kind = SHARE if is_baseline else SHARE_DIFFERENCE
        columns = [np.isinf(column).astype(float) for column in columns]
    elif is_signed(trials, info) or any((column <= 0).any() for column in columns):
        kind = VALUE if is_baseline else DIFFERENCE
    else:
        kind = LOG if is_baseline else LOG_RATIO
        columns = [np.log(column) for column in columns]
    values = np.full(len(a), np.nan)
    values[known] = columns[0] if is_baseline else columns[0] - columns[1]
    return Response(method, kind, values)
