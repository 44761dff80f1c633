"""Captions and notes of the tables of a paper.

A caption is one short line, for many classes of documents set captions of tables in capitals.  The note below the table
defines every column, the pairing, failures and verdicts in full sentences.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rmpc_bench.analysis.comparison_text import far_worse_bound, margin_text
from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.parameter_text import parameter_groups
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.sweep_points import printed
from rmpc_bench.report import cells
from rmpc_bench.report.cells import MetricTable, metric_table
from rmpc_bench.report.latex import ALL_METRICS, WIDTH, shown_points
from rmpc_bench.report.latex_columns import capitalised, chosen_columns
from rmpc_bench.report.latex_text import printed_latex, to_latex
from rmpc_bench.report.sentences import AVERAGES
from rmpc_bench.report.summary import Summary
from rmpc_bench.types import MetricInfo
from rmpc_bench.types.report_choices import Column

BEST = {"lower": "lower is better", "higher": "higher is better", "zero": "0 is best", "one": "1 is best"}
"""Direction of a metric -> words."""


def latex_captions(summary: Summary) -> dict[str, str]:
    """Return name -> LaTeX of the caption of every table that `latex.latex_tables` writes."""
    points = shown_points(summary)
    if not points:
        return {}
    trials = points[0].trials
    captions = {info.name: _subject(info.words, trials, len(points)) for info in trials.metrics}
    if len(captions) > 1:
        captions[ALL_METRICS] = _subject("Metrics", trials, len(points))
    return {name: f"{to_latex(text)}%\n" for name, text in captions.items()}


def latex_notes(summary: Summary, columns: Sequence[Column] | None = None, width: float = WIDTH) -> dict[str, str]:
    """Return name -> LaTeX of the note below every table that `latex.latex_tables` writes.

    Columns are those behind the name of the method; without them the usual ones that fit into the width [pt].
    """
    points = shown_points(summary)
    if not points:
        return {}
    infos = points[0].trials.metrics
    tables = {info.name: [metric_table(*point, info) for point in points] for info in infos}
    notes = {name: table_note(each, chosen_columns(each, columns, width)) for name, each in tables.items()}
    if len(infos) > 1:
        notes[ALL_METRICS] = _note_of_all([each[0] for each in tables.values()])
    return {name: f"{printed_latex(text)}%\n" for name, text in notes.items()}


def table_note(tables: Sequence[MetricTable], shown: Sequence[Column]) -> str:
    """Define the columns behind the name of the method: plain text with formulas between dollar signs.

    The tables are of one metric, at every point of the sweep.
    """
    first = tables[0]
    sentences = [f"{capitalised(first.info.words)}: {BEST[first.info.direction]}.", *_described(first, shown)]
    if {"change", "other", "counts", "superiority", "p", "verdict"} & set(shown):
        sentences += _of_comparison(first, shown)
    if "verdict" in shown and len(tables) == 1:
        rows = [line.compared for line in first.lines if line.compared]
        sentences += [f"{capitalised(bound)}." for bound in [far_worse_bound(rows, first.trials, first.info)] if bound]
    return " ".join([*sentences, _failures(tables)])


def _subject(what: str, trials: Trials, n_points: int) -> str:
    """Name what is shown, methods, runs and points of a sweep."""
    where = f" at {n_points} points of the sweep" if n_points > 1 else ""
    return f"{capitalised(what)} of {_counted(len(trials.methods), 'method')} in {_runs(trials)}{where}"


def _runs(trials: Trials) -> str:
    if trials.alike and not trials.points and trials.title:
        return f"one run at {_plain(printed(trials.title))}"
    return f"{_counted(len(trials.runs), 'run')} per method"


def _described(table: MetricTable, shown: Sequence[Column]) -> Iterable[str]:
    """Define the columns that describe one method."""
    if "mean" in shown:
        yield _mean(table)
    if "lost" in shown:
        yield _lost(table)
    if "median" in shown:
        yield "Median: median of the finished runs, with the quartiles in brackets."
    if "n" in shown:
        yield "Runs/failed: number of finished runs and of failed runs."
    if "held" in shown:
        yield "Held steps: share of the steps in which a failed component kept its last value."
    if "steps" in shown:
        yield "Failed steps: share of the steps in which the optimisation failed and the fallback was applied."


def _mean(table: MetricTable) -> str:
    if table.may_not_occur:
        return "Did not occur: number and share of the runs in which the event did not occur."
    bracket = any("(" in text for text in cells.means(table))
    error = ", with the standard error of the last digits in parentheses" if bracket else ""
    return f"Mean: average over the finished runs{error}."


def _lost(table: MetricTable) -> str:
    trials = table.trials
    limit = f"{trials.lost:g} times that of {_name(trials, trials.baseline)} in the same run"
    interval = f"the {100 * trials.confidence:g} % interval of Wilson in brackets"
    return f"Lost: share of the runs that failed or whose {table.info.words} exceeds {limit}, with {interval}."


def _of_comparison(table: MetricTable, shown: Sequence[Column]) -> Iterable[str]:
    """Define the columns that compare a method with the baseline, and the pairing that all of them rest on."""
    trials, info = table.trials, table.info
    rows = [line.compared for line in table.lines if line.compared]
    baseline = _name(trials, trials.baseline)
    yield f"Each run is paired with the run of {baseline} that has the same random parameters, initial state and noise."
    if "change" in shown:
        yield _change(table, cells.average_of(table), simultaneous=_is_simultaneous(trials, info, rows))
    if "other" in shown:
        yield f"The other change is the {AVERAGES[cells.other_average(table) or 'mean']}."
    row = next((each for each in rows if each["average"]), None)
    margin = _plain(margin_text(trials, info, row))
    tied = "equal" if margin.split()[0] == "0" else f"within {margin}"
    if "counts" in shown:
        compared = "" if name_of_distance(info) == info.name else f", compared by {_plain(name_of_distance(info))}"
        yield f"Won/lost/tied: number of runs in which the method is better, worse or {tied}{compared}."
    if "superiority" in shown:
        yield f"Superiority: share of the runs in which the method is better, those that are {tied} counted half."
    if "p" in shown:
        yield "$p$: p value of the Wilcoxon signed-rank test, adjusted by Holm's method."
    if "verdict" in shown:
        yield _verdict(margin)
    yield from _parameters(trials)


def _parameters(trials: Trials) -> Iterable[str]:
    """Say where the parameters of the methods come from; nothing where it is not known."""
    groups = parameter_groups(trials, trials.methods)
    if len(groups) == 1:
        yield f"Parameters of all methods: {next(iter(groups))}."
    elif groups:
        parts = [f"{', '.join(_name(trials, name) for name in names)}: {word}" for word, names in groups.items()]
        yield f"Parameters: {'; '.join(parts)}."


def _is_simultaneous(trials: Trials, info: MetricInfo, rows: Sequence[Mapping[str, Any]]) -> bool:
    return info == trials.primary_info and any(float(row["ci_level"]) > trials.confidence for row in rows)


def _change(table: MetricTable, average: str, *, simultaneous: bool) -> str:
    trials = table.trials
    level = f"{100 * trials.confidence:g} % interval"
    kind = f"simultaneous {level}s of all comparisons" if simultaneous else f"its {level}"
    baseline = _name(trials, trials.baseline)
    if average == "difference":
        return f"Difference: mean difference from {baseline} over the paired runs, with {kind} in brackets."
    return f"Change: relative to {baseline}, {AVERAGES.get(average, 'average')}, with {kind} in brackets."


def _verdict(margin: str) -> str:
    return (
        f"Verdict: better or worse where the interval lies beyond the margin of {margin}, equivalent where it lies "
        "within, size uncertain where it excludes 0 and reaches into the margin, inconclusive otherwise. "
        "Fails more: the method fails in more runs."
    )


def _failures(tables: Sequence[MetricTable]) -> str:
    """Name the failed runs of every method, and say how they count."""
    counts: dict[str, int] = {}
    for table in tables:
        for line in table.lines:
            counts[line.method] = counts.get(line.method, 0) + int(line.described["n_failed"])
    failed = [f"{_name(tables[0].trials, name)} {n}" for name, n in counts.items() if n]
    if not failed:
        return "No run failed."
    return f"Failed runs: {', '.join(failed)}; they are left out of averages, and count as worse than any finished run."


def _note_of_all(tables: Sequence[MetricTable]) -> str:
    """Define the columns of the table with a column per metric."""
    parts = [_mean(tables[0])]
    absent = [table.info.words for table in tables if table.may_not_occur]
    if absent and not tables[0].may_not_occur:
        parts.append(f"{capitalised(', '.join(absent))}: runs in which the event did not occur, of all finished ones.")
    parts.append(capitalised("; ".join(f"{table.info.words}: {BEST[table.info.direction]}" for table in tables)) + ".")
    return " ".join([*parts, _failures(tables)])


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"


def _name(trials: Trials, method: str) -> str:
    """Return the label of a method, which may have formulas."""
    return trials.labels.get(method, _plain(method))


def _plain(text: str) -> str:
    """Protect the dollar signs of a name."""
    return text.replace("$", r"\$")
