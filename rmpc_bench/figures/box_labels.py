"""Labels and counts below the boxes of a boxplot: wrapped, at 45 degrees, or numbers with a key below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.figures.labels import DID_NOT_OCCUR, POINTS_PER_INCH, typeset, width, wrapped
from rmpc_bench.figures.legend import HANDLE, PAD, columns_that_fit, place_legend
from rmpc_bench.figures.method_groups import name_ticks
from rmpc_bench.figures.style import FONT_SIZE
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

LINE = 1.25 * FONT_SIZE
"""Height of a line of text [points]."""
MOST_LINES = 5
"""Lines of a wrapped label with its counts."""
SLANT = math.sqrt(0.5)


class Counts(NamedTuple):
    """Runs of a box."""

    n: int
    """With a value, which may be infinite."""
    n_runs: int
    """Finished and failed; those that are not computed do not count."""
    n_infinite: int

    def lines(self, *, with_n: bool) -> list[str]:
        """Return the lines below a box: number of runs, as n/total if some failed, and those without the event.

        A number of runs of which none failed is left out without `with_n`, where one line says it for all boxes.
        """
        lines = [] if self.n else ["no value"]
        if self.n < self.n_runs:
            lines.append(f"{self.n}/{self.n_runs}")
        elif with_n:
            lines.append(f"n={self.n}")
        return [*lines, *([f"{self.n_infinite} {DID_NOT_OCCUR}"] if self.n_infinite else [])]


def counts_of(column: Array, n_runs: int) -> Counts:
    """Count the runs of a column of a metric, of which so many are computed."""
    return Counts(int((~np.isnan(column)).sum()), n_runs, int(np.isinf(column).sum()))


def common_count(panels: Sequence[Sequence[Counts]]) -> str:
    """Give the number of runs in one line if it is the same for all boxes and no run failed; else nothing."""
    numbers = {(each.n, each.n_runs) for counts in panels for each in counts}
    if len(numbers) != 1 or len({number for pair in numbers for number in pair}) != 1:
        return ""
    n = numbers.pop()[0]
    return f"n = {n} for all" if sum(map(len, panels)) > 1 else f"n = {n}"


def label_panels(
    rows: Sequence[Axes],
    labels: Sequence[str],
    panels: Sequence[Sequence[Counts]],
    slot: float,
    handles: Sequence[Artist],
) -> None:
    """Write labels and counts below the last panel; counts below the others too if they differ.

    `slot` is the width of the place of a box [points], `handles` are samples of the methods for a key.
    """
    common = common_count(panels)
    counts = [[each.lines(with_n=not common) for each in panel] for panel in panels]
    for axes, lines in zip(rows[:-1], counts[:-1], strict=True):
        if any(other != lines for other in counts):
            _write_counts(axes, lines, slot)
    height = _label_boxes(rows[-1], labels, counts[-1], slot, handles)
    for axes in rows:
        name_ticks(axes, [handle.get_gid() for handle in handles][: len(axes.get_xticks())], horizontal=True)
    if common:
        rows[-1].set_xlabel(common)
    figure = rows[-1].get_figure(root=True)
    assert figure is not None
    figure.set_figheight(figure.get_figheight() + height / POINTS_PER_INCH)


def _label_boxes(
    axes: Axes, labels: Sequence[str], counts: Sequence[list[str]], slot: float, handles: Sequence[Artist]
) -> float:
    """Write label and counts of every box in the first way that fits; return the additional height [points]."""
    room = _height(axes)
    shown = [typeset(label) for label in labels]
    blocks = [
        [*wrapped(label, slot), *(line for text in lines for line in wrapped(text, slot))]
        for label, lines in zip(shown, counts, strict=True)
    ]
    n_lines = max(map(len, blocks))
    if all(width(line) <= slot for line in chain(*blocks)) and n_lines <= min(MOST_LINES, room / LINE):
        _set_ticks(axes, ["\n".join(block) for block in blocks])
        return max(0, n_lines - 2) * LINE
    texts = [", ".join([" ".join(label.split("\n")), *lines]) for label, lines in zip(shown, counts, strict=True)]
    rise = SLANT * (max(map(width, texts)) + LINE)
    if rise <= room and slot * SLANT >= LINE:
        _set_ticks(axes, texts, rotation=45, ha="right", va="top", rotation_mode="anchor")
        return rise - LINE
    _set_ticks(axes, [str(number) for number in range(1, len(texts) + 1)])
    return _write_key(axes, [f"{number}  {text}" for number, text in enumerate(texts, start=1)], handles)


def _write_counts(axes: Axes, counts: Sequence[list[str]], slot: float) -> None:
    """Write the counts of a panel that is not the last one, upright on one line if they do not fit."""
    blocks = [[line for text in lines for line in wrapped(text, slot)] for lines in counts]
    if any(width(line) > slot for line in chain(*blocks)):
        _set_ticks(axes, [", ".join(lines) for lines in counts], rotation=90)
    else:
        _set_ticks(axes, ["\n".join(block) for block in blocks])


def _set_ticks(axes: Axes, texts: Sequence[str], **how: Any) -> None:
    axes.set_xticks(range(1, len(texts) + 1), texts, **how)


def _write_key(axes: Axes, texts: Sequence[str], handles: Sequence[Artist]) -> float:
    """Write what the numbers stand for below the panels; return the height of the key [points]."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    limit = figure.get_figwidth() * POINTS_PER_INCH - FONT_SIZE
    entries = [wrapped(text, limit - (HANDLE + PAD) * FONT_SIZE) for text in texts]
    n_columns = columns_that_fit([max(map(width, lines)) for lines in entries], limit)
    place_legend(figure, list(zip(entries, handles, strict=True)), n_columns, "outside lower center")
    return -(-sum(map(len, entries)) // n_columns) * LINE


def _height(axes: Axes) -> float:
    """Height of a panel [points]."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    return float(axes.get_position().height * figure.get_figheight() * POINTS_PER_INCH)
