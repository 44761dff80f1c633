"""Labels next to the points of a picture, each at the position where it covers least."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from rmpc_bench.figures.labels import POINTS_PER_INCH, typeset, width, wrapped
from rmpc_bench.figures.style import FONT_SIZE, REFERENCE
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LINE = 1.25 * FONT_SIZE
"""Height of a line of text [points]."""
DISTANCES = (4.0, 9.0, 15.0, 22.0, 30.0)
"""From a point to its label [points], the nearest ones first."""
LEADER = 12.0
"""Distance from which on a thin line leads to the label [points]."""
STEP = 3.0
"""Distance between two boxes along a line [points]."""
DOT = 3.5
"""Half the size of a point [points]."""
SHARE = 0.45
"""Share of the panel's width that a line of a label may take."""
CROSSED, HIDDEN, OUTSIDE, FAR_AWAY = 1.0, 4.0, 8.0, 3.0
"""Weights of the cost of a position: area on lines, on points or labels, and outside of the panel; distance."""


Boxes: TypeAlias = Array
"""(boxes, 4) left, bottom, right and top of rectangles [points]."""


class Side(NamedTuple):
    """A direction from a point to its label, of length 1."""

    right: float
    up: float


SLANT = math.sqrt(0.5)
SIDES = (
    Side(1.0, 0.0),
    Side(SLANT, SLANT),
    Side(SLANT, -SLANT),
    Side(0.0, 1.0),
    Side(0.0, -1.0),
    Side(-SLANT, SLANT),
    Side(-SLANT, -SLANT),
    Side(-1.0, 0.0),
)
"""The preferred ones first."""


class Label(NamedTuple):
    """A text for a point."""

    x: float
    y: float
    text: str
    gid: str | None = None
    """Name of the group of its method, by which a page hides it."""


def write(axes: Axes, labels: Sequence[Label], lines: Sequence[tuple[Array, Array]], *, color: str = "black") -> bool:
    """Write labels next to points of a panel whose layout and limits are final; return whether none covers anything.

    Earlier labels are placed first; they avoid the given lines.
    """
    panel = _points_per_pixel(axes) * np.asarray(axes.bbox.extents)
    places = [_on_paper(axes, np.array([label.x, label.y])) for label in labels]
    solid = np.array([_around(place, DOT) for place in places])
    weak = [_along(_on_paper(axes, np.stack(line, axis=1)), panel) for line in lines]
    thin = np.concatenate([np.zeros((0, 4)), *weak])
    choices = [(side, distance) for distance in DISTANCES for side in SIDES]
    free = True
    for label, place in zip(labels, places, strict=True):
        text = "\n".join(wrapped(typeset(label.text), SHARE * (panel[2] - panel[0])))
        rows = text.split("\n")
        extent = max(map(width, rows)), LINE * len(rows)
        boxes = np.array([_beside(place, extent, side, distance) for side, distance in choices])
        hidden = _overlap(boxes, solid)
        outside = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1) - _overlap(boxes, panel[None])
        costs = CROSSED * _overlap(boxes, thin) + HIDDEN * hidden + OUTSIDE * outside
        best = int(np.argmin(costs + FAR_AWAY * np.array([distance for _, distance in choices])))
        free = free and bool(hidden[best] + outside[best] < 1.0)
        solid = np.concatenate([solid, boxes[best : best + 1]])
        _annotate(axes, label, text, *choices[best], color)
    return free


def _annotate(axes: Axes, label: Label, text: str, side: Side, distance: float, color: str) -> None:
    """Write a text on one side of its point."""
    lead = {"arrowstyle": "-", "lw": 0.5, "color": REFERENCE, "shrinkA": 0, "shrinkB": 3}
    note = axes.annotate(
        text,
        (label.x, label.y),
        xytext=(side.right * distance, side.up * distance),
        textcoords="offset points",
        ha=("right", "center", "left")[1 + _sign(side.right)],
        va=("top", "center", "bottom")[1 + _sign(side.up)],
        arrowprops=lead if distance > LEADER else None,
        linespacing=1.0,
        color=color,
        zorder=5.0,
        gid=label.gid,
    )
    if note.arrow_patch is not None:
        note.arrow_patch.set_gid(label.gid)


def _sign(part: float) -> int:
    return (part > 0) - (part < 0)


def _points_per_pixel(axes: Axes) -> float:
    figure = axes.get_figure(root=True)
    assert figure is not None
    return POINTS_PER_INCH / figure.dpi


def _on_paper(axes: Axes, data: Array) -> Array:
    """Where points of the panel lie [points], last axis x and y."""
    return np.asarray(_points_per_pixel(axes) * axes.transData.transform(data))


def _around(place: Array, reach: float) -> Array:
    return np.concatenate([place - reach, place + reach])


def _beside(place: Array, extent: tuple[float, float], side: Side, distance: float) -> Array:
    """Box of a text of some width and height that begins at a distance from a point."""
    across, up = extent
    left = place[0] + side.right * distance - across * (1 - _sign(side.right)) / 2
    bottom = place[1] + side.up * distance - up * (1 - _sign(side.up)) / 2
    return np.array([left, bottom, left + across, bottom + up])


def _along(line: Array, panel: Array) -> Boxes:
    """Small boxes along a broken line, as far as it lies in the panel."""
    line = np.clip(line[np.isfinite(line).all(axis=1)], panel[:2] - STEP, panel[2:] + STEP)
    if len(line) < 2:
        return np.zeros((0, 4))
    reached = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    stops = np.linspace(0.0, reached[-1], 2 + int(reached[-1] / STEP))
    points = np.stack([np.interp(stops, reached, line[:, place]) for place in (0, 1)], axis=1)
    return np.concatenate([points - 1.0, points + 1.0], axis=1)


def _overlap(boxes: Boxes, others: Boxes) -> Array:
    """Area of every box that others cover, (boxes,)."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    return np.asarray(np.prod(np.maximum(high - low, 0.0), axis=2).sum(axis=1))
