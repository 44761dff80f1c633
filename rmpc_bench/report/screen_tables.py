"""Tables of a terminal: rows of methods at one point, the matrix of a sweep, ranks, and what ran.

Every table is laid out in several ways, and the first that fits is taken: the mean goes first, then names are cut.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from rmpc_bench.analysis.ranks import Ranking
from rmpc_bench.analysis.result_rows import FAILS_MORE, NOT_COMPUTED, ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate, plain, short
from rmpc_bench.analysis.shown_numbers import interval_text as number_text
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.labels import quantity
from rmpc_bench.report.answer import ORDER, sweep_of
from rmpc_bench.report.columns import COLUMNS, columns_of, written
from rmpc_bench.report.run_notes import ran_counts
from rmpc_bench.report.run_tables import ensemble_rows
from rmpc_bench.types.texts import cut, in_columns, width_of, without_formulas, wrapped

NAME = 12  # characters to which names are cut where a table is too wide
MOST_ROWS, FIRST_ROWS = 40, 30  # rows that are shown at most; of more the first ones
MOST_POINTS = 12  # points that have a line where a sweep has several paths
_WORDS = (*ORDER, NOT_COMPUTED)


def fitting(layout: Callable[..., list[str]], ways: Iterable[Sequence[Any]], width: int) -> list[str]:
    """Lay a table out in the first way whose lines are not too long; in the last one, cut, where there is none."""
    lines: list[str] = []
    for way in ways:
        lines = layout(*way)
        if max(map(width_of, lines), default=0) <= width:
            return lines
    return [cut(line, width) for line in lines]


def _cut_names(names: Sequence[str], size: int | None) -> list[str]:
    """Cut names; those that would become equal keep their ends."""
    if size is None:
        return [*names]
    counts, half = Counter(cut(name, size) for name in names), size // 2 - 1
    pairs = [(name, cut(name, size)) for name in names]
    return [f"{name[:half]}..{name[-half:]}" if text != name and counts[text] > 1 else text for name, text in pairs]


def _shown(n: int, noun: str, most: int = MOST_ROWS, first: int = FIRST_ROWS) -> tuple[int, list[str]]:
    """Return how many rows are shown, and what is said of the others."""
    return (n, []) if n <= most else (first, [f" and {n - first} more {noun}"])


def row_lines(table: ResultTable, width: int) -> list[str]:
    """Lay out the methods at one point: mean and further numbers, change and verdict."""
    n, left = _shown(len(table.rows), "methods")
    rows, shares, unit = table.ordered[:n], table.form == "share", quantity(table.info)
    found = {"mean": [""] * len(rows)} | columns_of(table, rows)
    numbers = [name for name in found if COLUMNS[name].on_screen]

    def lines(size: int | None, n_numbers: int, remarks: int, heads: int | None = NAME) -> list[str]:
        heads = heads if size else None
        what = without_formulas(unit if heads is None else cut(table.info.words, heads))
        base = table.baseline if size is None else cut(table.baseline, size)
        columns = [["method", *_cut_names([row.method for row in rows], size)]]
        for name in numbers[:n_numbers]:
            head = written(COLUMNS[name].head, table).format(quantity=what)
            columns.append([head, *map(plain, found[name])])
        last = len(columns) if table.form != "alone" else len(columns) - 1
        if table.form != "alone":
            head = f"better than {base} in" if shares else f"change against {base}"
            columns.append([head, *(plain(table.change_text(row)) if row.n else "" for row in rows)])
            columns += [["verdict", *(_verdict(row, remarks) for row in rows)]] if any(row.word for row in rows) else []
        # Without a mean no head names the metric.
        title = [] if n_numbers else wrapped(without_formulas(unit), width)
        return title + in_columns([*zip(*columns, strict=True)], range(1, last + 1))

    ways = [(None, len(numbers), 2), (None, 1, 2), (None, 1, 1), (None, 0, 1), (NAME, 1, 1, None)]
    ways += [(NAME, 1, 1), (NAME, 0, 1), (NAME, 0, 0)]
    return fitting(lines, ways, width) + left


def _verdict(row: ResultRow, remarks: int) -> str:
    """Write the word with its remark, with the failed runs only, or alone."""
    lost = f"{row.n_failed}/{row.n + row.n_failed}" if row.n_failed else ""
    oracle = " (oracle)" if row.is_oracle and "oracle" not in row.method else ""
    if not remarks or row.word == FAILS_MORE:
        return f"{row.word} {lost}".strip() + oracle if remarks else row.word
    if remarks == 1 or not row.remark:
        return f"{row.word}, {lost} failed{oracle}" if lost else f"{row.word}{oracle}"
    return f"{row.word}{oracle}, {row.remark.replace('by less than', '<')}"


def ran_lines(trials: Trials, width: int) -> list[str]:
    """Say of every method whether its runs ended well, all points together."""
    n, left = _shown(len(trials.methods), "methods")
    counts = [*ran_counts(trials).items()][:n]
    words = [f"failed {k} of {total} runs" if k else "ran" if total else NOT_COMPUTED for _, (k, total) in counts]

    def lines(size: int | None) -> list[str]:
        return in_columns([*zip(_cut_names([name for name, _ in counts], size), words, strict=True)])

    return fitting(lines, ((None,), (NAME,)), width) + left


def moment_lines(trials: Trials, width: int) -> list[str]:
    """Lay out moments of the error at the end, a line per method and point; nothing without any."""
    found = [(point.title, [*row.values()]) for point in trials.each for row in ensemble_rows(point)]
    n, left = _shown(len(found), "lines: tables/summary.md", most=MOST_POINTS, first=MOST_POINTS)
    names = [" ".join(filter(None, [row[0], title])) for title, row in found[:n]]
    heads = ("error at the end", "bias", "variance", "mean square", "reported", "")

    def lines(size: int | None, kept: Sequence[int]) -> list[str]:
        columns = [[heads[0], *_cut_names(names, size)]]
        columns += [[heads[k], *(row[k] for _, row in found[:n])] for k in (*kept, 5)]
        return in_columns([*zip(*columns, strict=True)], range(1, len(kept) + 1))

    ways = ((None, (1, 2, 3, 4)), (None, (3, 4)), (None, (3,)), (NAME, (3,)))
    return fitting(lines, ways, width) + left if found else []


def rank_lines(found: Ranking, trials: Trials, width: int) -> list[str]:
    """Lay out the ratios over all points, with the rank in place of a verdict."""
    n, left = _shown(len(found.rows), "methods")
    rows = found.rows[:n]
    ratios = [plain(number_text(Estimate(row.ratio.ratio, row.ratio.low, row.ratio.high))) for row in rows]
    ratios = ["1" if row.method == trials.baseline else text for row, text in zip(rows, ratios, strict=True)]
    lost = [f"{row.n_failed}/{row.n}" if row.n_failed else "" for row in rows]

    def lines(size: int | None) -> list[str]:
        columns = [
            ["method", *_cut_names([row.method for row in rows], size)],
            ["failed", *lost],
            [f"ratio to {trials.baseline if size is None else cut(trials.baseline, size)}", *ratios],
            ["rank", *(f"{row.rank_low} to {row.rank_high}" for row in rows)],
        ]
        return in_columns([*zip(*(each for each in columns if any(each[1:])), strict=True)], range(1, 3))

    return fitting(lines, ((None,), (NAME,)), width) + left


def sweep_lines(tables: Sequence[ResultTable], width: int) -> list[str]:
    """Lay out a sweep as the matrix that fits, with a title; else count the verdicts of every method."""
    first, sweep = tables[0], sweep_of(tables)
    paths = [*dict.fromkeys(path for table in tables for path in table.trials.point)]
    x = paths[0].rpartition(".")[2] if len(paths) == 1 else "point"
    by = "" if len(paths) > 1 else f" by {x}" if x == paths[0] else f" by {x} = {paths[0]}"
    what = "share of runs better than" if first.form == "share" else f"change of the {first.quantity} against"
    title = f"mean {quantity(first.info)}" if first.form == "alone" else f"{what} {first.baseline}"
    down, across = _matrix(tables, x, sweep.points)
    points_first = sweep.ordered or len(tables) >= len(first.rows) - 1
    numbers = [str(k + 1) for k in range(len(tables))]
    numbered, key = _matrix(tables, x, numbers)[1], ", ".join(map(" ".join, zip(numbers, sweep.points, strict=True)))
    title = without_formulas(title)
    title = title + by if width_of(title + by) <= width else cut(title, width)
    layouts = [(down, size, mean) for size, mean in _WAYS] + [(across, size, mean) for size, mean in _WAYS[:2]]
    if not points_first:
        layouts = layouts[len(_WAYS) :] + layouts[: len(_WAYS)]
    if len(paths) == 1 or len(tables) <= MOST_POINTS:
        for layout, size, with_mean in [*layouts, (numbered, None, False), (numbered, NAME, False)]:
            lines = layout(size, with_mean)
            if max(map(width_of, lines)) <= width:
                n, left = _shown(len(lines) - 1, "points" if layout is down else "methods")
                return [title, *(wrapped(key, width, " ", " ") if layout is numbered else []), *lines[: n + 1], *left]
    return _counted_lines(tables, width)


_WAYS = ((None, True), (None, False), (NAME, False))  # size of names, and whether the means of the baseline are shown
_Layout = Callable[[int | None, bool], list[str]]


def _matrix(tables: Sequence[ResultTable], x: str, points: Sequence[str]) -> tuple[_Layout, _Layout]:
    """Return the layouts with the points below each other and with the methods below each other."""
    first, found = tables[0], [{row.method: row for row in table.rows} for table in tables]
    names = [row.method for row in first.ordered if not row.is_baseline]
    pairs = [*zip(tables, found, strict=True)]
    means = [_mean(t, rows[first.baseline]) if first.baseline in rows else "" for t, rows in pairs]

    def cell(table: ResultTable, row: ResultRow) -> str:
        """Let the mark of a cell stand behind the column of numbers."""
        text = plain(table.short_change(row))
        return text if text.endswith((" ?", " =", " !")) else f"{text}  "

    cells = [[cell(table, rows[name]) if name in rows else "" for table, rows in pairs] for name in names]

    def lines(size: int | None, with_mean: bool, *, down: bool) -> list[str]:
        texts = [_cut_names(points, size and 2 * size if down else size)]
        texts += [means] if with_mean or not names else []
        # Heads and means do not stand above marks.
        texts = texts if down else [[f"{text}  " for text in row] for row in texts]
        heads = [x, f"{first.baseline}, {first.mean_word}"][: len(texts)]
        heads += [f"{name}  " if down else name for name in _cut_names(names, size)]
        rows = [[head, *row] for head, row in zip(heads, [*texts, *cells], strict=True)]
        rows = [[*row] for row in zip(*rows, strict=True)] if down else rows
        return in_columns(rows, range(1, len(rows[0])))

    return partial(lines, down=True), partial(lines, down=False)


def _mean(table: ResultTable, row: ResultRow) -> str:
    """Write the mean of the baseline, or in how many runs the event occurred."""
    return f"{row.n_occurred} of {row.n}" if table.may_not_occur else plain(short(row.mean.value))


def _counted_lines(tables: Sequence[ResultTable], width: int) -> list[str]:
    """Count the verdicts of every method over the points, with the smallest and the largest change."""
    first = tables[0]
    rows: list[list[str]] = [["method", *_WORDS, "changes"]]
    for name in [row.method for row in first.ordered if not row.is_baseline]:
        found = [(table, row) for table in tables for row in table.rows if row.method == name]
        words = Counter(row.word for _, row in found)
        known = [pair for pair in found if not math.isnan(pair[0].rank(pair[1]))]
        values = [(row.superiority if table.form == "share" else row.change).value for table, row in known]
        ends = [known[values.index(end)] for end in (min(values), max(values))] if known else []
        changes = " to ".join(plain(table.short_change(row._replace(word=""))) for table, row in ends)
        rows.append([name, *(str(words[word] or "") for word in _WORDS), changes])
    kept = [k for k in range(len(rows[0])) if k == 0 or any(row[k] for row in rows[1:])]
    rows = [[row[k] for k in kept] for row in rows]
    n, left = _shown(len(rows) - 1, "methods")
    title = f"verdicts at {len(tables)} points, {without_formulas(first.quantity)} against {first.baseline}"

    def lines(size: int | None, with_changes: bool) -> list[str]:
        names = _cut_names([row[0] for row in rows], size)
        return in_columns(
            [[name, *row[1 : None if with_changes else -1]] for name, row in zip(names, rows[: n + 1], strict=False)],
            range(1, len(rows[0])),
        )

    ways = ((None, True), (NAME, True), (None, False), (NAME, False))
    return [cut(title, width), *fitting(lines, ways, width), *left]
