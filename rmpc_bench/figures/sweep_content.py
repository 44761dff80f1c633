"""What a figure over a sweep shows: the axis of its swept value, and the rows of a metric at every point."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from rmpc_bench.analysis.shown_numbers import MINUS, Estimate
from rmpc_bench.figures.axes import WIDE, Log, value_axis
from rmpc_bench.figures.labels import literal, short_title, width
from rmpc_bench.figures.points import common_form, shown_change
from rmpc_bench.figures.style import POINTS_PER_INCH
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from rmpc_bench.analysis.result_rows import Form, ResultTable
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.types import MetricInfo

Show = Literal["change", "value"]
BETTER_IF = {"lower": ", lower is better", "higher": ", higher is better"}
FORMS = {"ratio": "change of {}", "difference": "difference of {}", "share": "share of the runs with a better {}"}
POINTS = "points"  # in place of a path: every point of the sweep is a name
LIST = "point of the sweep"  # its words
NAME = "name"  # path of the names that the rows of a zip have
MOST_TICKS, ROUND_TICKS = 8, 6
"""Swept numbers that all have a tick of their own, and ticks at round numbers where they are more."""
PAD, APART = 0.02, 5.0
"""Space beyond the outer points, as a share of their distance, and smallest distance of two labels of ticks [pt]."""
PER_CENT = re.compile(r"(?P<both>\+-)?\s*(?P<number>[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(?P<unit>%)?")
OWNERS = {"controller": "the controller", "estimator": "the estimator", "model": "the design model"}
OWNERS |= {section: f"the {section}" for section in ("plant", "noise", "reference", "input", "time", "uncertainty")}
OWNERS["initial"] = "the initial state"  # first part of a path -> whose key it is, in words
TIMES = ("time.step", "time.duration")  # paths whose unit is that of the time


class SweepAxis(NamedTuple):
    """The values of a swept path in the order of the axis."""

    path: str
    texts: tuple[str, ...]  # values as the sweep writes them
    numbers: Array | None  # (values,) ascending numbers; None where the values are names
    unit: str
    words: str  # the path in words

    @property
    def is_log(self) -> bool:
        """Whether all numbers are positive and the largest exceeds 20 times the smallest."""
        numbers = self.numbers
        return numbers is not None and bool(numbers[0] > 0 and numbers[-1] > WIDE * numbers[0])

    @property
    def label(self) -> str:
        """Label of the axis; empty for names, which speak for themselves."""
        if self.path in (POINTS, NAME):
            return ""
        return f"{literal(self.words)} [{self.unit}]" if self.unit else literal(self.words)

    def place(self, text: str) -> float:
        """Return the number of a value."""
        assert self.numbers is not None, "names have no numbers"
        return float(self.numbers[self.texts.index(text)])

    def scale(self, axes: Axes) -> None:
        """Give the horizontal axis its scale, limits beside the outer points, and ticks."""
        assert self.numbers is not None, "names have no scale"
        scaled = np.log(self.numbers) if self.is_log else self.numbers
        reach = float(scaled[-1] - scaled[0])
        beyond = PAD * reach or abs(float(scaled[0])) or 1.0
        ends = np.array([scaled[0] - beyond, scaled[-1] + beyond])
        figure = axes.get_figure(root=True)
        assert figure is not None
        unit = axes.get_position().width * figure.get_figwidth() * POINTS_PER_INCH / float(ends[1] - ends[0])
        ticks = self._ticks(unit)
        if self.is_log:
            axes.set_xscale("log")
            ends = np.exp(ends)
        shown = [at for at in ticks if ends[0] <= at <= ends[1]]
        axes.set_xticks(shown, [ticks[at] for at in shown])
        axes.minorticks_off()
        axes.set_xlim(*ends)

    def _ticks(self, unit: float) -> dict[float, str]:
        """Choose ticks whose labels are apart: all numbers, else as many round ones as fit; `unit` is in points."""
        assert self.numbers is not None, "names have no ticks"
        choices = []
        if len(self.numbers) <= MOST_TICKS:
            choices.append({number: f"{number:g}".replace("-", MINUS) for number in self.numbers.tolist()})
        for most in range(ROUND_TICKS, 0, -1):
            chosen = value_axis(list(self.numbers), most, wide=WIDE if self.is_log else math.inf).ticks
            choices.append({math.exp(tick.at) if self.is_log else tick.at: tick.label for tick in chosen})
        for ticks in choices:
            places = np.log([*ticks]) if self.is_log else np.array([*ticks])
            widths = np.array([width(label) for label in ticks.values()])
            if ticks and (np.diff(places) * unit >= APART + (widths[1:] + widths[:-1]) / 2).all():
                return ticks
        return next(ticks for ticks in reversed(choices) if ticks)


class SweepContent(NamedTuple):
    """Rows of all points that a figure shows."""

    axis: SweepAxis
    # title of a panel, or value of the second path -> value of the axis -> rows
    panels: Mapping[str, Mapping[str, ResultTable]]
    methods: tuple[str, ...]
    form: Form
    down: SweepAxis | None = None  # the second path of a grid
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
        row = table.row_of(method)
        if row is None:
            return Estimate()
        if self.show == "change":
            return shown_change(row, self.form)
        if not self.is_median:
            return row.mean
        return Estimate(*(row.quantiles[place] for place in (2, 1, 3))) if row.quantiles else Estimate()

    def line(self, panel: str, method: str) -> list[tuple[float, Estimate]]:
        """Return the numbers of a method over the axis."""
        tables = [(text, self.panels[panel].get(text)) for text in self.axis.texts]
        found = [(self.axis.place(text), self.number(table, method)) for text, table in tables if table is not None]
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


def axis_of(
    points: Sequence[Mapping[str, str]], path: str, titles: Sequence[str] = (), time_unit: str = "s"
) -> SweepAxis:
    """Find the axis of a swept path, or of `POINTS`, which have titles, from the texts of values by point and path."""
    if path == POINTS:
        return SweepAxis(POINTS, tuple(dict.fromkeys(titles)), None, "", LIST)
    texts = tuple(dict.fromkeys(point[path] for point in points))
    found = [_number(text) for text in texts]
    known = [each for each in found if each is not None]
    units = {unit for _, unit in known}
    if len(known) < len(texts) or len(units) != 1:
        return SweepAxis(path, texts, None, "", in_words(path))
    order = sorted(range(len(texts)), key=lambda place: known[place][0])
    numbers = np.array([known[place][0] for place in order])
    (unit,) = units
    unit = unit or (time_unit if path in TIMES else "")
    return SweepAxis(path, tuple(texts[place] for place in order), numbers, unit, in_words(path))


def main_paths(points: Sequence[Mapping[str, str]]) -> list[str]:
    """Return the fewest paths that tell the points apart; names determine the values that change with them."""
    paths = list(points[0]) if points else []
    kept = sorted(paths, key=lambda path: path != NAME)
    for path in reversed(kept.copy()):
        rest = [each for each in kept if each != path]
        if not other_paths(points, *rest):
            kept = rest
    return [path for path in paths if path in kept] or paths[:1]


def other_paths(points: Sequence[Mapping[str, str]], *shown: str) -> list[str]:
    """Return the paths that the shown ones do not determine, as they do for values that change together.

    `POINTS` stands for all; points have the texts of values by path.
    """
    if POINTS in shown or not points:
        return []
    found = []
    for path in points[0]:
        pairs = {(*(point[each] for each in shown), point[path]) for point in points}
        if path not in shown and len(pairs) > len({pair[:-1] for pair in pairs}):
            found.append(path)
    return found


def panel_title(point: Mapping[str, str], paths: Sequence[str]) -> str:
    """Name some coordinates of a point, such as ``set=stacked``, by the last parts of the paths if these are unique."""
    last = [path.rpartition(".")[2] for path in paths]
    names = last if len(set(last)) == len(last) else list(paths)
    return ", ".join(f"{name}={point[path]}" for name, path in zip(names, paths, strict=True))


def in_words(path: str) -> str:
    """Say which key a path means, such as ``Hp of the controller``.

    >>> in_words("controller.Hp"), in_words("methods.R-MPC.estimator.c"), in_words("runs")
    ('Hp of the controller', 'c of the estimator of R-MPC', 'runs')
    """
    first, *rest = path.split(".")
    method = ""
    if first == "methods" and len(rest) > 2:
        # The name of a method may have points itself.
        section = next((place for place, part in enumerate(rest) if part in OWNERS), len(rest) - 1)
        method = f" of {'.'.join(rest[:section])}"
        first, rest = rest[section], rest[section + 1 :]
    if not rest:
        return path
    return f"{rest[-1].replace('_', ' ')} of {OWNERS.get(first, first)}{method}"


def _number(text: str) -> tuple[float, str] | None:
    """Read a number and its unit, which is empty, ``%`` or ``+-%``; None for other texts."""
    found = PER_CENT.fullmatch(text.strip())
    if found is None:
        return None
    try:
        value = float(found["number"])
    except ValueError:
        return None
    if not math.isfinite(value) or (found["both"] and not found["unit"]):
        return None
    return value, ("\N{PLUS-MINUS SIGN}%" if found["both"] else "%") if found["unit"] else ""


def content_of(tables: Sequence[ResultTable], path: str | Sequence[str] | None = None) -> SweepContent:
    """Arrange the tables of the points of a sweep: over one path or two, or point by point."""
    points = [table.trials.point for table in tables]
    titles = [short_title(table.trials) for table in tables]
    paths = [path] if isinstance(path, str) else list(path or main_paths(points))
    unit, others = tables[0].trials.time_unit, other_paths(points, *paths)
    axis, down = axis_of(points, paths[0] if paths else POINTS, titles, unit), None
    if len(paths) == 2 and not others:
        down = axis_of(points, paths[1], time_unit=unit)
    elif len(paths) > 1 or axis.numbers is None:
        # Points one after the other, named by their path where it tells them apart.
        names = titles if others or len(paths) > 1 or axis.path == POINTS else [point[axis.path] for point in points]
        axis = axis._replace(path=POINTS, texts=tuple(names), numbers=None, unit="", words=LIST)
    panels: dict[str, dict[str, ResultTable]] = {text: {} for text in down.texts} if down else {}
    for place, (point, table) in enumerate(zip(points, tables, strict=True)):
        listed = axis.path == POINTS
        panel = point[down.path] if down else "" if listed else panel_title(point, others)
        panels.setdefault(panel, {})[axis.texts[place] if listed else point[axis.path]] = table
    methods = tuple(dict.fromkeys(row.method for table in tables for row in table.rows if not row.is_baseline))
    return SweepContent(axis, panels, methods, common_form(tables), down)
