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
from rmpc_bench.report.latex import WIDTH, Body, row_label, shown_points, stacked, title_of, written_table
from rmpc_bench.report.latex_text import number_latex, to_latex
from rmpc_bench.report.point_tables import Points, markdown_page, markdown_table, stacked_points
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
        columns["met by the method only / by the baseline only"] = [_alone(row) for row in rows]
    return columns


def share_text(row: Mapping[Hashable, Any]) -> str:
    """Write the share of runs that meet a requirement with its interval."""
    return interval_text(row["pass_pct"], row["pass_low"], row["pass_high"], unit="%", sign=False)


def difference_text(row: Mapping[Hashable, Any]) -> str:
    """Write the paired difference from the baseline in percentage points; "-" for the baseline."""
    values = (row["difference_pct"], row["difference_low"], row["difference_high"])
    return interval_text(*values, unit="points")


def _alone(row: Mapping[Hashable, Any]) -> str:
    same = row["method"] == row["baseline"]
    return "-" if same else f"{row['method_only']} / {row['baseline_only']}"


_SHARES = ["pass_pct", "pass_low", "pass_high", "miss_upper", "difference_pct", "difference_low", "difference_high"]

MOST_NAMED = 4
"""Methods that the screen names."""


@dataclass(frozen=True, eq=False)
class RequirementsTable:
    """Pass rates at every point of a sweep.

    Parameters
    ----------
    trials : the table of trials
    points : table of each point and its pass rates, see `rmpc_bench.analysis.requirements`
    """

    trials: Trials
    points: Sequence[tuple[Trials, pd.DataFrame]]

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
        parts += [REQUIREMENTS_NOTE] if parts else []
        return markdown_page(parts)

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


REQUIREMENTS = "requirements"
"""Name of the table."""


def latex_requirements(summary: Points, comments: Sequence[str] = (), width: float = WIDTH) -> dict[str, str]:
    """Return name -> LaTeX of the table of requirements, with comments at its head; empty without requirements.

    Where it is wider than the width in footnotesize [pt], labels are broken into lines.
    """
    tables = _tables(summary)
    if not tables:
        return {}
    body = _body(tables, short=False)
    body = body if body.width <= width else _body(tables, short=True)
    return {REQUIREMENTS: written_table(body, comments, REQUIREMENTS)}


def requirements_caption(summary: Points) -> dict[str, str]:
    """Return name -> LaTeX of the caption of the table; empty without requirements."""
    sentences = _paper_sentences(summary)
    return {REQUIREMENTS: f"{to_latex(sentences[0])}%\n"} if sentences else {}


def requirements_note(summary: Points) -> dict[str, str]:
    """Return name -> LaTeX of the note below the table, which defines its columns; empty without requirements."""
    text = " ".join(_paper_sentences(summary)[1:])
    return {REQUIREMENTS: f"{to_latex(text)}%\n"} if text else {}


def _paper_sentences(summary: Points) -> list[str]:
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


def _tables(summary: Points) -> list[Trials]:
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
                texts = [f"{row['passed']}/{row['n']}", share_text(row).replace(" %", "", 1)]
                texts += [difference_text(row).replace(" points", "", 1)] if paired else []
                rows.append([row_label(trials, row["method"], short=short), *map(number_latex, texts)])
            title = ", ".join(filter(None, [title_of(trials), to_latex(_named(trials, requirement))]))
            groups.append((title, rows))
    return Body(head, groups)
