"""Tables of one experiment, or one point of a sweep, as a page in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from rmpc_bench.analysis.requirements import pass_rates
from rmpc_bench.analysis.result_rows import result_table
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.page.notes import note_of
from rmpc_bench.report.page.rows import rows_of
from rmpc_bench.report.requirement_cells import REQUIREMENTS_NOTE, requirement_columns
from rmpc_bench.report.run_notes import notes_markdown
from rmpc_bench.report.worst_runs import worst_runs_columns
from rmpc_bench.types import MetricInfo, Status
from rmpc_bench.types.texts import inert_markdown

BEST = {"zero": "best at 0", "one": "best at 1"}


def summary_markdown(trials: Trials, summary: pd.DataFrame, comparisons: pd.DataFrame) -> str:
    """Write the page of tables: per metric all columns of the page, then the worst and the failed runs."""
    n, level = len(trials.runs), 100 * trials.confidence
    name = f"{trials.name}: {' '.join(trials.title.split())}" if trials.title else trials.name
    size = f"{_count(n, 'run')} per method, seed {trials.seed}, intervals at {level:g} %."
    parts = [f"# {name}", f"One run of each method at each of {n} points, all there are." if trials.alike else size]
    for info in trials.metrics:
        table = result_table(trials, summary, comparisons, info)
        rows = rows_of(table, everything=True)
        parts.append(f"## {quantity(info)}, {BEST.get(info.direction, info.direction + ' is better')}")
        parts += filter(None, [markdown_table(rows.columns), note_of([table], n, rows)])
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


def markdown_table(columns: Mapping[str, Sequence[str]]) -> str:
    """Lay out columns, head -> cells, as a Markdown table without a line end."""
    rows = [list(columns), *([*row] for row in zip(*columns.values(), strict=True))]
    texts = ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]
    return "\n".join([texts[0], "|" + " --- |" * len(columns), *texts[1:]])


def _cell(text: str) -> str:
    return inert_markdown(text.replace("\n", " ")).replace("|", r"\|")


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
