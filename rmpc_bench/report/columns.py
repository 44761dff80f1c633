"""Texts of the rows of a metric, column by column: for the page, Markdown and LaTeX."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from rmpc_bench.analysis.lost_runs import lost_runs
from rmpc_bench.analysis.result_rows import ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate, change_texts, interval_text, number, places, short
from rmpc_bench.report.run_notes import failed_cells, held_cells
from rmpc_bench.types.report_choices import Column

OTHER_AVERAGE = {"geometric": "mean", "mean": "geometric"}  # average of the verdict -> the other one that is computed


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
        of |= {"other": lambda row: _change(*(row.compared[end] for end in ends if row.compared))} if average else {}
        of |= {"counts": lambda row: row.counts, "superiority": _superiority}
        of |= {"p": lambda row: str(row.compared.get("p_wilcoxon_holm", "") or "")}
        of |= {"verdict": lambda row: row.word if row.compared else ""}
        of |= {"pairs": lambda row: str(row.compared.get("n_pairs", ""))}
    of["n"] = lambda row: f"{row.n}/{row.n_failed}" if row.n + row.n_failed else ""
    found: dict[Column, list[str]] = {name: [*map(text, rows)] for name, text in of.items()}
    names = [row.method for row in rows]
    found |= {"held": held_cells(table.trials, names), "steps": failed_cells(table.trials, names)}
    return {name: texts for name, texts in found.items() if any(texts)}


def average_of(table: ResultTable) -> str:
    """Name the average of the changes, such as ``geometric``; empty without one."""
    return next((str(row.compared["average"]) for row in table.rows if row.compared and row.compared["average"]), "")


def other_average(table: ResultTable) -> str:
    """Name the average that the verdict does not rest on; empty where it is not computed."""
    name = OTHER_AVERAGE.get(average_of(table), "")
    known = [row for row in table.rows if name and row.compared and not math.isnan(row.compared[f"{name}_pct"])]
    return name if known else ""


def _change(*ends: float) -> str:
    return " ".join(filter(None, change_texts(Estimate(*map(float, ends)))))


def value_text(value: float, half: float) -> str:
    """Write a value with the decimals that show half a width."""
    known = half > 1e-12 * abs(value) and places(half) <= 6 and abs(value) < 1e6
    return "" if math.isnan(value) else number(value, places(half)) if known else short(value, 4)


def mean_alone(row: ResultRow) -> str:
    """Write a mean without its interval."""
    return value_text(row.mean.value, row.mean.half)


def median_text(row: ResultRow) -> str:
    """Write the median with the quartiles, with decimals that show how far these are apart."""
    if not row.quantiles:
        return ""
    low, middle, high = row.quantiles[1:4]
    side = min((side for side in (middle - low, high - middle) if 0 < side < math.inf), default=0.0)
    return "{1} ({0}, {2})".format(*(value_text(each, side / 2) for each in (low, middle, high)))


def _superiority(row: ResultRow) -> str:
    if math.isnan(row.superiority.value):
        return ""
    value, low, high = (number(each, 0) for each in row.superiority)
    return f"{value} %" if math.isnan(row.superiority.half) else f"{value} % [{low}, {high}]"


def _lost(table: ResultTable) -> dict[str, str]:
    """Return method -> share of lost runs with its interval, where the configuration says what a lost run is."""
    if table.trials.lost is None or table.info != table.trials.primary_info:
        return {}
    rows = lost_runs(table.trials).to_dict("records")
    shares = {row["method"]: Estimate(row["lost_pct"], row["lost_low"], row["lost_high"]) for row in rows}
    return {name: interval_text(share).replace(" [", " % [") for name, share in shares.items()}
