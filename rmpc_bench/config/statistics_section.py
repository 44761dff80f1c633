"""The section `statistics`: which comparisons are made, and what counts in them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Len, Lt

from rmpc_bench.types import NonNegative

Text = Annotated[str, Len(1)]
DEFAULT_RELEVANT = 0.01
Relevant: Any = Annotated[float, Ge(0), Lt(1)] | dict[str, NonNegative]


@dataclass(frozen=True)
class Statistics:
    """Comparison of the methods; docs/statistics.md explains the numbers.

    A signed metric, for which 0 is best or which has negative values, takes a margin in its unit; without one, none of
    its differences is too small to matter.

    Parameters
    ----------
    primary : metric that has the verdicts; the first one if not given
    baseline : method with which the others are compared; the first one if not given
    confidence : level of all intervals, such as 95%
    relevant : smallest difference that matters: a relative change for all metrics, or a number per metric
    average : averages of the paired runs, the geometric mean of their ratios or the ratio of the means
    requirement : condition on a metric of a run, such as settling_time < 20, or a list of conditions; the share of runs
        that meet it is computed
    lost : factor, such as 10: a run is lost where it failed, or where its primary metric exceeds this factor times that
        of the baseline in the same run; tables have the share of lost runs beside the mean
    ranks : whether the methods are ranked over all points of the sweep by the primary metric, each rank as an interval
    """

    primary: Text | None = None
    baseline: Text | None = None
    confidence: Annotated[float, Gt(0), Lt(1)] = 0.95
    relevant: Relevant = DEFAULT_RELEVANT
    average: Literal["geometric", "mean", "both"] = "both"
    requirement: Text | list[Text] = field(default_factory=list)
    lost: Annotated[float, Gt(1)] | None = None
    ranks: bool = False

    @property
    def requirements(self) -> list[str]:
        """The requirements as a list."""
        return [self.requirement] if isinstance(self.requirement, str) else self.requirement

    @property
    def relevant_change(self) -> float:
        """The smallest relative change that matters in a metric without a margin of its own."""
        return DEFAULT_RELEVANT if isinstance(self.relevant, dict) else self.relevant

    @property
    def margins(self) -> dict[str, float]:
        """Metric -> margin of its own."""
        return self.relevant if isinstance(self.relevant, dict) else {}
