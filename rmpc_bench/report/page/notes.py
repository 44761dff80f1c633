"""The note below the main table, of at most two lines: runs, intervals, averages, parameters and failures."""

from __future__ import annotations

from collections.abc import Sequence

from rmpc_bench.analysis.comparison_text import per_cent
from rmpc_bench.analysis.failures import FACTOR
from rmpc_bench.analysis.parameter_text import parameter_groups
from rmpc_bench.analysis.result_rows import EQUIVALENT, FAILS_MORE, INCONCLUSIVE, MARKS, ResultTable
from rmpc_bench.report.page.rows import Rows

LONGEST = 285
"""Characters of two lines."""
SHARE = "of the share of runs in which the method is better (ties count half)"


def note_of(tables: Sequence[ResultTable], n: int, rows: Rows | None = None, *, lowest: str = "") -> str:
    """Write the note; sentences that do not fit are left out, those at the end first.

    Parameters
    ----------
    tables : of the primary metric at every point
    n : runs that every method has
    rows : the table, where it is one of rows
    lowest : ``row`` or ``column``, of which a matrix underlines the lowest change; empty where it has none
    """
    first = tables[0]
    if not first.trials.with_verdicts:
        return ""
    several = len(tables) > 1
    sentences = [
        f"{n} run{'s' * (n > 1)} per {'point and ' * several}method{' on the same draws' * _compares(tables)}."
    ]
    sentences += [_intervals(tables), _change(first), _marks(tables, lowest) if several else _drawn(first, rows)]
    sentences += [_parameters(first), _oracles(first), _looks(first), _failures(tables)]
    kept, room = list[str](), LONGEST
    for sentence in filter(None, sentences):
        if len(sentence) < room:
            kept.append(sentence)
            room -= len(sentence) + 1
    return " ".join(kept)


def _compares(tables: Sequence[ResultTable]) -> bool:
    return any(row.compared for table in tables for row in table.rows)


def _intervals(tables: Sequence[ResultTable]) -> str:
    first, level = tables[0], f"{100 * tables[0].trials.confidence:g} %"
    compared = [row.compared for table in tables for row in table.rows if row.compared]
    if not compared:
        return f"\u00b1: {level} interval of the mean." if len(tables) == 1 and not first.may_not_occur else ""
    simultaneous = any(float(row["ci_level"]) > first.trials.confidence for row in compared)
    which = "simultaneous " * simultaneous
    if len(tables) > 1:
        return f"Verdicts: {which}{level} intervals{' of all comparisons' * simultaneous}."
    if first.form == "share":
        return f"Brackets and bars: {which}{level} intervals {SHARE}."
    mean = f"; \u00b1: {level} interval of the mean" if not first.may_not_occur else ""
    return f"Brackets and bars: {which}{level} intervals{mean}."


def _change(table: ResultTable) -> str:
    what = "Difference" if table.form == "difference" else "Change"
    return f"{what}: {table.average}." if table.average else ""


def _marks(tables: Sequence[ResultTable], lowest: str) -> str:
    words = {row.word for table in tables for row in table.rows}
    texts = {INCONCLUSIVE: INCONCLUSIVE, EQUIVALENT: f"within {tables[0].margin_text}", FAILS_MORE: FAILS_MORE}
    parts = [f"{MARKS[word]} {text}" for word, text in texts.items() if word in words]
    best = "highest" if tables[0].info.direction == "higher" else "lowest"
    parts += [f"underlined: {best} of a {lowest}"] if lowest else []
    return f"{', '.join(parts)}." if parts else ""


def _drawn(table: ResultTable, rows: Rows | None) -> str:
    if table.form in ("alone", "share"):
        return "Arrow: runs without the event." if table.form == "share" else ""
    arrow = (
        any(cell.strip is not None and cell.strip.arrow for row in rows.rows for cell in row.cells) if rows else False
    )
    band = (
        f"{'Margin' if rows and rows.everything else 'Grey band'}: within {table.margin_text}." if table.margin else ""
    )
    return f"{band}{' Arrow: beyond the axis.' * arrow}".strip()


def _parameters(table: ResultTable) -> str:
    """Say where the parameters come from: in words where all methods are alike."""
    groups = parameter_groups(table.trials, table.trials.methods)
    if len(groups) == 1:
        return f"Parameters: {next(iter(groups))}."
    parts = [
        f"{names[0] if len(names) == 1 else len(names)} {word.partition(' (')[0]}" for word, names in groups.items()
    ]
    return f"Parameters: {'; '.join(parts)}." if parts else ""


def _failures(tables: Sequence[ResultTable]) -> str:
    """Say that failed runs are left out; of one point without lost runs, which share of all runs they can be."""
    if any(row.n_failed for table in tables for row in table.rows):
        return "Failed runs are left out of means and changes."
    rows = [row.compared for row in tables[0].rows if row.compared]
    known = [row for row in rows if row["far_worse_upper"] == row["far_worse_upper"]]
    if len(tables) > 1 or not known or any(row["far_worse_runs"] for row in known):
        return ""
    n = min(row["won"] + row["lost"] + row["tied"] for row in known)
    bound = per_cent(100 * max(float(row["far_worse_upper"]) for row in known))
    factor = f"{tables[0].trials.lost or FACTOR:g} times worse than {tables[0].baseline}"
    return f"No run of {n} was lost (failed or {factor}): at most {bound} are."


def _oracles(table: ResultTable) -> str:
    return "An oracle knows the true parameters." if any(row.is_oracle for row in table.rows) else ""


def _looks(table: ResultTable) -> str:
    if table.trials.planned is not None:
        return f"{table.trials.planned.text[:1].upper()}{table.trials.planned.text[1:]}."
    look = max((int(row.compared["look"]) for row in table.rows if row.compared), default=1)
    return f"Look {look} at a growing number of runs, with wider intervals." if look > 1 else ""
