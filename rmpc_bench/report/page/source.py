"""What the page of an experiment is made from, and the parts that it is opened into, as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rmpc_bench.analysis.columns import Columns
from rmpc_bench.analysis.ranks import Ranking
from rmpc_bench.analysis.result_rows import ResultTable, in_one_form, result_table
from rmpc_bench.analysis.runs import Extent
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.record import ExperimentRecord
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.report.calibration_table import CalibrationTable
from rmpc_bench.report.page.matrix import Group
from rmpc_bench.report.ranks_table import RanksTable
from rmpc_bench.report.run_tables import DriversTable, RequirementsTable
from rmpc_bench.report.summary import Summary
from rmpc_bench.report.tuning_table import TuningTable
from rmpc_bench.types import MetricInfo


class PageFigure(NamedTuple):
    """A figure of the page."""

    name: str  # file name without ending, such as `boxplot-2`
    kind: str  # such as `boxplot`, or the reference to a user's figure
    caption: str  # what it shows, with formulas as `$..$`
    svg: str  # the picture as an element of the page
    files: Sequence[str]  # its files, relative to the page


@dataclass(frozen=True, eq=False)
class PageSource:
    """Data of a page; a field is empty or None where it is not known."""

    record: ExperimentRecord
    trials: Trials
    tables: Summary
    verdicts: Sequence[ClaimVerdict]
    figures: Sequence[PageFigure]
    place: str  # directory of the results as commands name it, relative to where they are entered
    extent: Extent = Extent(0, ())  # none is planned for exact moments
    drawings: Mapping[str, str] = field(default_factory=dict)  # changes over a sweep: class of the drawing -> SVG
    left_out: Sequence[str] = ()  # figures that could not be drawn, with the reason
    incomplete: Sequence[str] = ()  # methods of which runs are missing
    overrides: Sequence[str] = ()  # options that changed the configuration
    manifest: Mapping[str, Any] = field(default_factory=dict)  # versions, machine and times of the computation
    differences: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # method -> differing key -> its value
    shared: Mapping[str, str] = field(default_factory=dict)  # what is the same for every method -> its description
    confounded: Sequence[str] = ()  # methods that differ from the baseline in the estimator and in the controller
    drivers: DriversTable | None = None
    requirements: RequirementsTable | None = None
    ranks: RanksTable | None = None
    tuning: TuningTable | None = None
    calibration: CalibrationTable | None = None
    timings: Columns = field(default_factory=dict)  # durations of the calls of own components
    files: Sequence[str] = ()  # files of the directory, relative to the page
    index: str = ""  # index of several experiments, relative to the page

    @property
    def info(self) -> MetricInfo | None:
        """The metric of the main table."""
        return info_of(self.tables)

    @property
    def ranked(self) -> Ranking | None:
        """The ranks, where they are asked for."""
        return None if self.ranks is None else self.ranks.found


def info_of(summary: Summary) -> MetricInfo | None:
    """Return the primary metric, or the first one where tables do not show it; None without metrics."""
    shown = summary.points[0].trials
    return shown.primary_info or next(iter(shown.metrics), None)


def tables_of(summary: Summary, info: MetricInfo | None) -> list[ResultTable]:
    """Return the rows of a metric at every point with runs."""
    if info is None:
        return []
    return in_one_form([result_table(*each, info) for each in summary.points if len(each.trials.runs)])


class Table(NamedTuple):
    """Columns, of which the first one names the rows."""

    columns: Mapping[str, Sequence[str]]
    numeric: bool = True
    by_method: bool = False  # whether the first column has methods, which are names and no formulas

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The cells of every row."""
        return [*zip(*self.columns.values(), strict=True)]


class Part(NamedTuple):
    """A part of a fold; all but one of its fields are empty."""

    text: str = ""
    note: str = ""
    command: str = ""
    items: Sequence[str] = ()
    table: Table | None = None
    groups: Sequence[Group] = ()
    figure: PageFigure | None = None


class Fold(NamedTuple):
    """A part of the page that is opened on demand."""

    title: str
    gist: str
    parts: Sequence[Part]
