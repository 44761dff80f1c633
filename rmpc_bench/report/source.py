"""What screen and page of an experiment are made from, and the parts that the page is opened into, as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

from rmpc_bench.analysis.columns import Columns
from rmpc_bench.analysis.result_rows import ResultTable, in_one_form, result_table
from rmpc_bench.analysis.runs import Extent
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.record import ExperimentRecord
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.report.answer import answer
from rmpc_bench.report.calibration_table import CalibrationTable
from rmpc_bench.report.page.matrix import Group
from rmpc_bench.report.ranks_table import RanksTable
from rmpc_bench.report.run_tables import DriversTable, RequirementsTable
from rmpc_bench.report.summary import Summary
from rmpc_bench.report.tuning_table import TuningTable
from rmpc_bench.types import MetricInfo


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Evaluation:
    """What the trials of an experiment say: of it screen, page and files are made."""

    trials: Trials
    extent: Extent  # none is planned for exact moments
    tables: Summary
    verdicts: Sequence[ClaimVerdict]  # the finding of every claim
    drivers: DriversTable
    requirements: RequirementsTable
    ranks: RanksTable
    tuning: TuningTable
    calibration: CalibrationTable
    overrides: Sequence[str] = ()  # options that changed the configuration
    incomplete: Sequence[str] = ()  # methods of which runs are missing

    def evaluation(self) -> dict[str, Any]:
        """Return these fields and their values, for another record that has them."""
        return {each.name: getattr(self, each.name) for each in fields(Evaluation)}

    @property
    def info(self) -> MetricInfo | None:
        """The primary metric, or the first one where tables do not show it; None without metrics."""
        shown = self.tables.points[0].trials
        return shown.primary_info or next(iter(shown.metrics), None)

    def tables_of(self, info: MetricInfo | None) -> list[ResultTable]:
        """Return the rows of a metric at every point with runs."""
        if info is None:
            return []
        return in_one_form([result_table(*each, info) for each in self.tables.points if len(each.trials.runs)])

    @property
    def answer(self) -> str:
        """Which method is better, by the findings that count."""
        verdicts = [] if self.overrides or self.incomplete else self.verdicts
        info = self.info
        tables = [] if info is None else [result_table(*point, info) for point in self.tables.with_runs]
        return answer(tables, verdicts, unfinished=self.extent.is_unfinished, n_blank=len(self.extent.blank))


class PageFigure(NamedTuple):
    """A figure of the page."""

    name: str  # file name without ending, such as `boxplot-2`
    kind: str  # such as `boxplot`, or the reference to a user's figure
    caption: str  # what it shows, in full sentences, with formulas as `$..$`
    svg: str  # the picture as an element of the page, whatever its files; its class is its name
    paths: Sequence[Path] = ()  # one file per format

    @property
    def files(self) -> list[str]:
        """The files, relative to the page."""
        return [f"{path.parent.name}/{path.name}" for path in self.paths]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PageSource(Evaluation):
    """Data of a page; a field is empty where it is not known."""

    record: ExperimentRecord
    figures: Sequence[PageFigure]
    place: str  # directory of the results as commands name it, relative to where they are entered
    drawings: Mapping[str, str] = field(default_factory=dict)  # changes over a sweep: class of the drawing -> SVG
    left_out: Sequence[str] = ()  # figures that could not be drawn, with the reason
    manifest: Mapping[str, Any] = field(default_factory=dict)  # versions, machine and times of the computation
    differences: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # method -> differing key -> its value
    shared: Mapping[str, str] = field(default_factory=dict)  # what is the same for every method -> its description
    confounded: Sequence[str] = ()  # methods that differ from the baseline in the estimator and in the controller
    timings: Columns = field(default_factory=dict)  # durations of the calls of own components
    files: Sequence[str] = ()  # files of the directory, relative to the page
    index: str = ""  # index of several experiments, relative to the page


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
