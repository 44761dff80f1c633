"""Tables of one experiment, or one point of a sweep, as a page in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from rmpc_bench.analysis.comparison_text import far_worse_bound, margin_text
from rmpc_bench.analysis.parameter_text import parameter_cells, parameter_legend
from rmpc_bench.analysis.requirements import pass_rates
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report import cells
from rmpc_bench.report.cells import MetricTable, metric_table
from rmpc_bench.report.lost_cells import lost_cells, lost_text, shows_lost
from rmpc_bench.report.requirement_cells import REQUIREMENTS_NOTE, requirement_columns
from rmpc_bench.report.run_notes import failed_cells, held_cells, notes_markdown
from rmpc_bench.report.sentences import AVERAGES, explanation, sentence
from rmpc_bench.report.worst_runs import worst_runs_columns
from rmpc_bench.types import MetricInfo, Status
from rmpc_bench.types.texts import inert_markdown

BEST = {"zero": "best at 0", "one": "best at 1"}


def summary_markdown(trials: Trials, summary: pd.DataFrame, comparisons: pd.DataFrame) -> str:
    """Write the page of tables: per metric a table and its sentences, then the worst and the failed runs."""
    runs, level = len(trials.runs), 100 * trials.confidence
    name = f"{trials.name}: {' '.join(trials.title.split())}" if trials.title else trials.name
    size = f"{_count(runs, 'run')} per method, seed {trials.seed}, intervals at {level:g} %."
    parts = [f"# {name}", f"One run of each method at each of {runs} points, all there are." if trials.alike else size]
    for info in trials.metrics:
        table = metric_table(trials, summary, comparisons, info)
        parts.append(f"## {quantity(info)}, {BEST.get(info.direction, info.direction + ' is better')}")
        parts.append(markdown_table(metric_columns(table)))
        below = legend(table, on_screen=False)
        parts += ["\n".join(below)] if below else []
        rows = [line.compared for line in table.lines if line.compared]
        if rows and trials.with_verdicts:
            parts.append("\n".join(f"- {sentence(row, info, trials)}" for row in rows))
    if len(trials.methods) > 1 and trials.with_verdicts:
        parts.append(explanation(trials))
    demanded = requirement_columns(trials, pass_rates(trials))
    parts += ["## Requirements", markdown_table(demanded), REQUIREMENTS_NOTE] if demanded else []
    worst = worst_runs_columns(trials)
    parts += ["## Worst runs", markdown_table(worst)] if worst else []
    for head, lines in (
        ("Failed runs", status_lines(trials)),
        ("Checks that are meant to fail", declared_lines(trials)),
    ):
        parts += [f"## {head}", "\n".join(lines)] if lines else []
    return inert_markdown("\n\n".join([*parts, *notes_markdown(trials)])) + "\n"


def metric_columns(table: MetricTable) -> dict[str, list[str]]:
    """Return the columns of the table of one metric, head -> cells."""
    trials, lines = table.trials, table.lines
    columns = {"method": [line.shown for line in lines]}
    labels = [trials.labels.get(line.method, line.method) for line in lines]
    if labels != columns["method"]:
        columns["label"] = labels
    if words := parameter_cells(trials, [line.method for line in lines]):
        columns["parameters"] = words
    columns["did not occur" if table.may_not_occur else "mean"] = cells.means(table)
    if lost := lost_cells(table):
        columns["lost"] = lost
    columns["median [quartiles]"] = cells.medians(table)
    if table.with_comparisons and trials.with_verdicts:
        average, other = cells.average_of(table), cells.other_average(table)
        columns[cells.change_head(table, average)] = cells.changes(table)
        if other:
            columns[cells.change_head(table, other)] = cells.changes(table, other)
        columns["won/lost/tied"] = cells.counts(table)
        columns["superiority"] = cells.superiorities(table)
        columns["p"] = cells.p_values(table)
        found = cells.verdicts(table)
        columns |= {"verdict": [word or "-" for word in found]} if any(found) else {}
    columns["n/n_failed"] = cells.sizes(table)
    if held := held_cells(trials, [line.method for line in table.lines]):
        columns["held steps"] = held
    if failed := failed_cells(trials, [line.method for line in table.lines]):
        columns["failed steps"] = failed
    if table.with_failed and table.with_comparisons:
        columns["pairs"] = cells.pairs(table)
    return columns


def markdown_table(columns: Mapping[str, Sequence[str]]) -> str:
    """Lay out columns, head -> cells, as a Markdown table without a line end."""
    rows = [list(columns), *([*row] for row in zip(*columns.values(), strict=True))]
    texts = ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]
    return "\n".join([texts[0], "|" + " --- |" * len(columns), *texts[1:]])


def _cell(text: str) -> str:
    return inert_markdown(text.replace("\n", " ")).replace("|", r"\|")


def legend(table: MetricTable, *, on_screen: bool) -> list[str]:
    """Say what the columns and brackets mean, with those of the first row that has any."""
    trials, compared = table.trials, [line.compared for line in table.lines if line.compared]
    parts = _legend_of_pairs(table, compared, on_screen=on_screen) if compared and trials.with_verdicts else []
    bracket = next((text[text.index("(") : text.index(")") + 1] for text in cells.means(table) if "(" in text), "")
    if bracket and not table.may_not_occur:
        parts.append(f"{bracket} = standard error of the last digits")
    parts += [lost_text(trials)] if shows_lost(table) else []
    parts += parameter_legend(trials) if compared and trials.with_verdicts else []
    if any(line.shown != line.method for line in table.lines):
        parts.append("an oracle knows the true parameters")
    return ["; ".join(parts)] if parts else []


def _legend_of_pairs(table: MetricTable, compared: Sequence[Mapping[str, object]], *, on_screen: bool) -> list[str]:
    """Say how many pairs there are, what the change is, how its interval holds, and what is tied."""
    trials, info = table.trials, table.info
    numbers = sorted({int(str(row["n_pairs"])) for row in compared})
    pairs = str(numbers[0]) if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
    parts = [f"{pairs} paired runs"]
    average = cells.average_of(table)
    level = f"{100 * trials.confidence:g} % interval"
    simultaneous = info == trials.primary_info and any(
        float(str(row["ci_level"])) > trials.confidence for row in compared
    )
    level = f"simultaneous {level}s of all comparisons" if simultaneous else level
    if average in AVERAGES:
        parts.append(f"change = {AVERAGES[average]}, {level}" if on_screen else level)
    elif average:
        parts.append(f"mean difference, {level}")
    if info.direction in BEST:
        sizes = "the magnitudes" if info.direction == "zero" else "max(value, 1/value)"
        parts.append(f"comparisons are those of {sizes}")
    parts += [trials.planned.text] if trials.planned is not None else []
    looks = max(int(str(row["look"])) for row in compared)
    parts += [f"look {looks} at a growing number of runs, with wider intervals"] if looks > 1 else []
    margin = margin_text(trials, info, next((row for row in compared if row["average"]), None))
    parts.append("tied = equal" if margin.split()[0] == "0" else f"tied = within {margin}")
    return [*parts, *filter(None, [far_worse_bound(compared, trials, info)])]


def status_lines(trials: Trials) -> list[str]:
    """List the failed runs by method and status; nothing where all runs ended well."""
    failed = trials.frame.loc[trials.frame["status"] != Status.OK.word, ["method", "status"]]
    counts = failed.value_counts().to_dict()
    rows = []
    for method in trials.methods:
        for word in sorted({word for name, word in counts if name == method}):
            status = Status.__members__.get(word.upper().replace("-", "_"))
            meaning = f": {status.explanation}" if status is not None else ""
            rows.append(f"- {method}: {_count(counts[method, word], 'run')} {word}{meaning}")
    return rows


def declared_lines(trials: Trials) -> list[str]:
    """List the checks that own components declare to fail, with the reason."""
    return [
        f"- {method}: `{check}` ({reason})"
        for method in trials.methods
        for check, reason in trials.expected_failures.get(method, {}).items()
    ]


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def quantity(info: MetricInfo) -> str:
    """Write a metric with its unit."""
    name = f"{info.label} ({info.name})" if info.label else info.name
    return f"{name} [{info.unit}]" if info.unit else name
