"""The tables of a whole experiment: of one point, or of every point of a sweep below each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from rmpc_bench.analysis import statistics
from rmpc_bench.analysis.comparison import Levels, comparisons, levels
from rmpc_bench.analysis.trials import Trials, stacked_rows
from rmpc_bench.report.csv_file import write_csv
from rmpc_bench.report.ensemble_table import ensemble_markdown
from rmpc_bench.report.latex import ALL_METRICS, WIDTH, latex_tables
from rmpc_bench.report.point_summary import PointSummary
from rmpc_bench.report.tables import summary_markdown
from rmpc_bench.types import DesignError
from rmpc_bench.types.issue import unknown
from rmpc_bench.types.report_choices import Column

MOST_ON_SCREEN = 6
"""Points of a sweep of single runs that are shown one by one; of more the runs of all points are taken together."""


def trials_csv(trials: Trials, path: Path) -> None:
    """Write the table of trials with the sweep columns, `method, run, status` and one column per metric.

    Where a component may hold failed steps, `held_steps` follows the status.  Where a controller optimises and goes on
    after a failed step, `failed_steps` and `worst_step` follow, the worst status of the steps of the run.
    """
    metrics = (info.name for info in trials.metrics)
    columns = [*trials.paths, "method", "run", "status"]
    steps = _step_columns(trials)
    write_csv(trials.frame.assign(**steps)[[*columns, *steps, *metrics]], path)


def _step_columns(trials: Trials) -> dict[str, list[Any]]:
    """Return the columns on held and on failed steps, each where a method may have such steps."""
    notes = [table.notes.get(method) for table in trials.each for method in table.frame["method"]]
    known = list(zip((run for table in trials.each for run in table.frame["run"]), notes, strict=True))
    columns: dict[str, list[Any]] = {}
    if any(each.holds for table in trials.each for each in table.notes.values()):
        columns["held_steps"] = [each.held.get(run, 0) if each else 0 for run, each in known]
    if any(each.optimises for table in trials.each for each in table.notes.values()):
        columns["failed_steps"] = [each.n_failed_of(run) if each else 0 for run, each in known]
        columns["worst_step"] = [each.worst_step_of(run) if each else "ok" for run, each in known]
    return columns


MOST_PAGES = 50
"""Points of a sweep that get a page in tables/summary.md; summary.csv has all."""


class Summary(NamedTuple):
    """A table of trials with its statistics, point by point."""

    points: Sequence[PointSummary]
    pooled: PointSummary | None = None
    """The runs of all points together, where the points are many plants with the same methods."""

    @property
    def described(self) -> pd.DataFrame:
        """Sweep columns, then one row per method and metric."""
        return stacked([(point.trials, point.described) for point in self.points])

    @property
    def compared(self) -> pd.DataFrame:
        """Sweep columns, then one row per comparison with the baseline."""
        return stacked([(point.trials, point.compared) for point in self.points])

    def shown(self, order: Sequence[str] | None = None, metrics: Sequence[str] | None = None) -> Summary:
        """Return the same statistics with fewer or reordered methods and metrics in the tables.

        Parameters
        ----------
        order : methods to show; all if None
        metrics : names of the metrics to show; all if None
        """
        points = [_reordered(point, order, metrics) for point in self.points]
        return Summary(points, self.pooled and _reordered(self.pooled, order, metrics))

    def to_markdown(self) -> str:
        """Return the pages of tables: of all points together where there are many, and of each."""
        pages = [self.pooled] if self.pooled else []
        tables = [summary_markdown(*page) for page in [*pages, *self.points[:MOST_PAGES]] if len(page.trials.frame)]
        tables += [text for point in self.points[:MOST_PAGES] if (text := ensemble_markdown(point.trials))]
        return "\n".join(tables)

    def to_latex(
        self, metric: str | None = None, *, columns: Sequence[Column] | None = None, width: float = WIDTH
    ) -> str:
        """Return a table for a paper: a body for the package booktabs, without a float.

        Parameters
        ----------
        metric : name of the metric; the primary one if None; ``all-metrics`` for the means of all of them
        columns : columns behind the name of the method; the usual ones that fit if None
        width : of a column of the paper, to which the usual columns are limited [pt, of which an inch has 72.27]

        Raises
        ------
        DesignError
            If there is no such metric, or there are too many points of a sweep for a table.
        """
        trials = self.points[0].trials
        wanted = metric or (trials.primary_info or trials.metrics[0]).name
        known = [info.name for info in trials.metrics]
        known += [ALL_METRICS] if len(known) > 1 else []
        if wanted not in known:
            raise DesignError(unknown(wanted, known, "metric"), "metric")
        tables = latex_tables(self, (), columns, width)
        if wanted not in tables:
            raise DesignError("there is no table in LaTeX: no run, or too many points of a sweep; summary.csv has all")
        return tables[wanted]


def _reordered(point: PointSummary, order: Sequence[str] | None, metrics: Sequence[str] | None) -> PointSummary:
    """Choose methods and metrics of a table whose statistics are computed."""
    trials, infos = point.trials, {info.name: info for info in point.trials.metrics}
    methods = trials.methods if order is None else tuple(name for name in order if name in trials.methods)
    chosen = trials.metrics if metrics is None else tuple(infos[name] for name in metrics)
    return point._replace(trials=replace(trials, methods=methods, metrics=chosen))


def stacked(parts: Sequence[tuple[Trials, pd.DataFrame]]) -> pd.DataFrame:
    """Put the tables of points below each other, with the columns of the sweep in front."""
    tables = []
    for trials, frame in parts:
        frame = frame.copy()
        for column, (path, value) in enumerate(trials.point.items()):
            frame.insert(column, path, value)
        tables.append(frame)
    return stacked_rows(tables)


def summarise(trials: Trials) -> Summary:
    """Describe every method and compare it with the baseline, at every point of a sweep."""
    pooled = _population(trials.pooled()) if len(trials.points) > MOST_ON_SCREEN and trials.is_population else None
    of = levels(trials)
    return Summary([_summary(point, of) for point in trials.each], pooled)


def _summary(trials: Trials, of: Levels) -> PointSummary:
    return PointSummary(trials, statistics.summary(trials), comparisons(trials, of))


def _population(trials: Trials) -> PointSummary:
    """Describe points that are all there are: nothing is estimated, so there are no errors, intervals and tests."""
    none = {"se": math.nan, "ci_low": math.nan, "ci_high": math.nan}
    return PointSummary(trials, statistics.summary(trials).assign(**none), comparisons(trials).iloc[:0])
