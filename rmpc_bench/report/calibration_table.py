"""Calibration of the reported covariances: the table for files, page, paper and screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rmpc_bench.analysis.calibration import COLUMNS, CONSERVATIVE, OVERCONFIDENT, calibrations
from rmpc_bench.analysis.columns import Columns, Rows
from rmpc_bench.analysis.shown_numbers import Estimate, interval_text, number
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.labels import marked
from rmpc_bench.report import latex
from rmpc_bench.report.latex_text import number_latex, to_latex
from rmpc_bench.report.point_tables import (
    FrameTable,
    columns_from,
    markdown_page,
    rounded_columns,
    stacked_points,
    titled_tables,
)
from rmpc_bench.types.texts import cut, width_of

CALIBRATION = "calibration"  # name of the table
MOST_NAMED = 4  # methods that a title and the screen name
_NUMBERS = ["covered", "low", "high", "factor", "factor_low", "factor_high"]


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationTable(FrameTable):
    """Shares of errors in the regions of the reported covariances at every point that has some."""

    points: Sequence[tuple[Trials, Rows]]  # each with its rows, see `rmpc_bench.analysis.calibration`

    @property
    def content(self) -> Columns:
        """Content of calibration.csv: sweep columns, then one row per method, states and level."""
        return rounded_columns(stacked_points(self.points, COLUMNS), _NUMBERS, 1.0)

    @property
    def decisive(self) -> list[Rows]:
        """The rows of every point that have a verdict, one per method."""
        return [[row for row in rows if _decides(trials, row)] for trials, rows in self.points]

    def columns(self, trials: Trials, rows: Rows, *, plain: bool = False) -> dict[str, list[str]]:
        """Return head -> cells of a point, a line per method; a plain name has no mark of an oracle."""
        shares = {(row["method"], row["level"]): row["covered"] for row in rows if row["of"] == "joint"}
        levels = () if trials.calibration is None else trials.calibration.levels
        found = []
        for row in (row for row in rows if _decides(trials, row)):
            name, p = row["method"], row["level"]
            share = Estimate(*(100 * row[key] for key in ("covered", "low", "high")))
            factor = Estimate(row["factor"], row["factor_low"], row["factor_high"])
            cells = {"method": name if plain else marked(trials, name)}
            cells[f"covers {100 * p:g} %"] = interval_text(share, "%")
            cells["errors / reported std"] = interval_text(factor)
            others = {f"{100 * each:g} %": shares.get((name, each), np.nan) for each in levels if each != p}
            cells |= {head: number(each, 2) for head, each in others.items()}
            found.append(cells | {"n/n_failed": f"{row['n']}/{trials.n_failed(name)}", "verdict": row["verdict"]})
        return columns_from(found)

    @property
    def gist(self) -> str:
        """The words of every method at one point, else at how many points a method is overconfident."""
        if len(self.points) == 1:
            words = [f"{row['method']} {_short(row)}" for row in self.decisive[0]]
            return "; ".join(words[:MOST_NAMED]) + f"; {len(words) - MOST_NAMED} more" * (len(words) > MOST_NAMED)
        wrong = [row["method"] for rows in self.decisive for row in rows if row["verdict"].startswith(OVERCONFIDENT)]
        ranked = sorted(dict.fromkeys(wrong), key=wrong.count, reverse=True)[:MOST_NAMED]
        n = len(self.points)
        said = [f"{name} {OVERCONFIDENT} at {wrong.count(name)} of {n} points" for name in ranked]
        return "; ".join(said) or f"no method {OVERCONFIDENT} at any of {n} points" * bool(n)

    @property
    def note(self) -> str:
        """What the columns mean."""
        trials = self.points[0][0]
        margin = 100 * (trials.calibration.margin if trials.calibration else 0.0)
        return (
            "Covers: share of the samples whose error lies in the region that the reported covariance gives this "
            f"probability, its mean over the runs with its {100 * trials.confidence:g} % interval, simultaneous for "
            "all methods. Errors / reported std: how much larger normal errors with this share are than promised. "
            f"Calibrated: they are at most {margin:g} % larger or smaller."
        )

    def lines(self, width: int) -> list[str]:
        """Return lines of the screen: one per method at one point, else one for the sweep; shorter than `width`."""
        if len(self.points) != 1:
            return [cut(f"calibration: {self.gist} (calibration.csv)", width - 1)] if self.points else []
        lines = [_line(row, width - 1) for row in self.decisive[0][:MOST_NAMED]]
        more = len(self.decisive[0]) - len(lines)
        return lines + [f"calibration of {more} more: calibration.csv"] * bool(more)

    def to_markdown(self) -> str:
        """Return a table per point; empty where nothing is asked for."""
        parts = titled_tables(self.points, self.columns)
        return markdown_page([*parts, self.note] if parts else [])

    __str__ = to_markdown

    def to_latex(self, comments: Sequence[str]) -> dict[str, latex.PaperTable]:
        """Return name -> table for a paper; empty where nothing is asked for, or with too many points."""
        if not 0 < len(self.points) <= latex.MOST_POINTS:
            return {}
        every = [(trials, self.columns(trials, rows, plain=True)) for trials, rows in self.points]
        heads = [head if head.startswith("n/") else latex.capitalised(head) for head in every[0][1]]
        body = latex.Body([to_latex(head + " [%]" * head.startswith("Covers")) for head in heads], groups := [])
        for trials, columns in every:
            names, *others, verdicts = columns.values()
            labels = [latex.row_label(trials, name, short=True) for name in names]
            cells = [[number_latex(text.replace(" %", "", 1)) for text in each] for each in others]
            rows = [*map(list, zip(labels, *cells, map(to_latex, verdicts), strict=True))]
            groups.append((latex.title_of(trials), rows))
        caption = f"Errors in the regions of the reported covariances in {len(every[0][0].runs)} runs per method"
        return {CALIBRATION: latex.paper_table(CALIBRATION, body, caption, self.note, comments)}


def _decides(trials: Trials, row: Mapping[str, Any]) -> bool:
    keys = trials.calibration
    return keys is not None and row["of"] == "joint" and row["level"] == keys.verdict


def _short(row: Mapping[str, Any]) -> str:
    """Return the first word of a verdict and, where it is wrong, the factor."""
    first = str(row["verdict"]).partition(",")[0].partition(" (")[0]
    return first + f" {_size(row, 1)}x" * (first in (OVERCONFIDENT, CONSERVATIVE))


def _size(row: Mapping[str, Any], decimals: int = 2) -> str:
    """Write the factor of the errors; its bound where all of them are covered, or none."""
    sign, key = {0.0: ("< ", "factor_high"), np.inf: ("> ", "factor_low")}.get(row["factor"], ("", "factor"))
    return sign + number(row[key], decimals)


def _line(row: Mapping[str, Any], width: int) -> str:
    """Write a method for the screen; verdict, then name, are cut where the line is too long."""
    decimals = 1 if row["high"] - row["low"] < 0.02 else 0
    low, c, high = (f"{100 * row[key]:.{decimals}f}" for key in ("low", "covered", "high"))
    numbers = f"covers {c} % of {100 * row['level']:g} % [{low}, {high}]  errors {_size(row)} x std  "
    numbers *= row["n"] > 0
    words = row["verdict"]
    if width_of(row["method"] + numbers + words) + 2 > width:
        words = _short(row).partition(" ")[0] if row["n"] else words
    name = cut(row["method"], max(4, width - width_of(numbers + words) - 2))
    return cut(f"{name}  {numbers}{words}", width)


def calibration_table(trials: Trials) -> CalibrationTable:
    """Compare the reported covariances with the errors at every point of a sweep."""
    return CalibrationTable([(point, rows) for point, rows in calibrations(trials) if rows])
