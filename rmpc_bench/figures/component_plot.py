"""Plots of a component itself, such as the friction of a plant; matplotlib is imported when one is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rmpc_bench.figures.axes import drawable, stacked_panels
from rmpc_bench.figures.labels import typeset
from rmpc_bench.figures.legend import finish
from rmpc_bench.figures.palette import METHODS
from rmpc_bench.figures.style import FONT_SIZE, new_figure, style
from rmpc_bench.types import Array, Line, Panel

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

WIDTH, NOTE_DISTANCE = 3.5, 6.5  # width of the picture [in], and from a point to the middle of its note [pt]
EQUAL_AXES_HEIGHT, MARGIN = 1.2, 0.12
"""Additional height of a panel with equal axes [in], and the share of it that is left for notes on every side."""


def draw_component(panels: Sequence[Panel]) -> MplFigure:
    """Draw the panels of a component from top to bottom, each with its own axes, for `files.save_as`."""
    height = 0.4 + 1.6 * len(panels) + EQUAL_AXES_HEIGHT * sum(panel.equal for panel in panels)
    with style():
        figure = new_figure((WIDTH, height))
        # The same label in several panels is one entry of the legend and has one colour.
        handles: dict[str, Artist] = {}
        labels = list(dict.fromkeys(line.label for panel in panels for line in panel.lines))
        for axes, panel in zip(stacked_panels(figure, len(panels), sharex=False), panels, strict=True):
            for line in panel.lines:
                handles[line.label] = _drawn(axes, line, METHODS[labels.index(line.label) % len(METHODS)])
            if panel.equal:
                axes.set_aspect("equal", adjustable="box")
                axes.margins(MARGIN)
            title, x, y = map(typeset, (panel.title, panel.x_label, panel.y_label))
            axes.set(title=title, xlabel=x, ylabel=y)
        finish(figure, [*handles.items()])
    return figure


def _drawn(axes: Axes, line: Line, color: str) -> Artist:
    """Draw a line or its points, with the notes beside them."""
    look: dict[str, Any] = {"ls": "none", "marker": "o", "markersize": 3.0} if line.dots else {"linewidth": 1.2}
    (drawn,) = axes.plot(line.x, drawable(line.y), color=color, **look)
    beside: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "va": "center", "fontsize": FONT_SIZE - 1}
    for note, point, aside in zip(line.notes, np.stack([line.x, line.y], axis=1), _outwards(line), strict=False):
        axes.annotate(typeset(note), point, NOTE_DISTANCE * aside, **beside)
    return drawn


def _outwards(line: Line) -> Array:
    """Directions (points, 2) away from the middle of the points; upwards in the middle itself."""
    points = np.stack([line.x, line.y], axis=1)
    away = points - points.mean(axis=0)
    far = np.sqrt((away * away).sum(axis=1, keepdims=True))
    direction: Array = np.where(far > 1e-9 * far.max(), away / np.maximum(far, 1e-300), [0.0, 1.0])
    return direction
