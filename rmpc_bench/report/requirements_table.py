"""Requirements and the runs that meet them: as Markdown, as sentences, and as a table for a paper."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from rmpc_bench.analysis.comparison_text import per_cent
from rmpc_bench.analysis.number_text import interval_text
from rmpc_bench.analysis.requirements import pass_rates
from rmpc_bench.analysis.rounding import rounded
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.labels import marked
from rmpc_bench.report.latex import Body, PaperTable, fitting_body, paper_table, row_label, stacked, title_of
from rmpc_bench.report.latex_text import number_latex, to_latex
from rmpc_bench.report.point_tables import PointSummary, markdown_page, markdown_table, stacked_points
from rmpc_bench.types.requirement import Requirement

REQUIREMENTS_NOTE = (
    "A failed run does not meet a requirement. Share: Wilson interval; difference in percentage points: paired score "
    "interval of Tango, which contains 0 where the exact McNemar test does not reject equal shares."
)


def requirement_columns(trials: Trials, frame: pd.DataFrame, *, plain: bool = False) -> dict[str, list[str]]:
    """Return head -> cells by the pass rates of one point; a plain table has no backticks around requirements."""
    rows = frame.to_dict("records")
    if not rows:
        return {}
    columns = {
        "requirement": [str(row["requirement"]) if plain else f"`{row['requirement']}`" for row in rows],
        "method": [row["method"] if plain else marked(trials, row["method"]) for row in rows],
        "runs that meet it": [f"{row['passed']} of {row['n']}" for row in rows],
        "share": [share_text(row) for row in rows],
        "miss it, at most (95 %)": [per_cent(row["miss_upper"]) for row in rows],
    }
    if len(trials.methods) > 1:
        columns[f"difference from {trials.baseline}"] = [difference_text(row) for row in rows]
        columns["met by the method only / by the baseline only"] = [
            "-" if row["method"] == row["baseline"] else f"{row['method_only']} / {row['baseline_only']}"
            for row in rows
        ]
    return columns


def share_text(row: Mapping[Hashable, Any]) -> str:
    """Write the share of runs that meet a requirement with its interval."""
    return interval_text(row["pass_pct"], row["pass_low"], row["pass_high"], unit="%", sign=False)


def difference_text(row: Mapping[Hashable, Any]) -> str:
    """Write the paired difference from the baseline in percentage points; "-" for the baseline."""
    values = (row["difference_pct"], row["difference_low"], row["difference_high"])
    return interval_text(*values, unit="points")


_SHARES = ["pass_pct", "pass_low", "pass_high", "miss_upper", "difference_pct", "difference_low", "difference_high"]

MOST_NAMED = 4  # methods that the screen names


@dataclass(frozen=True, eq=False)
class RequirementsTable:
    """Pass rates at every point of a sweep."""

    trials: Trials
    points: Sequence[tuple[Trials, pd.DataFrame]]  # each with its pass rates, see `rmpc_bench.analysis.requirements`

    @property
    def frame(self) -> pd.DataFrame:
        """Content of requirements.csv: sweep columns, then one row per requirement and method."""
        table = stacked_points(list(self.points))
        table[_SHARES] = rounded(table[_SHARES].to_numpy(dtype=float), 100.0)
        return table

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence per requirement and method that can be quoted as it stands."""
        return tuple(
            (f"{trials.title}: " if trials.title else "") + _sentence(trials, row)
            for trials, frame in self.points
            for row in frame.to_dict("records")
        )

    @property
    def gist(self) -> str:
        """In how many runs each method meets the first requirement; empty without one, or with several points."""
        known = [frame for _, frame in self.points if len(frame)]
        if len(known) != 1:
            return "requirements: tables/requirements.md" if known else ""
        first = known[0]["requirement"].iloc[0]
        rows = known[0][known[0]["requirement"] == first].to_dict("records")[:MOST_NAMED]
        others = known[0]["requirement"].nunique() > 1 or len(known[0]) > len(rows)
        met = ", ".join(f"{row['passed']} ({row['method']})" for row in rows)
        return f"{first} in {met} of {rows[0]['n']} runs{': tables/requirements.md' * others}"

    def to_markdown(self) -> str:
        """Return a table per point; empty without requirements."""
        parts = []
        for trials, frame in self.points:
            if len(frame):
                parts += [f"# {trials.title}"] * bool(trials.title)
                parts.append(markdown_table(requirement_columns(trials, frame)))
        return markdown_page([*parts, REQUIREMENTS_NOTE] if parts else [])

    def __str__(self) -> str:
        return "\n".join(self.sentences)


def requirements_table(trials: Trials) -> RequirementsTable:
    """Count the runs that meet each requirement at every point of a sweep."""
    return RequirementsTable(trials, [(point, pass_rates(point)) for point in trials.each])


def _sentence(trials: Trials, row: Mapping[Hashable, Any]) -> str:
    failed = f", {row['n_failed']} of them failed" if row["n_failed"] else ""
    met = f"meets {row['requirement']} in {row['passed']} of {row['n']} runs"
    start = f"{row['method']} {met} ({share_text(row)}{failed})"
    gap = difference_text(row)
    if gap == "-":
        return f"{start}."
    return f"{start}: {gap} against {trials.baseline} ({row['n_pairs']} paired runs)."


REQUIREMENTS = "requirements"  # name of the table


def latex_requirements(points: Sequence[PointSummary], comments: Sequence[str], width: float) -> dict[str, PaperTable]:
    """Return name -> table of requirements for a paper; empty without requirements."""
    tables = [point.trials for point in points if point.trials.requirements]
    if not tables:
        return {}
    body = fitting_body([_body(tables, short=short) for short in (False, True)], width)
    return {REQUIREMENTS: paper_table(REQUIREMENTS, body, _caption(tables), _note(tables[0], tables), comments)}


def _caption(tables: Sequence[Trials]) -> str:
    where = f" at {len(tables)} points of a sweep" if len(tables) > 1 else ""
    named = ", ".join(dict.fromkeys(_named(trials, each) for trials in tables for each in trials.requirements))
    return f"Runs that pass, which is to have {named}; {len(tables[0].runs)} runs per method{where}."


def _note(first: Trials, tables: Sequence[Trials]) -> str:
    """Define the columns."""
    level = f"{100 * first.confidence:g} %"
    sentences = [f"Share: with its {level} interval of Wilson in brackets."]
    if len(first.methods) > 1:
        base = first.labels.get(first.baseline, first.baseline.replace("$", r"\$"))
        sentences.append(f"Each run is paired with the run of {base} that has the same random numbers.")
        what = f"share minus that of {base} in percentage points"
        sentences.append(f"Difference: {what}, with the paired {level} score interval.")
    failed = {name: sum(trials.n_failed(name) for trials in tables) for name in first.methods}
    counts = ", ".join(f"{first.labels.get(name, name)} {n}" for name, n in failed.items() if n)
    return " ".join([*sentences, f"Failed runs: {counts}; they do not pass." if counts else "No run failed."])


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
                texts = [f"{row['passed']}/{row['n']}", share_text(row).replace(" %", "", 1)]
                texts += [difference_text(row).replace(" points", "", 1)] if paired else []
                rows.append([row_label(trials, row["method"], short=short), *map(number_latex, texts)])
            title = ", ".join(filter(None, [title_of(trials), to_latex(_named(trials, requirement))]))
            groups.append((title, rows))
    return Body(head, groups)
