"""A drawn figure made fit for a printed column: thinner lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

THINNER = 0.8
"""Factor on the widths of all lines."""
LEAST = 0.35
"""Thinnest line [pt]; a printer may lose thinner ones."""


def thin_lines(figure: MplFigure) -> None:
    """Make all lines thinner, those of markers and frames included; nothing moves, so the layout may be final."""
    from matplotlib.collections import Collection
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    for line in figure.findobj(Line2D):
        line.set_linewidth(_thinner(line.get_linewidth()))
        line.set_markeredgewidth(_thinner(line.get_markeredgewidth()))
    for patch in figure.findobj(Patch):
        patch.set_linewidth(_thinner(patch.get_linewidth()))
    for collection in figure.findobj(Collection):
        collection.set_linewidth([_thinner(float(width)) for width in np.atleast_1d(collection.get_linewidth())])


def _thinner(width: float) -> float:
    """Return the new width; lines that are thinner than the thinnest stay as they are."""
    return max(min(LEAST, width), THINNER * width)
