"""The legend and the note above the panels of a figure, and its final layout."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, typeset, width, wrapped
from rmpc_bench.figures.method_groups import name_entries
from rmpc_bench.figures.style import FONT_SIZE, fix_layout, is_for_paper
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure as MplFigure

HANDLE, PAD, GAP = 1.7, 0.5, 1.0
"""Length of a sample, distance to its label, distance between columns, in units of the font size."""

Handle: TypeAlias = "tuple[str, Artist]"
"""Label and sample of an entry."""
Entry: TypeAlias = "tuple[list[str], Artist]"
"""The same with the lines of the label."""
Place: TypeAlias = Literal["outside upper center", "outside lower center"]
"""Side of the panels at which a legend stands."""


def finish(
    figure: MplFigure,
    handles: Sequence[Handle],
    note: str = "",
    *,
    keys: Sequence[Handle] = (),
    columns: bool = False,
) -> None:
    """Write the note above the panels and the legend above the note, then fix the layout for every resolution.

    The picture becomes taller where they need more than a line.  The legend shows `keys` in rows of their own.  A paper
    has no note, since its caption says it.  With `columns`, panels stand side by side, and the note stands above the
    legend, which must not be empty.
    """
    from matplotlib.font_manager import FontProperties

    limit = figure.get_figwidth() * POINTS_PER_INCH - FONT_SIZE
    entries = [(wrapped(typeset(label), limit - (HANDLE + PAD) * FONT_SIZE), handle) for label, handle in handles]
    if keys:
        others = [(wrapped(typeset(label), limit - (HANDLE + PAD) * FONT_SIZE), handle) for label, handle in keys]
        entries, n_columns = _in_rows(entries, others, limit)
    else:
        n_columns = columns_that_fit([max(map(width, lines)) for lines, _ in entries], limit)
    lines = wrapped(literal(note), limit - 6 * FONT_SIZE) if note and not is_for_paper() else []
    if entries:
        place_legend(figure, entries, n_columns, "outside upper center")
    if lines and columns:
        figure.legends[0].set_title("\n".join(lines), prop=FontProperties(size=FONT_SIZE))
    elif lines:
        figure.axes[0].set_title("\n".join(lines))
    height = -(-sum(len(text) for text, _ in entries) // n_columns) - 1 + len(lines)
    figure.set_figheight(figure.get_figheight() + max(0.0, height) * 1.25 * FONT_SIZE / POINTS_PER_INCH)
    figure.align_ylabels()
    fix_layout(figure)


def place_legend(figure: MplFigure, entries: Sequence[Entry], n_columns: int, place: Place) -> None:
    """Write a legend outside the panels, at the side that matplotlib calls `place`."""
    handles = [handle for _, handle in entries]
    legend = figure.legend(
        handles,
        ["\n".join(lines) for lines, _ in entries],
        loc=place,
        ncols=n_columns,
        frameon=False,
        handlelength=HANDLE,
        handletextpad=PAD,
        columnspacing=GAP,
        labelspacing=0.25,
        borderpad=0.0,
        borderaxespad=0.3,
    )
    name_entries(legend, handles)


def columns_that_fit(widths: Sequence[float], limit: float) -> int:
    """Count the columns of a legend: as few rows as fit into `limit` points, then as few columns as these need."""
    for n in range(len(widths), 1, -1):
        if _fits(np.array_split(widths, n), limit):
            n_rows = -(-len(widths) // n)
            return -(-len(widths) // n_rows)
    return 1


def _fits(columns: Sequence[Sequence[float] | Array], limit: float) -> bool:
    """Whether columns of labels with these widths fit into `limit` points."""
    widths = [max(column) + (HANDLE + PAD) * FONT_SIZE for column in columns]
    return sum(widths) + GAP * FONT_SIZE * (len(widths) - 1) <= limit


def _in_rows(above: Sequence[Entry], below: Sequence[Entry], limit: float) -> tuple[list[Entry], int]:
    """Order the entries of a legend, which fills its columns first, so that two groups have rows of their own.

    Returns the entries, with empty ones at the ends of rows, and the number of columns: as few rows as fit into `limit`
    points, then as few columns as these need.
    """
    found: list[tuple[int, int, list[list[Entry]]]] = []
    for n in range(1, max(len(above), len(below)) + 1):
        cells = [entry for group in (above, below) for entry in [*group, *[_empty()] * (-len(group) % n)]]
        columns = [cells[place::n] for place in range(n)]
        if n == 1 or _fits([[max(map(width, lines)) for lines, _ in column] for column in columns], limit):
            found.append((len(columns[0]), n, columns))
    _, n_columns, columns = min(found, key=lambda each: each[:2])
    return [entry for column in columns for entry in column], n_columns


def _empty() -> Entry:
    from matplotlib.lines import Line2D

    return [""], Line2D([], [], ls="")
