"""What drives the differences between methods, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from rmpc_bench.analysis.driver_text import share_text
from rmpc_bench.analysis.drivers import FEWEST, REST, drivers
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.summary import stacked
from rmpc_bench.report.tables import markdown_table
from rmpc_bench.types.texts import inert_markdown

MOST_POINTS = 12
"""Points of a sweep whose drivers stand in tables/drivers.md; drivers.csv has all."""
EXPLANATION = (
    "Share: what the adjusted R^2 of a quadratic response surface loses without all terms of a quantity. It is the "
    f"total effect of the quantity, interactions included, so that shares need not sum to 100 %. Brackets: interval "
    f"from a bootstrap of whole runs. No share (-): below {FEWEST} runs, an interval that contains 0 and reaches "
    "beyond 5 %, or a share of about 0 of a quantity that is correlated with another one."
)


@dataclass(frozen=True, eq=False)
class DriversTable:
    """Drivers of the primary metric.

    Parameters
    ----------
    points : table of each point and its drivers, see `rmpc_bench.analysis.drivers`
    """

    points: Sequence[tuple[Trials, pd.DataFrame]]

    @property
    def frame(self) -> pd.DataFrame:
        """Content of drivers.csv: sweep columns, then one row per method and quantity."""
        return stacked(list(self.points))

    def to_markdown(self) -> str:
        """Return a table for every point; empty where nothing is uncertain."""
        parts = []
        for trials, frame in self.points[:MOST_POINTS]:
            if len(frame):
                parts += [f"# {trials.title}"] * bool(trials.title) + [markdown_table(_columns(frame))]
        left = sum(len(frame) > 0 for _, frame in self.points[MOST_POINTS:])
        parts += [f"{left} more point{'s' * (left > 1)} of the sweep: drivers.csv"] if left else []
        parts += [EXPLANATION] if parts else []
        return inert_markdown("\n\n".join(parts)) + "\n" if parts else ""

    def __str__(self) -> str:
        return self.to_markdown()


def drivers_table(trials: Trials) -> DriversTable:
    """Compute the drivers of the primary metric at every point of a sweep."""
    return DriversTable([(point, drivers(point)) for point in trials.each])


def _columns(frame: pd.DataFrame) -> dict[str, list[str]]:
    """Return head -> cells, a row per method."""
    shares = frame[frame["response"] != "failed"]
    columns: dict[str, list[str]] = {}
    for method, rows in shares.groupby("method", sort=False):
        records = rows.to_dict("records")
        # Heads of two words cannot be names of quantities.
        cells = {"variance of": f"{method}: {records[0]['response']} of {records[0]['metric']}"}
        cells |= {"not explained" if row["quantity"] == REST else row["quantity"]: share_text(row) for row in records}
        cells |= {"number of runs": str(records[0]["n"]), "failed runs left out": str(records[0]["n_failed"])}
        for head, cell in cells.items():
            columns.setdefault(head, []).append(cell)
    return columns
