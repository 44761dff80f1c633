"""Lost runs in the tables of the primary metric: the cells of their column, and what it means in words."""

from __future__ import annotations

from rmpc_bench.analysis.lost_runs import lost_runs
from rmpc_bench.analysis.number_text import interval_text
from rmpc_bench.report.cells import MetricTable


def lost_cells(table: MetricTable) -> list[str]:
    """Return the share of lost runs of every method with its interval, such as "2 % [0.8, 5.0]", for a column.

    There is none where no factor is given or the metric is not the primary one.
    """
    if not shows_lost(table):
        return []
    rows = lost_runs(table.trials).to_dict("records")
    shares = {row["method"]: (row["lost_pct"], row["lost_low"], row["lost_high"]) for row in rows}
    return [interval_text(*shares[line.method], unit="%", sign=False) for line in table.lines]


def shows_lost(table: MetricTable) -> bool:
    """Whether the table of a metric has a column of lost runs."""
    return table.trials.lost is not None and table.info == table.trials.primary_info
