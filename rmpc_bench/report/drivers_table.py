"""What drives the differences between methods, as a table, sentences and the line at the end of a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pandas as pd

from rmpc_bench.analysis.driver_text import share_text
from rmpc_bench.analysis.drivers import FEWEST, REST, drivers, inputs
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.driver_sentences import method_sentences
from rmpc_bench.report.summary import stacked
from rmpc_bench.report.tables import markdown_table
from rmpc_bench.report.turning_sentences import turning_sentences
from rmpc_bench.types.texts import inert_markdown

MOST_POINTS = 12
"""Points of a sweep whose drivers stand on the page; drivers.csv has all."""


@dataclass(frozen=True, eq=False)
class DriversTable:
    """Drivers of the primary metric.

    Parameters
    ----------
    trials : the table of trials
    points : table of each point and its drivers, see `rmpc_bench.analysis.drivers`
    turns : where the ranking turns along a swept number, in sentences
    """

    trials: Trials
    points: Sequence[tuple[Trials, pd.DataFrame]]
    turns: tuple[str, ...]

    @property
    def frame(self) -> pd.DataFrame:
        """Content of drivers.csv: sweep columns, then one row per method and quantity."""
        return stacked(list(self.points))

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences that can be quoted: drivers of every method, where it does worst, and where the ranking turns."""
        found: list[str] = []
        for trials, frame in self.points[:MOST_POINTS]:
            start = f"{trials.title}: " if trials.title else ""
            found += [start + text for text in _of_methods(trials, frame)]
        return (*found, *self.turns)

    @property
    def tables(self) -> list[tuple[str, dict[str, list[str]], list[str]]]:
        """Title, columns and sentences of every point with drivers, `MOST_POINTS` at most."""
        filled = [(trials, frame) for trials, frame in self.points[:MOST_POINTS] if len(frame)]
        return [(trials.title, _columns(trials, frame), [*_of_methods(trials, frame)]) for trials, frame in filled]

    def to_markdown(self) -> str:
        """Return a table and its sentences for every point; empty where nothing is uncertain and nothing turns."""
        parts = []
        for trials, frame in self.points[:MOST_POINTS]:
            if len(frame):
                parts += [f"# {trials.title}"] * bool(trials.title) + [markdown_table(_columns(trials, frame))]
                parts.append("\n".join(f"- {text}" for text in _of_methods(trials, frame)))
        left = sum(len(frame) > 0 for _, frame in self.points[MOST_POINTS:])
        parts += [f"{left} more point{'s' * (left > 1)} of the sweep: drivers.csv"] if left else []
        parts += [EXPLANATION] if parts else []
        parts += ["\n".join(f"- {text}" for text in self.turns)] if self.turns else []
        return inert_markdown("\n\n".join(parts)) + "\n" if parts else ""

    def __str__(self) -> str:
        return "\n".join(self.sentences)


EXPLANATION = (
    "Share: what the adjusted R^2 of a quadratic response surface loses without all terms of a quantity. It is the "
    f"total effect of the quantity, interactions included, so that shares need not sum to 100 %. Brackets: interval "
    f"from a bootstrap of whole runs. Not resolved: below {FEWEST} runs, an interval that contains 0 and reaches "
    "beyond 5 %, or a share of about 0 of a quantity that is correlated with another one. "
    "Intervals of the worst fifth are simultaneous for all fifths of all quantities."
)


def drivers_table(trials: Trials) -> DriversTable:
    """Compute the drivers of the primary metric at every point of a sweep, and where the ranking turns."""
    points = [(point, drivers(point)) for point in trials.each]
    return DriversTable(trials, points, tuple(turning_sentences(trials)))


def _of_methods(trials: Trials, frame: pd.DataFrame) -> Iterator[str]:
    found = inputs(trials)
    for method, rows in frame.groupby("method", sort=False):
        yield from method_sentences(trials, str(method), rows.to_dict("records"), found)


def _columns(trials: Trials, frame: pd.DataFrame) -> dict[str, list[str]]:
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
