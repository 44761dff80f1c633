"""Columns of the table of a metric: one record each, which page, Markdown, LaTeX, its notes and the screen read.

Numbers of a row are those of summary.csv, `ResultRow.described`, and of comparisons.csv, `ResultRow.compared`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple, TypeAlias

from rmpc_bench.analysis.comparison_text import about, change_of
from rmpc_bench.analysis.lost_runs import lost_runs
from rmpc_bench.analysis.result_rows import INCONCLUSIVE, ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate, change_texts, interval_text, number, places, short
from rmpc_bench.report.latex_text import bracketed
from rmpc_bench.report.run_notes import percent, short_time
from rmpc_bench.types.result_layout import Column

USUAL: tuple[Column, ...] = ("mean", "lost", "change", "counts", "verdict")
"""Columns in LaTeX unless others are chosen; where they do not fit, the last ones are left out, up to the change."""
Cells: TypeAlias = Callable[[ResultTable, Sequence[ResultRow]], Sequence[str]]
Text: TypeAlias = str | Callable[[ResultTable], str]  # a text, or what writes it for a table


class TableColumn(NamedTuple):
    """A column.  It is left out where no cell has a text, and by writers for which it has no head."""

    cells: Cells  # writes a cell for each of the rows that are shown, or nothing where the table has no such column
    head: Text = ""  # on page, screen and in Markdown, with `{quantity}` in place of the metric
    latex: Text = ""  # lines of the head in LaTeX; `types.result_layout.Column` has the keys of these columns
    unit: Text = ""  # what stands in that head and not in the cells, with the blank before it
    definition: str = ""  # sentence below a table in LaTeX; `notes.table_note` has the words for its braces
    compares: bool = False  # whether it rests on pairs of runs; a smoke run does not have it then
    only: Literal["", "page", "file"] = ""  # whether the page or files in Markdown show it, if not both
    on_screen: bool = False  # whether the screen shows it where there is room


def columns_of(table: ResultTable, shown: Sequence[ResultRow] | None = None) -> dict[str, list[str]]:
    """Return the columns that have a text, each with a text per row: of the rows shown, or of all as configured."""
    rows = [*table.rows] if shown is None else shown
    compared = table.form != "alone" and table.trials.with_verdicts
    found = {key: [*each.cells(table, rows)] for key, each in COLUMNS.items() if compared or not each.compares}
    return {key: cells for key, cells in found.items() if any(cells)}


def written(text: Text, table: ResultTable) -> str:
    """Return a text for a table."""
    return text if isinstance(text, str) else text(table)


def other_average(table: ResultTable) -> str:
    """Name the average that the verdict does not rest on; empty where it is not computed."""
    name = {"geometric": "mean", "mean": "geometric"}.get(table.average_key, "")
    known = [row for row in table.rows if name and row.compared and not math.isnan(row.compared[f"{name}_pct"])]
    return name if known else ""


def value_text(value: float, half: float) -> str:
    """Write a value with the decimals that show half a width."""
    known = half > 1e-12 * abs(value) and places(half) <= 6 and abs(value) < 1e6
    return "" if math.isnan(value) else number(value, places(half)) if known else short(value, 4)


def runs_text(n: int, n_failed: int) -> str:
    """Write how many runs finished, and how many failed."""
    return f"{n}{f', {n_failed} failed' if n_failed else ''}"


def _by_row(text: Callable[[ResultRow], str]) -> Cells:
    """Write every cell from its row alone."""
    return lambda _, rows: [text(row) for row in rows]


def _median(row: ResultRow) -> str:
    """Write the median with the quartiles, with decimals that show how far these are apart."""
    if not row.quantiles:
        return ""
    low, middle, high = row.quantiles[1:4]
    side = min((side for side in (middle - low, high - middle) if 0 < side < math.inf), default=0.0)
    return "{1} ({0}, {2})".format(*(value_text(each, side / 2) for each in (low, middle, high)))


def _other_change(table: ResultTable, rows: Sequence[ResultRow]) -> list[str]:
    average = other_average(table)
    changes = [change_of(row.compared, average) if row.compared else Estimate() for row in rows if average]
    return [" ".join(filter(None, change_texts(change))) for change in changes]


def _unit(table: ResultTable) -> str:
    return table.info.unit if table.average_key == "difference" else "%"


def _superiority(row: ResultRow) -> str:
    value, low, high = (number(each, 0) for each in row.superiority)
    interval = "" if math.isnan(row.superiority.half) else f" [{low}, {high}]"
    return "" if math.isnan(row.superiority.value) else f"{value} %{interval}"


def _lost(table: ResultTable, rows: Sequence[ResultRow]) -> list[str]:
    """Write the share of lost runs with its interval, where the configuration says what a lost run is."""
    if table.trials.lost is None or table.info != table.trials.primary_info:
        return []
    found = {each["method"]: each for each in lost_runs(table.trials)}
    shares = {name: Estimate(*(each[f"lost_{end}"] for end in ("pct", "low", "high"))) for name, each in found.items()}
    return [interval_text(shares[row.method]).replace(" [", " % [") if row.method in shares else "" for row in rows]


def _held(table: ResultTable, rows: Sequence[ResultRow]) -> list[str]:
    return _steps(table, rows, {key: notes.n_held for key, notes in table.trials.notes.items() if notes.holds})


def _failed(table: ResultTable, rows: Sequence[ResultRow]) -> list[str]:
    failed = {key: notes.n_failed_steps for key, notes in table.trials.notes.items() if notes.optimises}
    return _steps(table, rows, failed) if any(failed.get(row.method) for row in rows) else []


def _steps(table: ResultTable, rows: Sequence[ResultRow], counts: Mapping[str, int]) -> list[str]:
    """Write numbers of steps as shares of all steps of a method; nothing where no row has one."""
    n, notes = len(table.trials.runs), table.trials.notes
    shares = {key: percent(100.0 * count / max(1, notes[key].n_steps * n)) for key, count in counts.items()}
    return [shares.get(row.method, "-") for row in rows] if any(row.method in shares for row in rows) else []


def _times(table: ResultTable, rows: Sequence[ResultRow]) -> list[str]:
    """Write the times per step; nothing where none is known."""
    notes = [table.trials.notes.get(row.method) for row in rows]
    seconds = [each.seconds_per_step if each else None for each in notes]
    return ["-" if each is None else short_time(each) for each in seconds] if any(seconds) else []


def _needed(row: ResultRow) -> str:
    """Write how many runs an inconclusive comparison needs for a direction."""
    n = row.compared.get("runs_for_direction") if row.word == INCONCLUSIVE else None
    return "" if n is None else about(n)


COLUMNS: dict[str, TableColumn] = {
    "mean": TableColumn(
        lambda table, rows: [table.mean_text(row) for row in rows],
        head=lambda table: f"{'occurred; median' if table.may_not_occur else 'mean'} {{quantity}}",
        latex=lambda table: ("Occurred;\nmedian " if table.may_not_occur else "Mean\n") + bracketed(table.info.unit),
        definition="Mean: average over the finished runs, with half its {level} interval.",
        on_screen=True,
    ),
    "change": TableColumn(
        # Shares stand in the column of superiority.
        lambda table, rows: [table.change_text(row) if row.n and table.form != "share" else "" for row in rows],
        head=lambda table: "better in" if table.form == "share" else "change",
        latex=lambda table: (
            ("Difference\n" if table.average_key == "difference" else "Change\n") + bracketed(_unit(table))
        ),
        unit=lambda table: f" {_unit(table)}",
        definition="Change: relative to {baseline}, {average}, with {kind}{level} intervals in brackets.",
        compares=True,
    ),
    "verdict": TableColumn(
        _by_row(lambda row: row.word if row.compared else ""),
        head="verdict",
        latex="Verdict",
        definition="Verdict: from the interval and a margin of {margin}.",
        compares=True,
    ),
    "median": TableColumn(
        _by_row(_median),
        head="median (quartiles)",
        latex=lambda table: f"Median\n(quartiles) {bracketed(table.info.unit)}".strip(),
        definition="Median: of the finished runs, with the quartiles in parentheses.",
    ),
    "counts": TableColumn(
        _by_row(lambda row: row.counts),
        head="won/lost/tied",
        latex="Won/lost/\ntied",
        definition="Won/lost/tied: number of runs in which the method is better, worse or {tied}.",
        compares=True,
    ),
    "superiority": TableColumn(
        _by_row(_superiority),
        head="superiority",
        latex="Superiority",
        definition="Superiority: share of the runs in which the method is better, those that are {tied} counted half.",
        compares=True,
    ),
    "lost": TableColumn(
        _lost,
        head="lost",
        latex="Lost\n[\\%]",
        unit=" %",
        definition="Lost: share of the runs that failed or whose {metric} exceeds {lost} times that of {baseline} in "
        "the same run, with its {level} interval.",
    ),
    "held": TableColumn(
        _held,
        head="held steps",
        latex="Held\nsteps",
        definition="Held steps: share of the steps in which a failed component kept its last value.",
    ),
    "steps": TableColumn(
        _failed,
        head="failed steps",
        latex="Failed\nsteps",
        definition="Failed steps: share of the steps in which the optimisation failed and the fallback was applied.",
    ),
    "other": TableColumn(
        _other_change,
        head=lambda table: "geometric mean of ratios" if table.average_key == "mean" else "ratio of means",
        latex=lambda table: "Geometric\nmean [\\%]" if table.average_key == "mean" else "Ratio of\nmeans [\\%]",
        unit=" %",
        definition="The other change is the {other}.",
        compares=True,
    ),
    "plain": TableColumn(
        # The change of adjusted rows without the adjustment.
        lambda table, rows: [
            table.change_text(row._replace(change=row.plain)) if row.is_adjusted else "" for row in rows
        ],
        head="change, not adjusted",
        latex=lambda table: "Not adjusted\n" + bracketed(_unit(table)),
        unit=lambda table: f" {_unit(table)}",
        definition="Not adjusted: the same change from the paired values alone.",
        compares=True,
    ),
    "worst": TableColumn(_by_row(lambda row: short(row.worst, 4)), "worst run"),
    "needed": TableColumn(_by_row(_needed), "runs needed"),
    # A file that is kept does not change from machine to machine.
    "time": TableColumn(_times, "time per step", only="page"),
    "p": TableColumn(
        _by_row(lambda row: str(row.compared.get("p_wilcoxon_holm", "") or "")),
        head="p",
        latex="$p$",
        definition="$p$: p value of the Wilcoxon signed-rank test, adjusted by Holm's method.",
        compares=True,
        only="file",
    ),
    "runs": TableColumn(_by_row(lambda row: runs_text(row.n, row.n_failed)), "runs"),
    "n": TableColumn(
        _by_row(lambda row: f"{row.n}/{row.n_failed}" if row.n + row.n_failed else ""),
        latex="Runs/\nfailed",
        definition="Runs/failed: number of finished runs and of failed runs.",
    ),
    "pairs": TableColumn(
        _by_row(lambda row: str(row.compared.get("n_pairs") or "")),
        latex="Pairs",
        definition="Pairs: runs that both methods finished.",
        compares=True,
    ),
}  # key -> column, in the order of page and Markdown
