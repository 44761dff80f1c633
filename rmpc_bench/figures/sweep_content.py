"""What a figure over a sweep shows: tables of rows by point, and the numbers of a method that it draws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal, NamedTuple

from rmpc_bench.analysis.shown_numbers import Estimate
from rmpc_bench.figures.change_axis import Log
from rmpc_bench.figures.point_tables import row_of, shown_change
from rmpc_bench.figures.sweep_axis import SweepAxis

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rmpc_bench.analysis.result_rows import Form, ResultTable
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.types import MetricInfo

Show = Literal["change", "value"]
BETTER_IF = {"lower": ", lower is better", "higher": ", higher is better"}
FORMS = {"ratio": "change of {}", "difference": "difference of {}", "share": "share of the runs with a better {}"}


class SweepContent(NamedTuple):
    """Rows of all points that a figure shows."""

    axis: SweepAxis
    panels: Mapping[str, Mapping[str, ResultTable]]
    """Title of a panel, or value of the second path -> value of the axis -> rows."""
    methods: tuple[str, ...]
    form: Form
    down: SweepAxis | None = None
    """The second path of a grid."""
    show: Show = "change"
    spread: str = "interval"
    log: Log = "auto"

    @property
    def is_lines(self) -> bool:
        """Whether it is drawn as lines."""
        return self.axis.numbers is not None and self.down is None

    @property
    def tables(self) -> Sequence[ResultTable]:
        """The rows of all points."""
        return [table for panel in self.panels.values() for table in panel.values()]

    @property
    def trials(self) -> Trials:
        """The first point, for what is common to all."""
        return self.tables[0].trials

    @property
    def info(self) -> MetricInfo:
        """The metric."""
        return self.tables[0].info

    @property
    def margin(self) -> float:
        """The largest margin of relevance of the points."""
        return max(table.margin for table in self.tables)

    @property
    def is_median(self) -> bool:
        """Whether values are medians with quartiles: where asked, and where an event may not occur."""
        return self.spread == "quartiles" or any(table.may_not_occur for table in self.tables)

    def number(self, table: ResultTable, method: str) -> Estimate:
        """Return the number of a method at a point with its spread; NaN where there is none."""
        row = row_of(table, method)
        if row is None:
            return Estimate()
        if self.show == "change":
            return shown_change(row, self.form)
        if not self.is_median:
            return row.mean
        return Estimate(*(row.quantiles[place] for place in (2, 1, 3))) if row.quantiles else Estimate()

    def line(self, panel: str, method: str) -> list[tuple[float, Estimate]]:
        """Return the numbers of a method over the axis."""
        places = self.panels[panel]
        found = [
            (self.axis.place(text), self.number(places[text], method)) for text in self.axis.texts if text in places
        ]
        return [(x, value) for x, value in found if not math.isnan(value.value)]

    @property
    def words(self) -> str:
        """What is shown, in words without a unit."""
        name = self.tables[0].quantity
        if self.show == "value":
            return f"{'median' if self.is_median else 'mean'} {self.info.words}"
        return FORMS.get(self.form, "{}").format(name)

    @property
    def better_if(self) -> str:
        """Say which side is better, for the end of a title."""
        return BETTER_IF.get(self.info.direction, "") if self.form != "share" or self.show == "value" else ""

    def sentence(self) -> str:
        """Define lines or cells in a sentence."""
        over = self.axis.words if self.axis.numbers is not None else f"{len(self.axis.texts)} points of the sweep"
        over = f"{over} and {self.down.words}" if self.down else over
        counts = sorted({row.n for table in self.tables for row in table.rows})
        n = f"{counts[0]} to {counts[-1]}" if counts and counts[0] < counts[-1] else f"{counts[-1] if counts else 0}"
        runs = f"{n} run{'s' * (n != '1')} per point and method"
        confidence = f"{100 * self.trials.confidence:g} % intervals"
        unit = self.info.unit if self.show == "value" or self.form == "difference" else ""
        what = f"{self.words[:1].upper()}{self.words[1:]}{f' [{unit}]' if unit else ''} over {over}"
        if self.show == "value":
            spread = "quartiles" if self.is_median else confidence
            return f"{what}{f' with {spread}' if self.is_lines else ''}, {runs}"
        first = next((table for table in self.tables if table.average), self.tables[0])
        average = f" ({first.average})" if first.average and self.form != "share" else ""
        against = f"{what} against {self.trials.baseline}{average}"
        if self.is_lines:
            margin = f" and the margin of {first.margin_text} in grey" if first.margin else ""
            return f"{against}, with {confidence} as bands{margin}, {runs}"
        return f"{against}; blue is better, orange worse, ? inconclusive, ≈ equivalent; {runs}"
