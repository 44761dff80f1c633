"""Captions of the figures over swept values: what the marks are, and the main numbers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rmpc_bench.analysis.number_text import interval_text
from rmpc_bench.figures.sweep_values import average_words, change_label, interval_words, runs_words

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.figures.heat_cells import Grid
    from rmpc_bench.figures.sweep_panels import SweepContent
    from rmpc_bench.figures.sweep_values import PointValue, SweepValues

MOST_METHODS = 6
"""Methods whose numbers a caption states."""
SPREADS = {
    "quartiles": ("median", "the interquartile range over the runs"),
    "se": ("mean", "one standard error of the mean on either side"),
    "interval": ("mean", "its {:g} % confidence interval"),
}
"""Spread -> the number that is drawn, and its spread."""


def lines_caption(trials: Trials, content: SweepContent, spread: str) -> str:
    """Write the caption of a metric over a swept value; for the spread see `SweepLines`."""
    values, axis = content.values, content.axis
    over = axis.words if axis.numbers is not None else f"{len(axis.texts)} points of the sweep"
    if values.kind:
        quantity = _sentence(change_label(trials, content.info, values.kind))
        what = f"{quantity} over {over}. Marks are the {average_words(values.kind)}"
        first = f"{what}, bands and bars are {interval_words(trials, values)}; {runs_words(values, 'paired run')}."
    else:
        middle, ends = SPREADS[spread]
        unit = f" in {content.info.unit}" if content.info.unit else ""
        what = f"{_sentence(content.info.words)}{unit} over {over}. Marks are the {middle} of the runs"
        first = f"{what}, bands and bars show {ends.format(100 * trials.confidence)}; {runs_words(values)}."
    sentences = [first, margin_sentence(values)]
    sentences += [_extremes(trials, content, name, title) for title in content.panels for name in values.methods][
        :MOST_METHODS
    ]
    return " ".join(filter(None, sentences))


def margin_sentence(values: SweepValues) -> str:
    """Define the band of relevance; empty without one."""
    low, high = values.margin
    if not values.kind or high <= 0:
        return ""
    return f"The grey band from {low:.3g} to +{high:.3g} {values.unit}".rstrip() + " is the margin of relevance."


def _extremes(trials: Trials, content: SweepContent, method: str, title: str) -> str:
    """State the smallest and the largest value of a method in a panel, and where they are."""
    line = {text: value for text, value in content.of(title, method).items() if math.isfinite(value.middle)}
    if not line:
        return ""
    low = min(line, key=lambda text: line[text].middle)
    high = max(line, key=lambda text: line[text].middle)
    name = trials.labels.get(method, method) + (f" ({title})" if title else "")
    ends = [f"{number_words(line[text], content.values)} ({content.axis.value_words(text)})" for text in (low, high)]
    return f"{name}: {ends[0]}." if low == high else f"{name}: from {ends[0]} to {ends[1]}."


def number_words(value: PointValue, values: SweepValues) -> str:
    """Write a value with its spread."""
    return interval_text(value.middle, value.low, value.high, unit=values.unit, sign=bool(values.kind))


def cells_caption(trials: Trials, grid: Grid) -> str:
    """Write the caption of a heat map."""
    values = grid.values
    over = f"over {grid.x.words} and {grid.y.words}" + (f" ({grid.title})" if grid.title else "")
    if values.kind:
        quantity = _sentence(change_label(trials, grid.info, values.kind))
        unit = f" in {values.unit}" if values.unit else ""
        shown = [cell for name in values.methods for cell in grid.cells(name).values()]
        unknown = " or is not known" if any(math.isnan(cell.low) for cell in shown) else ""
        first = (
            f"{quantity} {over}{unit}: {average_words(values.kind)}, {runs_words(values, 'paired run')}. "
            f"Hatched cells: the {interval_words(trials, values).removesuffix('s')} contains 0{unknown}."
        )
        margin = f"Grey: the margin of relevance, {values.margin[0]:.3g} to +{values.margin[1]:.3g} {values.unit}."
        sentences = [first, margin.replace(" .", ".") if values.margin[1] > 0 else ""]
    else:
        unit = f" in {grid.info.unit}" if grid.info.unit else ""
        average = "Median" if grid.info.may_not_occur else "Mean"
        sentences = [f"{average} {grid.info.words}{unit} {over}, {runs_words(values)}."]
    return " ".join(filter(None, [*sentences, *(_range_of(trials, grid, name) for name in values.methods)]))


def _range_of(trials: Trials, grid: Grid, method: str) -> str:
    """State the smallest and the largest value of a method, where they are, and how many cells are hatched."""
    cells = grid.cells(method)
    if not cells:
        return ""
    ends = []
    for choose in (min, max):
        x, y = choose(cells, key=lambda place: cells[place].middle)
        where = f"{grid.x.value_words(x)}, {grid.y.value_words(y)}"
        ends.append(f"{number_words(cells[x, y], grid.values)} ({where})")
    n_zero = sum(cell.has_zero for cell in cells.values())
    hatched = f"; {n_zero} of {len(cells)} cells are hatched" if grid.values.kind else ""
    return f"{trials.labels.get(method, method)}: from {ends[0]} to {ends[1]}{hatched}."


def _sentence(text: str) -> str:
    """Begin with a capital letter."""
    return text[:1].upper() + text[1:]
