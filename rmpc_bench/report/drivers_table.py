"""What drives the differences between methods, as a table, sentences and the line at the end of a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pandas as pd

from rmpc_bench.analysis.driver_text import Row, per_cent, share_text
from rmpc_bench.analysis.drivers import FEWEST, REST, drivers, inputs
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.driver_sentences import method_sentences
from rmpc_bench.report.summary import stacked
from rmpc_bench.report.tables import markdown_table
from rmpc_bench.report.turning_sentences import turning_sentences
from rmpc_bench.types.texts import inert_markdown

MOST_POINTS = 12
"""Points of a sweep whose drivers stand on the page; drivers.csv has all."""
MOST_NAMED = 4
"""Quantities, and methods, that the screen shows."""
NOTE = "total effects; they need not sum to 100 %"


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

    def to_screen(self) -> list[str]:
        """Return the lines at the end of a run, the first one beginning with ``driven by``; none without drivers."""
        filled = [(trials, frame) for trials, frame in self.points if len(frame)]
        if not filled or not self.trials.with_verdicts:
            return []
        if len(filled) > 1:
            return [f"driven by   drivers.csv: {len(filled)} points of the sweep"]
        return list(_screen(*filled[0]))

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


def _screen(trials: Trials, frame: pd.DataFrame) -> Iterator[str]:
    shares = frame[(frame["response"] != "failed") & (frame["quantity"] != REST)]
    methods = [name for name in trials.methods if name != trials.baseline] or list(trials.methods)
    texts = {name: _one_line(shares[shares["method"] == name].to_dict("records")) for name in methods[:MOST_NAMED]}
    if len(set(texts.values())) == 1 and not any("%" in text for text in texts.values()):
        texts = {"": next(iter(texts.values()))}
    width = max(map(len, texts)) + 3 if len(texts) > 1 else 0
    lines = [f"{name if width else '':{width}}{text}" for name, text in texts.items()]
    longest = max(map(len, lines))
    for n, line in enumerate(lines):
        note = f"{line:{longest}}      {NOTE}" if n == 0 and "%" in line else line
        yield f"{'driven by' if n == 0 else '':12}{note}".rstrip()
    left = len(methods) - MOST_NAMED
    if left > 0:
        yield f"{'':12}and {left} more {'method' if left == 1 else 'methods'}: drivers.csv"


def _one_line(rows: Sequence[Row]) -> str:
    """Name the quantities of a method with their shares, the largest first."""
    if rows and rows[0]["n"] < FEWEST:
        return f"not resolved: {rows[0]['n']} runs, at least {FEWEST} are needed"
    known = [row for row in rows if row["share"] == row["share"]]
    if not known:
        return "not resolved: the runs do not differ, or are too few for the number of quantities"
    known.sort(key=lambda row: -row["share"])
    texts = [f"{row['quantity']} {_per_cent(row)}" for row in known[:MOST_NAMED]]
    left = len(known) - len(texts)
    return "  ".join(texts) + (f"  and {left} more" if left else "")


def _per_cent(row: Row) -> str:
    if not row["resolved"]:
        return "not resolved"
    return f"{per_cent(row['share'])} %"
