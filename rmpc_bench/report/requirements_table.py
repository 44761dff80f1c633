"""Requirements and the runs that meet them, as a table and as sentences."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from rmpc_bench.analysis.requirements import pass_rates
from rmpc_bench.analysis.rounding import rounded
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.requirement_cells import REQUIREMENTS_NOTE, requirement_columns
from rmpc_bench.report.requirement_cells import difference as _difference
from rmpc_bench.report.requirement_cells import share as _share
from rmpc_bench.report.summary import stacked
from rmpc_bench.report.tables import markdown_table
from rmpc_bench.types.texts import inert_markdown

_SHARES = ["pass_pct", "pass_low", "pass_high", "miss_upper", "difference_pct", "difference_low", "difference_high"]

MOST_NAMED = 4
"""Methods that the screen names."""


@dataclass(frozen=True, eq=False)
class RequirementsTable:
    """Pass rates at every point of a sweep.

    Parameters
    ----------
    trials : the table of trials
    points : table of each point and its pass rates, see `rmpc_bench.analysis.requirements`
    """

    trials: Trials
    points: Sequence[tuple[Trials, pd.DataFrame]]

    @property
    def frame(self) -> pd.DataFrame:
        """Content of requirements.csv: sweep columns, then one row per requirement and method."""
        table = stacked(list(self.points))
        table[_SHARES] = rounded(table[_SHARES].to_numpy(dtype=float), 100.0)
        return table

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence per requirement and method that can be quoted as it stands."""
        return tuple(
            (f"{trials.title}: " if trials.title else "") + _sentence(trials, row)
            for trials, frame in self.points
            for row in frame.to_dict("records")
        )

    @property
    def gist(self) -> str:
        """In how many runs each method meets the first requirement; empty without one, or with several points."""
        known = [frame for _, frame in self.points if len(frame)]
        if len(known) != 1:
            return "requirements: tables/requirements.md" if known else ""
        first = known[0]["requirement"].iloc[0]
        rows = known[0][known[0]["requirement"] == first].to_dict("records")[:MOST_NAMED]
        others = known[0]["requirement"].nunique() > 1 or len(known[0]) > len(rows)
        met = ", ".join(f"{row['passed']} ({row['method']})" for row in rows)
        return f"{first} in {met} of {rows[0]['n']} runs{': tables/requirements.md' * others}"

    def to_markdown(self) -> str:
        """Return a table per point; empty without requirements."""
        parts = []
        for trials, frame in self.points:
            if len(frame):
                parts += [f"# {trials.title}"] * bool(trials.title)
                parts.append(markdown_table(requirement_columns(trials, frame)))
        parts += [REQUIREMENTS_NOTE] if parts else []
        return inert_markdown("\n\n".join(parts)) + "\n" if parts else ""

    def __str__(self) -> str:
        return "\n".join(self.sentences)


def requirements_table(trials: Trials) -> RequirementsTable:
    """Count the runs that meet each requirement at every point of a sweep."""
    return RequirementsTable(trials, [(point, pass_rates(point)) for point in trials.each])


def _sentence(trials: Trials, row: Mapping[Hashable, Any]) -> str:
    failed = f", {row['n_failed']} of them failed" if row["n_failed"] else ""
    start = f"{row['method']} meets {row['requirement']} in {row['passed']} of {row['n']} runs ({_share(row)}{failed})"
    difference = _difference(row)
    if difference == "-":
        return f"{start}."
    return f"{start}: {difference} against {trials.baseline} ({row['n_pairs']} paired runs)."
