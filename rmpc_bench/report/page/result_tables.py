"""The tables of a page: every metric at every point of a sweep, or what fits on a page of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rmpc_bench.analysis.comparison_text import margin_text, size_text, verdict_text
from rmpc_bench.analysis.parameter_text import parameter_legend
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.cells import metric_table
from rmpc_bench.report.ensemble_table import ensemble_rows
from rmpc_bench.report.lost_cells import lost_text
from rmpc_bench.report.page.blocks import Block, Text, bullets, code, folded, heading, table
from rmpc_bench.report.page.headline import shown_metric
from rmpc_bench.report.point_summary import PointSummary
from rmpc_bench.report.run_notes import STEP_TIMES, step_times
from rmpc_bench.report.sentences import explanation, sentence
from rmpc_bench.report.summary import MOST_ON_SCREEN, Summary
from rmpc_bench.report.tables import BEST, legend, metric_columns, quantity
from rmpc_bench.types import MetricInfo

SUPPORTING = ("won/lost/tied", "superiority", "p", "n/n_failed", "held steps", "failed steps", "pairs")
"""Columns behind the verdict."""
OF_SWEEP = ("method", "parameters", "mean", "did not occur", "lost", "median [quartiles]")
"""Columns of the table of a large sweep before that of the change."""
MOST_OPEN = 3
"""Tables besides that of the primary metric that are not folded."""
MOST_OPEN_ROWS = 60
"""Rows of the table of a sweep that is not folded."""
MOST_ROWS = 200
"""Rows of the table of a large sweep."""


def result_blocks(tables: Summary, methods: Sequence[str]) -> list[Block]:
    """Return the tables: of all metrics at a few points; of a large sweep the primary metric at its first points.

    A row can be hidden by the place of its method among all methods of the experiment.
    """
    points = [point for point in tables.points if len(point.trials.frame)]
    blocks: list[Block] = []
    if tables.pooled is not None:
        title = heading(f"All {len(tables.points)} points of the sweep together")
        blocks += [title, *_point_blocks(tables.pooled, methods)]
    if len(points) > MOST_ON_SCREEN:
        blocks += _sweep_blocks(points, methods)
    else:
        for point in points:
            blocks += [heading(point.trials.title)] if point.trials.title else []
            blocks += _point_blocks(point, methods)
    blocks += [block for point in tables.points[:MOST_ON_SCREEN] for block in _ensemble(point.trials)]
    first = tables.points[0].trials
    if points and len(first.methods) > 1 and first.with_verdicts:
        blocks += folded("How to read these tables, and sentences to quote", _reading(tables, points))
    return blocks


def _point_blocks(point: PointSummary, methods: Sequence[str]) -> list[Block]:
    """Return the table of the primary metric, then those of the others, folded where they are many."""
    primary = shown_metric(point.trials)
    names = list(point.trials.methods)
    times = step_times(point.trials, names)
    others = [info for info in point.trials.metrics if info != primary]
    first = [] if primary is None else [_metric_block(point, primary, methods, dict(zip(names, times, strict=False)))]
    rest = [_metric_block(point, info, methods) for info in others]
    if len(rest) <= MOST_OPEN and not point.trials.title:
        return [*first, *rest]
    folded_names = ", ".join(info.name for info in others)
    return [*first, *folded(f"Other metrics: {folded_names}", rest)]


def _metric_block(
    point: PointSummary, info: MetricInfo, methods: Sequence[str], times: Mapping[str, str] | None = None
) -> Block:
    trials = point.trials
    of = metric_table(trials, point.described, point.compared, info)
    columns: dict[str, Sequence[Text]] = {**metric_columns(of)}
    if times:
        # Beside the accuracy: the columns after the verdict are outside of a window of the usual width.
        after = list(columns).index("median [quartiles]") + 1
        every = [*columns.items()]
        every.insert(after, ("time per step", [times[line.method] for line in of.lines]))
        columns = dict(every)
    # What a reader looks for comes before what supports it.
    supporting = {head: columns.pop(head) for head in SUPPORTING if head in columns}
    columns |= supporting
    labels = columns.pop("label", None)
    if labels is not None:
        columns["method"] = [_named(name, label) for name, label in zip(columns["method"], labels, strict=True)]
    numbers = [methods.index(line.method) for line in of.lines]
    best = BEST.get(info.direction, f"{info.direction} is better")
    caption = f"{quantity(info)}, {best}"
    notes = [*legend(of, on_screen=False), *([STEP_TIMES] if times else [])]
    return table(caption, columns, methods=numbers, metric=info.name, notes=[*notes])


def _named(name: Text, label: Text) -> Text:
    """Write the label, with the name in front where the label does not begin with it."""
    if not (isinstance(name, str) and isinstance(label, str)):
        return name
    return label if label.startswith(name) else f"{name}: {label}"


def _sweep_blocks(points: Sequence[PointSummary], names: Sequence[str]) -> list[Block]:
    """Return one table of the primary metric with a row per point and method; summary.csv has all numbers."""
    info = shown_metric(points[0].trials)
    if info is None:
        return []
    columns: dict[str, list[Text]] = {}
    methods: list[int | None] = []
    n_rows = sum(len(point.trials.methods) for point in points)
    for point in points:
        of = metric_table(point.trials, point.described, point.compared, info)
        found = metric_columns(of)
        found.pop("label", None)
        if methods and len(methods) + len(of.lines) > MOST_ROWS:
            break
        methods += [names.index(line.method) for line in of.lines]
        columns.setdefault("point", []).extend([point.trials.title] * len(of.lines))
        for head in (*OF_SWEEP, _change_column(found), "verdict"):
            if head in found:
                before: list[Text] = [""] * (len(methods) - len(of.lines))
                columns.setdefault(head, before).extend(found[head])
        for texts in columns.values():
            texts += [""] * (len(methods) - len(texts))
    left = n_rows - len(methods)
    more: list[Text] = [[f"{left} more rows are in ", code("summary.csv"), " and ", code("comparisons.csv"), "."]]
    words = [lost_text(points[0].trials)] if "lost" in columns else []
    words += parameter_legend(points[0].trials) if points[0].trials.with_verdicts else []
    shown = table(
        f"{quantity(info)} at {'the first' if left else 'all'} points of the sweep",
        columns,
        methods=methods,
        metric=info.name,
        notes=[*(more if left else []), *(["; ".join(words)] if words else [])],
    )
    return (
        [shown] if n_rows <= MOST_OPEN_ROWS else folded(f"The {len(points)} points of the sweep, one by one", [shown])
    )


def _change_column(columns: Mapping[str, Sequence[str]]) -> str:
    """Name the first column of changes; empty where nothing is compared."""
    return next((head for head in columns if " vs " in head or head.startswith("difference from")), "")


def _ensemble(trials: Trials) -> list[Block]:
    rows = ensemble_rows(trials)
    if not rows:
        return []
    heads = [head or "basis" for head in rows[0]]
    columns = {head: [row[place] for row in rows[1:]] for place, head in enumerate(heads)}
    columns = {"method": columns.pop(heads[0]), **columns}
    where = f" ({trials.title})" if trials.title else ""
    notes = ["Bias, variance and reported covariance by component."]
    return [table(f"Error at the end{where}", {**columns}, notes=[*notes])]


def _reading(tables: Summary, points: Sequence[PointSummary]) -> list[Block]:
    """Explain the columns, and give each comparison of the primary metric as a sentence."""
    sentences: list[Text] = []
    for point in points[:MOST_ON_SCREEN]:
        head = f"{point.trials.title}: " if point.trials.title else ""
        infos = {info.name: info for info in point.trials.metrics}
        rows: list[Mapping[Any, Any]] = [*point.compared.to_dict("records")] if len(point.compared) else []
        primary = shown_metric(point.trials)
        sentences += [
            head + sentence(row, infos[row["metric"]], point.trials)
            for row in rows
            if primary is not None and row["metric"] == primary.name and row["method"] in point.trials.methods
        ]
    return [*bullets([explanation(tables.points[0].trials)]), *bullets(sentences)]


def inconclusive(tables: Summary) -> list[str]:
    """Name the comparisons of the primary metric that are inconclusive, with the runs that would decide."""
    found = []
    for point in tables.points:
        info = point.trials.primary_info
        rows: list[Mapping[Any, Any]] = [*point.compared.to_dict("records")] if len(point.compared) else []
        for row in rows:
            if info is None or row["metric"] != info.name or row["verdict"] != "inconclusive":
                continue
            where = f" at {point.trials.title}" if point.trials.title else ""
            word = verdict_text(row, margin_text(point.trials, info, row))
            found.append(f"{row['method']}{where}: {size_text(row, info)}, {word}")
    return found
