"""Lost runs at every point of a sweep: lost.csv."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from rmpc_bench.analysis.lost_runs import lost_runs
from rmpc_bench.analysis.rounding import rounded
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.summary import stacked

_SHARES = ["lost_pct", "lost_low", "lost_high"]


@dataclass(frozen=True, eq=False)
class LostTable:
    """Lost runs at every point of a sweep.

    Parameters
    ----------
    points : table of each point and its lost runs, see `rmpc_bench.analysis.lost_runs`
    """

    points: Sequence[tuple[Trials, pd.DataFrame]]

    @property
    def frame(self) -> pd.DataFrame:
        """Content of lost.csv: sweep columns, then one row per method; empty where no factor is given."""
        table = stacked(self.points)
        table[_SHARES] = rounded(table[_SHARES].to_numpy(dtype=float), 100.0)
        return table

    def to_markdown(self) -> str:
        """Return nothing: the shares stand in the tables of the primary metric."""
        return ""


def lost_table(trials: Trials) -> LostTable:
    """Count the lost runs at every point of a sweep."""
    return LostTable([(point, lost_runs(point)) for point in trials.each])
