"""The table of two axes of methods in one metric: cells, main effects and interactions, and sentences on these."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.columns import Columns, columns_of
from rmpc_bench.analysis.comparison import levels
from rmpc_bench.analysis.intervals import student
from rmpc_bench.analysis.pairs import TwoWay, name_of_distance, two_way
from rmpc_bench.analysis.rounding import without_noise
from rmpc_bench.analysis.shown_numbers import Estimate, change_texts, difference_texts, plain, short
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.point_tables import rounded_columns
from rmpc_bench.report.run_notes import counted
from rmpc_bench.types import Array, MetricInfo
from rmpc_bench.types.texts import in_columns, width_of, without_formulas, wrapped

NOTE = (
    "Cells: mean of the runs that all of these methods finished, geometric where the metric is compared by ratios. "
    "Effects: against {0} and {1}, averaged over the other axis. Behind a cell: its interaction, by which the effect "
    "of its row differs from that in the column {1}. Intervals of the primary metric are simultaneous."
)
_NUMBERS = ["value", "low", "high", "ci_level"]


class TwoWayTable(NamedTuple):
    """The table of one metric at one point."""

    trials: Trials
    info: MetricInfo
    found: TwoWay
    level: float  # of each interval

    def estimate(self, values: Array) -> Estimate:
        """Return a mean over the runs with its interval; that of logarithms as a ratio."""
        ends = [without_noise(end, self.found.scale) for end in (float(values.mean()), *student(values, self.level))]
        return Estimate(*(ends if self.found.signed else map(float, np.exp(ends))))

    def effect(self, values: Array | None, *, interval: bool = True) -> str:
        """Write a mean over the runs with its interval; empty where there is none."""
        if values is None or np.isnan(values).any():
            return ""
        x = self.estimate(values)
        ratio = Estimate(*(100 * (end - 1) for end in x))
        texts = difference_texts(x, self.info.unit) if self.found.signed else change_texts(ratio)
        return " ".join(filter(None, texts[: 1 + interval]))

    @property
    def n_left_out(self) -> int:
        """Count the runs in which a method failed or has no value."""
        return len(self.trials.runs) - len(self.found.runs)

    @property
    def note(self) -> str:
        """What the table means."""
        return NOTE.format(*(of[k] for of, k in zip(self.found.entries, self.found.reference, strict=True)))

    @property
    def title(self) -> str:
        """Name the point, the quantity and the runs."""
        quantity = name_of_distance(self.info, self.info.words) + (f" [{self.info.unit}]" if self.info.unit else "")
        left = f", {self.n_left_out} left out" if self.n_left_out else ""
        return f"{': '.join(filter(None, [self.trials.title, quantity]))}, {counted(len(self.found.runs), 'run')}{left}"

    def columns(self, *, interactions: bool = True) -> dict[str, list[str]]:
        """Return head -> cells: a row per entry of the first axis, and one with the main effects of the second axis."""
        (first, second), (one, other), effects = self.found.entries, self.found.axes, self.found.effects
        found: dict[str, list[str]] = {f"{one}+{other}": [*first, f"effect of {other}"]}
        for j, b in enumerate(second):
            means = ["" if np.isnan(of).any() else short(self.estimate(of).value) for of in self.found.values[:, j]]
            behind = [self.effect(effects.get((a, b))) if interactions else "" for a in first]
            cells = [f"{mean} ({text})" if text else mean for mean, text in zip(means, behind, strict=True)]
            found[b] = [*cells, self.effect(effects.get(("", b)))]
        return {**found, f"effect of {one}": [*(self.effect(effects.get((a, ""))) for a in first), ""]}

    @property
    def sentences(self) -> list[str]:
        """Return the effects of the entries of the first axis that have a relevant interaction with the second axis."""
        (first, second), found = self.found.entries, list[str]()
        margin = self.trials.relevant_of(self.info.name, default=0.0 if self.found.signed else None)
        low, high = (-margin, margin) if self.found.signed else (1 / (1 + margin), 1 + margin)
        for a, changes in zip(first, self.found.values - self.found.values[self.found.reference[0]], strict=True):
            each = [self.estimate(of) for (of_a, b), of in self.found.effects.items() if of_a == a and b]
            if any(x.low > high or x.high < low for x in each):
                texts = [(b, self.effect(of, interval=False)) for b, of in zip(second, changes, strict=True)]
                said = ", ".join(f"{text} with {b}" for b, text in texts if text)
                found.append(f"the effect of {a} depends on the {self.found.axes[1]}: {said}")
        return found

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of two-way.csv: cells, then effects, of which one axis or none is empty."""
        (first, second), found = self.found.entries, self.found
        cells = [((a, b), found.values[i, j], "cell") for i, a in enumerate(first) for j, b in enumerate(second)]
        cells += [(cell, of, "interaction" if all(cell) else "main effect") for cell, of in found.effects.items()]
        return [
            {**self.trials.point, "metric": self.info.name, "what": what, **dict(zip(found.axes, cell, strict=True))}
            | dict(zip(_NUMBERS, [*self.estimate(of), self.level], strict=True))
            | {"n": len(found.runs), "n_left_out": self.n_left_out}
            for cell, of, what in cells
        ]


@lru_cache(maxsize=2)
def two_way_tables(trials: Trials) -> tuple[TwoWayTable, ...]:
    """Compute the tables of all metrics at all points, where methods have two axes."""
    tables = list[TwoWayTable]()
    for point in trials.each if trials.two_way and trials.with_verdicts else ():
        for info in point.metrics:
            if (found := two_way(point, info)) is not None:
                level = levels(trials).held if info == point.primary_info else levels(trials).plain
                tables.append(TwoWayTable(point, info, found, level))
    return tuple(tables)


def two_way_content(trials: Trials) -> Columns:
    """Return the content of two-way.csv; an effect is a ratio, or a difference in the unit of a signed metric."""
    rows = [row for table in two_way_tables(trials) for row in table.rows()]
    return rounded_columns(columns_of(rows, [*rows[0]]), _NUMBERS) if rows else {}


def two_way_lines(table: TwoWayTable, width: int) -> list[str]:
    """Lay the table out for a terminal; what is too wide, interactions or all, is named with its file."""
    title = plain(without_formulas(table.title, table.trials.methods))
    for interactions in (True, False):
        columns = table.columns(interactions=interactions)
        rows = [[*columns], *zip(*columns.values(), strict=True)]
        lines = in_columns([[plain(without_formulas(cell)) for cell in row] for row in rows], range(1, len(columns)))
        if max(map(width_of, lines)) <= width:
            left = [] if interactions else [" interactions: two-way.csv"]
            return ["", *wrapped(title, width), *lines, *left]
    return ["", *wrapped(f"{title}: two-way.csv", width)]
