"""The legend and the note above the panels of a figure, labels beside its points, and its final layout."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from rmpc_bench.figures.labels import literal, typeset, width, wrapped
from rmpc_bench.figures.palette import DIM, name_entries, sample
from rmpc_bench.figures.style import FONT_SIZE, LINE_HEIGHT, POINTS_PER_INCH, fix_layout, is_for_paper
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

HANDLE, PAD, GAP = 1.7, 0.5, 1.0
"""Length of a sample, distance to its label, distance between columns, in units of the font size."""

Handle: TypeAlias = "tuple[str, Artist]"  # label and sample of an entry
Entry: TypeAlias = "tuple[list[str], Artist]"  # the same with the lines of the label


def finish(
    figure: MplFigure, handles: Sequence[Handle], note: str = "", *, keys: Sequence[Handle] = (), columns: bool = False
) -> None:
    """Write the note above the panels and the legend above the note, then fix the layout for every resolution.

    The picture becomes taller where they need more than a line.  The legend shows `keys` in rows of their own.  A paper
    has no note, since its caption says it.  With `columns`, panels stand side by side, and the note stands above the
    legend, which must not be empty.
    """
    from matplotlib.font_manager import FontProperties

    limit = figure.get_figwidth() * POINTS_PER_INCH - FONT_SIZE
    entries, others = (
        [(wrapped(typeset(label), limit - (HANDLE + PAD) * FONT_SIZE), handle) for label, handle in group]
        for group in (handles, keys)
    )
    if keys:
        entries, n_columns = _in_rows(entries, others, limit)
    else:
        n_columns = columns_that_fit([max(map(width, lines)) for lines, _ in entries], limit)
    lines = wrapped(literal(note), limit - 6 * FONT_SIZE) if note and not is_for_paper() else []
    if entries:
        _place_legend(figure, entries, n_columns)
    if lines and columns:
        figure.legends[0].set_title("\n".join(lines), prop=FontProperties(size=FONT_SIZE))
    elif lines:
        figure.axes[0].set_title("\n".join(lines))
    height = -(-sum(len(text) for text, _ in entries) // n_columns) - 1 + len(lines)
    figure.set_figheight(figure.get_figheight() + max(0.0, height) * LINE_HEIGHT / POINTS_PER_INCH)
    figure.align_ylabels()
    fix_layout(figure)


def _place_legend(figure: MplFigure, entries: Sequence[Entry], n_columns: int) -> None:
    """Write a legend above the panels."""
    handles, texts = [handle for _, handle in entries], ["\n".join(lines) for lines, _ in entries]
    spaces: dict[str, Any] = {"labelspacing": 0.25, "borderpad": 0.0, "borderaxespad": 0.3, "frameon": False}
    spaces |= {"handlelength": HANDLE, "handletextpad": PAD, "columnspacing": GAP}
    legend = figure.legend(handles, texts, loc="outside upper center", ncols=n_columns, **spaces)
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
    found: list[list[list[Entry]]] = []
    for n in range(1, max(len(above), len(below)) + 1):
        cells = [entry for group in (above, below) for entry in [*group, *[([""], sample(ls=""))] * (-len(group) % n)]]
        columns = [cells[place::n] for place in range(n)]
        if n == 1 or _fits([[max(map(width, lines)) for lines, _ in column] for column in columns], limit):
            found.append(columns)
    columns = min(found, key=lambda each: (len(each[0]), len(each)))
    return [entry for column in columns for entry in column], len(columns)


DISTANCES = (4.0, 9.0, 15.0, 22.0, 30.0)  # from a point to its label [points], the nearest ones first
LEADER = 12.0  # distance from which on a thin line leads to the label [points]
STEP = 3.0  # distance between two boxes along a line [points]
DOT = 3.5  # half the size of a point [points]
SHARE = 0.45  # share of the panel's width that a line of a label may take
CROSSED, HIDDEN, OUTSIDE, FAR_AWAY = 1.0, 4.0, 8.0, 3.0
"""Weights of the cost of a position: area on lines, on points or labels, and outside of the panel; distance."""


_S = math.sqrt(0.5)
SIDES = ((1.0, 0.0), (_S, _S), (_S, -_S), (0.0, 1.0), (0.0, -1.0), (-_S, _S), (-_S, -_S), (-1.0, 0.0))
"""Directions to the right and up from a point to its label, the preferred ones first."""


class Label(NamedTuple):
    """A text for a point."""

    x: float
    y: float
    text: str
    gid: str | None = None  # name of the group of its method, by which a page hides it


def write(axes: Axes, labels: Sequence[Label], lines: Sequence[tuple[Array, Array]], *, color: str = "black") -> bool:
    """Write labels next to points, the first ones first, beside the lines; return whether none covers anything."""
    panel = _points_per_pixel(axes) * np.asarray(axes.bbox.extents)
    places = [_on_paper(axes, np.array([label.x, label.y])) for label in labels]
    solid = np.array([np.concatenate([place - DOT, place + DOT]) for place in places])
    weak = [_along(_on_paper(axes, np.stack(line, axis=1)), panel) for line in lines]
    thin = np.concatenate([np.zeros((0, 4)), *weak])
    choices = [(side, distance) for distance in DISTANCES for side in SIDES]
    free = True
    for label, place in zip(labels, places, strict=True):
        text = "\n".join(wrapped(typeset(label.text), SHARE * (panel[2] - panel[0])))
        rows = text.split("\n")
        extent = max(map(width, rows)), LINE_HEIGHT * len(rows)
        boxes = np.array([_beside(place, extent, side, distance) for side, distance in choices])
        hidden = _overlap(boxes, solid)
        outside = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1) - _overlap(boxes, panel[None])
        costs = CROSSED * _overlap(boxes, thin) + HIDDEN * hidden + OUTSIDE * outside
        best = int(np.argmin(costs + FAR_AWAY * np.array([distance for _, distance in choices])))
        free = free and bool(hidden[best] + outside[best] < 1.0)
        solid = np.concatenate([solid, boxes[best : best + 1]])
        _annotate(axes, label, text, *choices[best], color)
    return free


def _annotate(axes: Axes, label: Label, text: str, side: tuple[float, float], distance: float, color: str) -> None:
    """Write a text on one side of its point."""
    lead = {"arrowstyle": "-", "lw": 0.5, "color": DIM, "shrinkA": 0, "shrinkB": 3}
    note = axes.annotate(
        text,
        (label.x, label.y),
        xytext=(side[0] * distance, side[1] * distance),
        textcoords="offset points",
        ha=("right", "center", "left")[1 + int(np.sign(side[0]))],
        va=("top", "center", "bottom")[1 + int(np.sign(side[1]))],
        arrowprops=lead if distance > LEADER else None,
        linespacing=1.0,
        color=color,
        zorder=5.0,
        gid=label.gid,
    )
    if note.arrow_patch is not None:
        note.arrow_patch.set_gid(label.gid)


def _points_per_pixel(axes: Axes) -> float:
    figure = axes.get_figure(root=True)
    assert figure is not None
    return POINTS_PER_INCH / figure.dpi


def _on_paper(axes: Axes, data: Array) -> Array:
    """Where points of the panel lie [points], last axis x and y."""
    return np.asarray(_points_per_pixel(axes) * axes.transData.transform(data))


def _beside(place: Array, extent: tuple[float, float], side: tuple[float, float], distance: float) -> Array:
    """Box of a text of some width and height that begins at a distance from a point."""
    corner = place + np.multiply(side, distance) - np.multiply(extent, 1 - np.sign(side)) / 2
    return np.concatenate([corner, corner + extent])


def _along(line: Array, panel: Array) -> Array:
    """Small boxes along a broken line, as far as it lies in the panel."""
    line = np.clip(line[np.isfinite(line).all(axis=1)], panel[:2] - STEP, panel[2:] + STEP)
    if len(line) < 2:
        return np.zeros((0, 4))
    reached = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    stops = np.linspace(0.0, reached[-1], 2 + int(reached[-1] / STEP))
    points = np.stack([np.interp(stops, reached, line[:, place]) for place in (0, 1)], axis=1)
    return np.concatenate([points - 1.0, points + 1.0], axis=1)


def _overlap(boxes: Array, others: Array) -> Array:
    """Area of every box that others cover; boxes have (..., 4) left, bottom, right and top [points]."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    return np.asarray(np.prod(np.maximum(high - low, 0.0), axis=2).sum(axis=1))
