"""What tables of page, Markdown, LaTeX, CSV and screen share: statistics point by point, texts by column, Markdown."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import pandas as pd

from rmpc_bench.analysis.lost_runs import lost_runs
from rmpc_bench.analysis.result_rows import ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate, change_texts, interval_text, number, places, short
from rmpc_bench.analysis.trials import Trials, stacked_rows
from rmpc_bench.report.run_notes import step_cells
from rmpc_bench.types.result_layout import Column
from rmpc_bench.types.texts import inert_markdown, without_links


class PointSummary(NamedTuple):
    """The statistics of one table of trials."""

    trials: Trials
    described: pd.DataFrame  # one row per method and metric, see `statistics.summary`
    compared: pd.DataFrame  # one row per comparison with the baseline, see `comparison.comparisons`


class Points(NamedTuple):
    """Statistics point by point."""

    points: Sequence[PointSummary]  # the whole table where there is no sweep
    pooled: PointSummary | None = None  # the runs of all points, where these are many plants with the same methods

    @property
    def with_runs(self) -> list[PointSummary]:
        """All points together where they are many plants, else those that have runs."""
        points = [self.pooled] if self.pooled else self.points
        return [point for point in points if len(point.trials.frame)]


def stacked_points(parts: Sequence[tuple[Trials, pd.DataFrame]]) -> pd.DataFrame:
    """Put the tables of points below each other, with the columns of the sweep in front."""
    tables = []
    for trials, frame in parts:
        frame = frame.copy()
        for column, (path, value) in enumerate(trials.point.items()):
            frame.insert(column, path, value)
        tables.append(frame)
    return stacked_rows(tables)


_CODE = re.compile("`[^`]+`")
_MARKS = re.compile(r"[*`\\$]|(?<!\w)_|_(?!\w)")
_LINKED = re.compile(r"\\(?:href|url)|://|www\.", re.IGNORECASE)


def columns_from(rows: Iterable[Mapping[str, str]]) -> dict[str, list[str]]:
    """Return head -> cells of rows that are given as head -> cell."""
    columns: dict[str, list[str]] = {}
    for row in rows:
        for head, cell in row.items():
            columns.setdefault(head, []).append(cell)
    return columns


def markdown_page(parts: Sequence[str]) -> str:
    """Join the parts of a file in Markdown; empty without any."""
    return inert_markdown("\n\n".join(parts)) + "\n" if parts else ""


def markdown_table(columns: Mapping[str, Sequence[str]]) -> str:
    """Lay out columns, head -> cells, as a Markdown table without a line end."""
    rows = [list(columns), *([*row] for row in zip(*columns.values(), strict=True))]
    texts = ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]
    return "\n".join([texts[0], "|" + " --- |" * len(columns), *texts[1:]])


def _cell(text: str) -> str:
    text = text.replace("\n", " ")
    if not _CODE.fullmatch(text):
        marks = _MARKS if "$" not in text or _LINKED.search(text) else None
        text = without_links(marks.sub(r"\\\g<0>", text) if marks else text)
    return inert_markdown(text).replace("|", r"\|")


def columns_of(table: ResultTable, shown: Sequence[ResultRow] | None = None) -> dict[Column, list[str]]:
    """Return the columns that have a text, each with a text per row: of the rows shown, or of all as configured."""
    rows = [*table.rows] if shown is None else shown
    of: dict[Column, Callable[[ResultRow], str]] = {"mean": table.mean_text, "median": median_text}
    lost = _lost(table)
    if lost:
        of["lost"] = lambda row: lost.get(row.method, "")
    if table.form != "alone" and table.trials.with_verdicts:
        average = other_average(table)
        # Shares stand in the column of superiority.
        of |= {} if table.form == "share" else {"change": lambda row: table.change_text(row) if row.n else ""}
        ends = [f"{average}_{end}" for end in ("pct", "low", "high")]
        of |= {"other": lambda row: _change([row.compared[end] for end in ends if row.compared])} if average else {}
        of |= {"counts": lambda row: row.counts, "superiority": _superiority}
        of |= {"p": lambda row: str(row.compared.get("p_wilcoxon_holm", "") or "")}
        of |= {"verdict": lambda row: row.word if row.compared else ""}
        of |= {"pairs": lambda row: str(row.compared.get("n_pairs", ""))}
    of["n"] = lambda row: f"{row.n}/{row.n_failed}" if row.n + row.n_failed else ""
    found: dict[Column, list[str]] = {name: [*map(text, rows)] for name, text in of.items()}
    found |= step_cells(table.trials, [row.method for row in rows])
    return {name: texts for name, texts in found.items() if any(texts)}


def average_of(table: ResultTable) -> str:
    """Name the average of the changes, such as ``geometric``; empty without one."""
    return next((str(row.compared["average"]) for row in table.rows if row.compared and row.compared["average"]), "")


def other_average(table: ResultTable) -> str:
    """Name the average that the verdict does not rest on; empty where it is not computed."""
    name = {"geometric": "mean", "mean": "geometric"}.get(average_of(table), "")
    known = [row for row in table.rows if name and row.compared and not math.isnan(row.compared[f"{name}_pct"])]
    return name if known else ""


def _change(ends: Sequence[float]) -> str:
    return " ".join(filter(None, change_texts(Estimate(*map(float, ends)))))


def value_text(value: float, half: float) -> str:
    """Write a value with the decimals that show half a width."""
    known = half > 1e-12 * abs(value) and places(half) <= 6 and abs(value) < 1e6
    return "" if math.isnan(value) else number(value, places(half)) if known else short(value, 4)


def median_text(row: ResultRow) -> str:
    """Write the median with the quartiles, with decimals that show how far these are apart."""
    if not row.quantiles:
        return ""
    low, middle, high = row.quantiles[1:4]
    side = min((side for side in (middle - low, high - middle) if 0 < side < math.inf), default=0.0)
    return "{1} ({0}, {2})".format(*(value_text(each, side / 2) for each in (low, middle, high)))


def _superiority(row: ResultRow) -> str:
    value, low, high = (number(each, 0) for each in row.superiority)
    interval = "" if math.isnan(row.superiority.half) else f" [{low}, {high}]"
    return "" if math.isnan(row.superiority.value) else f"{value} %{interval}"


def _lost(table: ResultTable) -> dict[str, str]:
    """Return method -> share of lost runs with its interval, where the configuration says what a lost run is."""
    if table.trials.lost is None or table.info != table.trials.primary_info:
        return {}
    rows = lost_runs(table.trials).to_dict("records")
    shares = {row["method"]: Estimate(row["lost_pct"], row["lost_low"], row["lost_high"]) for row in rows}
    return {name: interval_text(share).replace(" [", " % [") for name, share in shares.items()}
