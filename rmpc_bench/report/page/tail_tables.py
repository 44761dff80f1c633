"""Worst runs and requirements on a page: what stands beside the means."""

from __future__ import annotations

from collections.abc import Sequence

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.page.blocks import Block, code, folded, paragraph, table
from rmpc_bench.report.page.headline import shown_metric
from rmpc_bench.report.point_summary import PointSummary
from rmpc_bench.report.requirement_cells import REQUIREMENTS_NOTE, requirement_columns
from rmpc_bench.report.requirements_table import RequirementsTable
from rmpc_bench.report.summary import MOST_ON_SCREEN, Summary
from rmpc_bench.report.worst_runs import worst_runs_columns
from rmpc_bench.types import MetricInfo

TAILS_NOTE = (
    "95 % quantile: interval between order statistics. Mean of the worst 5 % of the runs (CVaR): bootstrap interval of "
    "whole runs. Failed runs are in neither; below 72 runs there is no interval."
)


def tail_blocks(tables: Summary, methods: Sequence[str]) -> list[Block]:
    """Return the worst runs in the primary metric, and folded those in the other metrics and at more points.

    A row can be hidden by the place of its method among all methods of the experiment.
    """
    points = [point for point in tables.points[:MOST_ON_SCREEN] if len(point.trials.frame)]
    found = [each for point in points if (each := _tables(point, methods))]
    if not found:
        return []
    (first, *others), rest = found[0], [block for each in found[1:] for block in each]
    blocks = [first, paragraph(TAILS_NOTE, "note"), *folded("Worst runs in the other metrics", others)]
    left = len(tables.points) - len(points)
    more = [paragraph([f"{left} more points are in ", code("tables/summary.md"), "."], "note")] if left else []
    return [*blocks, *folded("Worst runs at more points of the sweep", [*rest, *more] if rest else [])]


def _tables(point: PointSummary, methods: Sequence[str]) -> list[Block]:
    """Return a table per metric, that of the primary one first; nothing with few runs."""
    primary = shown_metric(point.trials)
    infos = sorted(point.trials.metrics, key=lambda info: info != primary)
    return [block for info in infos if (block := _table(point.trials, info, methods))]


def _table(trials: Trials, info: MetricInfo, methods: Sequence[str]) -> Block | None:
    columns = worst_runs_columns(trials, [info])
    if not columns:
        return None
    quantity = columns.pop("metric")[0]
    where = f" ({trials.title})" if trials.title else ""
    numbers = [methods.index(name) for name in trials.methods]
    return table(f"Worst runs, {quantity}{where}", {**columns}, methods=numbers, metric=info.name)


def requirement_blocks(requirements: RequirementsTable | None, methods: Sequence[str]) -> list[Block]:
    """Return how many runs meet the requirements, at the first points of a sweep; nothing if not known.

    A row can be hidden by the place of its method among all methods of the experiment.
    """
    points = [] if requirements is None else requirements.points
    blocks: list[Block] = []
    for trials, frame in points[:MOST_ON_SCREEN]:
        if len(frame):
            where = f" ({trials.title})" if trials.title else ""
            numbers = [methods.index(name) for name in frame["method"]]
            # Backticks mark code in Markdown only; a cell of the page is plain text.
            columns = requirement_columns(trials, frame) | {"requirement": [*map(str, frame["requirement"])]}
            blocks.append(table(f"Runs that meet the requirements{where}", {**columns}, methods=numbers))
    if not blocks:
        return []
    left = len(points) - MOST_ON_SCREEN
    more = [paragraph([f"{left} more points are in ", code("requirements.csv"), "."], "note")] if left > 0 else []
    note = paragraph(REQUIREMENTS_NOTE, "note")
    return [blocks[0], *folded("Requirements at more points of the sweep", [*blocks[1:], *more]), note]
