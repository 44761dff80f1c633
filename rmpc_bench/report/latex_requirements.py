"""The table of requirements for a paper: how many runs meet them, as LaTeX with its caption."""

from __future__ import annotations

from collections.abc import Sequence

from rmpc_bench.analysis.requirements import pass_rates
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.latex import WIDTH, Body, row_label, shown_points, title_of, written_table
from rmpc_bench.report.latex_columns import GAP, stacked
from rmpc_bench.report.latex_numbers import number_latex
from rmpc_bench.report.latex_text import to_latex
from rmpc_bench.report.latex_width import table_width
from rmpc_bench.report.requirement_cells import difference, share
from rmpc_bench.report.summary import Summary
from rmpc_bench.types.requirement import Requirement

REQUIREMENTS = "requirements"
"""Name of the table."""


def latex_requirements(summary: Summary, comments: Sequence[str] = (), width: float = WIDTH) -> dict[str, str]:
    """Return name -> LaTeX of the table of requirements, with comments at its head; empty without requirements.

    Where it is wider than the width in footnotesize [pt], labels are broken into lines.
    """
    tables = _tables(summary)
    if not tables:
        return {}
    bodies = (_body(tables, short=short) for short in (False, True))
    body = next((each for each in bodies if _width(each) <= width), _body(tables, short=True))
    return {REQUIREMENTS: written_table(body, comments, REQUIREMENTS)}


def requirements_caption(summary: Summary) -> dict[str, str]:
    """Return name -> LaTeX of the caption of the table; empty without requirements."""
    sentences = _sentences(summary)
    return {REQUIREMENTS: f"{to_latex(sentences[0])}%\n"} if sentences else {}


def requirements_note(summary: Summary) -> dict[str, str]:
    """Return name -> LaTeX of the note below the table, which defines its columns; empty without requirements."""
    text = " ".join(_sentences(summary)[1:])
    return {REQUIREMENTS: f"{to_latex(text)}%\n"} if text else {}


def _sentences(summary: Summary) -> list[str]:
    """Say what the table shows, then define its columns; empty without requirements."""
    tables = _tables(summary)
    if not tables:
        return []
    first, points = tables[0], {id(trials) for trials in tables}
    n, level = len(first.runs), f"{100 * first.confidence:g} %"
    where = f" at {len(points)} points of a sweep" if len(points) > 1 else ""
    named = ", ".join(dict.fromkeys(_named(trials, each) for trials in tables for each in trials.requirements))
    sentences = [f"Runs that pass, which is to have {named}; {n} runs per method{where}."]
    sentences.append(f"Share: with its {level} interval of Wilson in brackets.")
    if len(first.methods) > 1:
        baseline = first.labels.get(first.baseline, first.baseline.replace("$", r"\$"))
        sentences.append(f"Each run is paired with the run of {baseline} that has the same random numbers.")
        sentences.append(
            f"Difference: share minus that of {baseline} in percentage points, with the paired {level} score interval."
        )
    failed = {name: sum(trials.n_failed(name) for trials in tables) for name in first.methods}
    counts = ", ".join(f"{first.labels.get(name, name)} {n}" for name, n in failed.items() if n)
    sentences.append(f"Failed runs: {counts}; they do not pass." if counts else "No run failed.")
    return sentences


def _tables(summary: Summary) -> list[Trials]:
    return [point.trials for point in shown_points(summary) if point.trials.requirements]


def _named(trials: Trials, requirement: Requirement) -> str:
    """Write a requirement with the unit of its metric."""
    units = {info.name: info.unit for info in trials.metrics}
    return f"{requirement.text} {units.get(requirement.metric, '')}".rstrip().replace("$", r"\$")


def _body(tables: Sequence[Trials], *, short: bool) -> Body:
    """Lay out a group of rows per point and requirement."""
    paired = len(tables[0].methods) > 1
    head = ["Method", "Pass", stacked(["Share", r"[\%]"]), *([stacked(["Difference", "[points]"])] if paired else [])]
    groups = []
    for trials in tables:
        rates = pass_rates(trials)
        for requirement in trials.requirements:
            rows = []
            for row in rates[rates["requirement"] == requirement.text].to_dict("records"):
                texts = [f"{row['passed']}/{row['n']}", share(row).replace(" %", "", 1)]
                texts += [difference(row).replace(" points", "", 1)] if paired else []
                rows.append([row_label(trials, row["method"], short=short), *map(number_latex, texts)])
            title = ", ".join(filter(None, [title_of(trials), to_latex(_named(trials, requirement))]))
            groups.append((title, rows))
    return Body(head, groups)


def _width(body: Body) -> float:
    return table_width(body.head, [row for _, rows in body.groups for row in rows], GAP)
