"""Pictures of a part itself, such as the friction of a plant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rmpc_bench.figures import curves
from rmpc_bench.figures.labels import typeset
from rmpc_bench.figures.style import COLOURS, FONT_SIZE, style
from rmpc_bench.types import Array, Line, Panel

ASIDE = 6.5  # from a point to the middle of its note [pt]
PLAN = 1.2  # height that a panel with equal axes needs beside its share [in]
MARGIN = 0.12  # about a plan, for notes


def draw(panels: Sequence[Panel], size: tuple[float, float]) -> Figure:
    """Draw the panels of a part below each other, each with its own axes.

    Parameters
    ----------
    panels : what to draw, as the part's `portrait` gives it
    size : width and height [in]; each panel with equal axes makes it taller
    """
    width, height = size
    with style():
        figure = Figure(figsize=(width, height + PLAN * sum(panel.equal for panel in panels)), layout="constrained")
        handles: dict[str, Artist] = {}  # the same label in several panels is one entry and one colour
        labels = list(dict.fromkeys(line.label for panel in panels for line in panel.lines))
        for axes, panel in zip(curves.panels(figure, len(panels), sharex=False), panels, strict=True):
            for line in panel.lines:
                handles[line.label] = _drawn(axes, line, COLOURS[labels.index(line.label) % len(COLOURS)])
            if panel.equal:
                axes.set_aspect("equal", adjustable="box")
                axes.margins(MARGIN)
            axes.set_title(typeset(panel.title))
            axes.set_xlabel(typeset(panel.x_label))
            axes.set_ylabel(typeset(panel.y_label))
        curves.finish(figure, [*handles.items()])
    return figure


def _drawn(axes: Axes, line: Line, color: str) -> Artist:
    """Draw a line or its points, with what is written beside them."""
    look: dict[str, Any] = {"ls": "none", "marker": "o", "markersize": 3.0} if line.dots else {"linewidth": 1.2}
    (drawn,) = axes.plot(line.x, curves.drawable(line.y), color=color, **look)
    for note, point, aside in zip(line.notes, np.stack([line.x, line.y], axis=1), _outwards(line), strict=False):
        text = axes.annotate(typeset(note), point, ASIDE * aside, textcoords="offset points", ha="center", va="center")
        text.set_fontsize(FONT_SIZE - 1)
    return drawn


def _outwards(line: Line) -> Array:
    """Directions (points, 2) away from the middle of the points; upwards in the middle itself."""
    points = np.stack([line.x, line.y], axis=1)
    away = points - points.mean(axis=0)
    far = np.sqrt((away * away).sum(axis=1, keepdims=True))
    direction: Array = np.where(far > 1e-9 * far.max(), away / np.maximum(far, 1e-300), [0.0, 1.0])
    return direction
