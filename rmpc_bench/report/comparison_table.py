"""The comparison of the methods with the baseline as a record: data frame, Markdown, plain data and text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from rmpc_bench.analysis.comparison import comparisons, levels
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.sentences import explanation, sentence
from rmpc_bench.report.summary import stacked
from rmpc_bench.report.tables import markdown_table
from rmpc_bench.types import DesignError
from rmpc_bench.types.texts import inert_markdown


@dataclass(frozen=True, eq=False)
class ComparisonTable:
    """Paired comparisons of methods with a baseline.

    Parameters
    ----------
    frame : sweep columns, then the columns `comparison.COLUMNS`; one row per metric and method
    sentences : each row as one sentence that can be quoted
    notes : what the columns mean: pairing, level of the intervals, relevant change
    """

    frame: pd.DataFrame
    sentences: tuple[str, ...]
    notes: tuple[str, ...]

    def to_frame(self) -> pd.DataFrame:
        """Return a copy of the table."""
        return self.frame.copy()

    def to_dict(self) -> list[dict[str, Any]]:
        """Return the rows as plain data; a missing number is None."""
        rows = self.frame.astype(object).where(self.frame.notna(), None)
        return [{str(name): value for name, value in row.items()} for row in rows.to_dict("records")]

    def to_markdown(self) -> str:
        """Return the table with its notes as Markdown, ending with a line end."""
        columns = {str(name): [_cell(value) for value in self.frame[name]] for name in self.frame.columns}
        return inert_markdown("\n".join([markdown_table(columns), "", *self.notes, ""]))

    def __str__(self) -> str:
        return "\n".join([*self.sentences, *self.notes])


def comparison_table(
    trials: Trials,
    *,
    metric: str | None = None,
    methods: Sequence[str] | None = None,
    baseline: str | None = None,
    relevant: float | None = None,
    confidence: float | None = None,
) -> ComparisonTable:
    """Compare methods with a baseline run by run, at every point of a sweep; see `rmpc_bench.compare`."""
    if confidence is not None and not 0 < confidence < 1:
        raise DesignError(f"must lie between 0 and 1 (got {confidence:g})", "confidence")
    if relevant is not None and not 0 <= relevant < 1:
        raise DesignError(f"must be at least 0 and below 1 (got {relevant:g})", "relevant")
    infos = {info.name: info for info in trials.metrics}
    chosen = trials.baseline if baseline is None else baseline
    for key, name, known in [
        ("metric", metric, infos),
        ("baseline", chosen, trials.methods),
        *(("methods", name, trials.methods) for name in methods or ()),
    ]:
        if name is not None and name not in known:
            raise DesignError(f"{name!r} is unknown (known: {', '.join(known)})", key)
    shown = trials.methods if methods is None else (chosen, *(name for name in methods if name != chosen))
    points = [
        replace(
            point,
            baseline=chosen,
            methods=tuple(name for name in shown if name in point.methods),
            metrics=trials.metrics if metric is None else (infos[metric],),
            relevant=trials.relevant if relevant is None else relevant,
            margins=trials.margins if relevant is None else {},
            confidence=trials.confidence if confidence is None else confidence,
        )
        for point in trials.each
    ]
    of = levels(replace(trials, points=tuple(points)) if trials.points else points[0])
    tables = [comparisons(point, of) for point in points]
    return ComparisonTable(
        frame=stacked(list(zip(points, tables, strict=True))),
        sentences=tuple(text for point, table in zip(points, tables, strict=True) for text in _sentences(point, table)),
        notes=(explanation(points[0]),),
    )


def _sentences(point: Trials, table: pd.DataFrame) -> list[str]:
    infos = {info.name: info for info in point.metrics}
    head = f"{point.title}: " if point.title else ""
    rows = table.to_dict("records")
    return [head + sentence(row, infos[row["metric"]], point) for row in rows]


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "" if value != value else f"{value:.4g}"
    return str(value)
