"""The statistics of a table of trials, as the tables of Markdown and LaTeX need them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import pandas as pd

from rmpc_bench.analysis.trials import Trials


class PointSummary(NamedTuple):
    """The statistics of one table of trials."""

    trials: Trials
    described: pd.DataFrame
    """One row per method and metric, see `statistics.summary`."""
    compared: pd.DataFrame
    """One row per comparison with the baseline, see `comparison.comparisons`."""


class Points(Protocol):
    """Statistics point by point."""

    @property
    def points(self) -> Sequence[PointSummary]:
        """The points of a sweep; the whole table where there is none."""

    @property
    def pooled(self) -> PointSummary | None:
        """The runs of all points together, where the points are many plants with the same methods."""
