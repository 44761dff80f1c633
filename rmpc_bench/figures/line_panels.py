"""Panels of lines over a swept number, one line per method with its intervals, and the names at the ends of lines."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.figures.axes import NONE, Axis, change_axis, draw_no_change, scaled_axis, set_axis, stacked_panels
from rmpc_bench.figures.labels import LINEAR, literal, name_of, shortened, typeset, width, with_unit, wrapped
from rmpc_bench.figures.palette import DIM, INK, LineStyle, line_styles
from rmpc_bench.figures.style import LINE_HEIGHT, POINTS_PER_INCH, fix_layout, lay_out, new_figure, style
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.text import Annotation

    from rmpc_bench.figures.sweep_content import SweepContent

MOST_TICKS = 8
"""Ticks of the axis of changes in per cent."""
ALPHA = 0.13
"""Of the bands."""
NAME_SHARE = 0.3
"""Share of the width of the figure that a name may take before it is cut."""
BEYOND = {-1: " ▼", 1: " ▲"}
"""Behind the name of a line that ends below or above the axis."""


class Name(NamedTuple):
    """A name at the end of a line."""

    text: str
    place: float
    """Height, 0 at the lower end of the axis and 1 at the upper one."""
    color: str
    gid: str | None


def draw_lines(content: SweepContent, size: tuple[float, float]) -> MplFigure:
    """Draw the panels from top to bottom, on common axes."""
    axis, styles = _axis(content), line_styles(content.trials.all_methods, content.methods)
    with style():
        figure = new_figure(size)
        panels = stacked_panels(figure, len(content.panels))
        title, found = _title(content, 0.75 * size[0] * POINTS_PER_INCH, is_log=axis.log), []
        for axes, panel in zip(panels, content.panels, strict=True):
            axes.set_title("\n".join(filter(None, [*title, literal(panel)])), loc="left")
            title = []
            found.append((axes, _draw(axes, content, panel, axis, styles)))
        panels[-1].set_xlabel("\n".join(wrapped(content.axis.label, 0.6 * size[0] * POINTS_PER_INCH)))
        texts = [_write(axes, names, NAME_SHARE * size[0] * POINTS_PER_INCH) for axes, names in found]
        lay_out(figure)
        for (axes, _), written in zip(found, texts, strict=True):
            content.axis.scale(axes)
            _move_apart(axes, written)
        fix_layout(figure)
    return figure


def _title(content: SweepContent, room: float, *, is_log: bool) -> list[str]:
    """Say what is drawn, and which side is better where that fits on the line."""
    text = typeset(content.words)
    unit = content.info.unit if content.show == "value" or content.form == "difference" else ""
    text = with_unit(text, unit) + (LINEAR if content.log is True and not is_log else "")
    longer = text + content.better_if
    return [longer] if width(longer) <= room else wrapped(text, room)


def _axis(content: SweepContent) -> Axis:
    """Choose the vertical axis, the same for all panels."""
    found = [content.number(table, name) for table in content.tables for name in content.methods]
    if content.show == "value":
        return scaled_axis([end for each in found for end in each], content.log)
    return change_axis(content.form, found, content.margin, MOST_TICKS)


def _draw(axes: Axes, content: SweepContent, panel: str, axis: Axis, styles: dict[str, LineStyle]) -> list[Name]:
    """Draw the lines of a panel and return the names for their ends."""
    set_axis(axes, axis, upright=True)
    names = []
    if content.show == "change":
        base = content.trials.baseline
        draw_no_change(axes, content.form, content.margin, upright=True, gid=f"method-{base}")
        place = axis.place(NONE.get(content.form, 0.0))
        names.append(Name(name_of(content.trials, base), place, INK, f"method-{base}"))
    for name in content.methods:
        line = content.line(panel, name)
        if not line:
            continue
        look = styles[name]
        x = np.array([at for at, _ in line])
        middle, low, high = (_drawable(column, axis) for column in np.array([value for _, value in line]).T)
        known = np.isfinite(low) & np.isfinite(high)
        if known.any():
            axes.fill_between(x, low, high, where=known, color=look.color, alpha=ALPHA, lw=0, zorder=1.5, gid=look.gid)
        if len(x) == 1:
            axes.vlines(x, low, high, color=look.color, lw=0.9, zorder=2.4, gid=look.gid)
        marks: dict[str, Any] = {} if look.color == DIM else {"marker": look.marker, "ms": 3.2}
        axes.plot(x, middle, **look.line(), **marks)
        names.append(Name(name_of(content.trials, name), axis.place(float(middle[-1])), look.color, look.gid))
    return names


def _drawable(values: Array, axis: Axis) -> Array:
    """Limit numbers to ten lengths of the axis beyond its ends, which is all that can be drawn."""
    reach = 10 * (axis.high - axis.low)
    ends = np.array([axis.low - reach, axis.high + reach])
    low, high = np.exp(np.clip(ends, -200, 200)) if axis.log else ends
    return np.where(np.isnan(values), np.nan, np.clip(values, low, high))


def _write(axes: Axes, names: Sequence[Name], limit: float) -> list[Annotation]:
    """Write names at the right of a panel, each at the end of its line, with an arrow where it leaves the axis."""
    found = []
    for name in names:
        text = shortened(name.text, limit) + BEYOND.get((name.place > 1) - (name.place < 0), "")
        place = 1.02, min(max(name.place, 0.0), 1.0)
        look: dict[str, Any] = {"color": name.color, "gid": name.gid, "va": "center", "annotation_clip": False}
        found.append(axes.annotate(text, place, xycoords="axes fraction", **look))
    return found


def _move_apart(axes: Axes, texts: Sequence[Annotation]) -> None:
    """Move the names at the ends of lines apart; of more than fit, those of grey lines are left out first."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    gap = LINE_HEIGHT / (POINTS_PER_INCH * figure.get_figheight() * axes.get_position().height)
    most = 1 + int(1 / gap)
    kept = sorted(texts, key=lambda text: text.get_color() == DIM)[:most] if len(texts) > most else texts
    for text in texts:
        text.set_visible(text in kept)
    for text, place in zip(kept, apart([text.xy[1] for text in kept], gap), strict=True):
        text.xy = (text.xy[0], place)
        text.set_position(text.xy)


def apart(places: Sequence[float], gap: float) -> list[float]:
    """Move places from 0 to 1 as little as possible, so that neighbours have a distance; they must fit.

    Examples
    --------
    >>> apart([0.5, 0.5, 0.0], 0.25)
    [0.375, 0.625, 0.0]
    """
    order = sorted(range(len(places)), key=lambda k: places[k])
    blocks: list[list[float]] = []
    for rank, k in enumerate(order):
        blocks.append([places[k] - rank * gap])
        while len(blocks) > 1 and fmean(blocks[-2]) > fmean(blocks[-1]):
            blocks[-2:] = [blocks[-2] + blocks[-1]]
    highest = max(0.0, 1 - (len(places) - 1) * gap)
    fitted = [min(max(fmean(block), 0.0), highest) for block in blocks for _ in block]
    found = dict(zip(order, (place + rank * gap for rank, place in enumerate(fitted)), strict=True))
    return [found[k] for k in range(len(places))]
