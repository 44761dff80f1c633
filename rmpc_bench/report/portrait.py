"""Pictures of a part itself, such as the friction of a plant."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.artist import Artist
from matplotlib.figure import Figure

from rmpc_bench.report import curves
from rmpc_bench.report.labels import typeset
from rmpc_bench.report.style import COLOURS, style
from rmpc_bench.types import Panel


def draw(panels: Sequence[Panel], size: tuple[float, float]) -> Figure:
    """Draw the panels of a part below each other, each with its own axes.

    Parameters
    ----------
    panels : what to draw, as the part's `portrait` gives it
    size : width and height [in]
    """
    with style():
        figure = Figure(figsize=size, layout="constrained")
        handles: dict[str, Artist] = {}  # the same label in several panels is one entry
        for axes, panel in zip(curves.panels(figure, len(panels), sharex=False), panels, strict=True):
            for number, line in enumerate(panel.lines):
                color = COLOURS[number % len(COLOURS)]
                (handles[line.label],) = axes.plot(line.x, curves.drawable(line.y), color=color, linewidth=1.2)
            axes.set_title(typeset(panel.title))
            axes.set_xlabel(typeset(panel.x_label))
            axes.set_ylabel(typeset(panel.y_label))
        curves.finish(figure, [*handles.items()])
    return figure
