"""The boxplot: one box per method in the form of zenere2018, Fig. 7; the points of a sweep as panels, as in Fig. 8."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cbook import boxplot_stats
from matplotlib.figure import Figure
from matplotlib.text import Text

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.curves import FAR, make_logarithmic
from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, typeset, width, with_unit, wrapped
from rmpc_bench.figures.style import BLUE, FONT_SIZE, GREY, RED, style
from rmpc_bench.figures.sweep_points import short
from rmpc_bench.types import Array, MetricInfo


def draw(
    points: Sequence[Trials], info: MetricInfo, methods: Sequence[str], size: tuple[float, float], *, log: bool
) -> Figure:
    """Draw the boxes of one metric; see `figures.boxplot`.

    Parameters
    ----------
    points : the tables to show from top to bottom
    info : the metric
    methods : methods from left to right
    size : width and height [in]
    log : logarithmic axis where all values are positive
    """
    panels = [[point.column(info.name, method) for method in methods] for point in points]
    drawn = np.concatenate([column[np.isfinite(column)] for column in chain(*panels)])
    positive = bool((drawn > 0).all())
    with style():
        figure = Figure(figsize=size, layout="constrained")
        rows = list(figure.subplots(len(panels), sharey=True, squeeze=False)[:, 0])
        for axes, columns, point in zip(rows, panels, points, strict=True):
            _draw_boxes(axes, columns)
            axes.set_title("\n".join(wrapped(literal(short(point)), 0.8 * size[0] * POINTS_PER_INCH)))
        if not len(drawn):
            rows[0].set_yticks([])
        elif log and positive:
            make_logarithmic(rows[0])
        note = " (linear: some values <= 0)" if log and not positive else ""
        name = _name_axis(figure, rows, with_unit(literal(info.name), info.unit) + note)
        figure.draw_without_rendering()  # tells how wide a box may be
        slot = rows[0].get_position().width * size[0] * POINTS_PER_INCH / len(methods) - FONT_SIZE / 2
        labels = [typeset(points[0].labels.get(method, method)) for method in methods]
        _label_panels(rows, labels, panels, slot)
        # The layout is made once, at one resolution, or a second save would move it.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        if len(rows) > 1:
            name.set_y((rows[0].get_position().y1 + rows[-1].get_position().y0) / 2)
    return figure


def _name_axis(figure: Figure, rows: Sequence[Axes], text: str) -> Text:
    """Label the axis of a single panel, or the one that panels share."""
    if len(rows) == 1:
        rows[0].set_ylabel(text)
        return rows[0].yaxis.label
    return figure.supylabel(text, fontsize=FONT_SIZE)


def _draw_boxes(axes: Axes, columns: Sequence[Array]) -> None:
    boxes, positions = [], []
    for position, column in enumerate(columns, start=1):
        values = column[np.isfinite(column)]
        if len(values):
            boxes += boxplot_stats(np.clip(values, -FAR, FAR), whis=1.5)
            positions.append(position)
    axes.bxp(
        boxes,
        positions=positions,
        widths=0.5,
        manage_ticks=False,
        boxprops={"color": BLUE, "linewidth": 1.0},
        medianprops={"color": RED, "linewidth": 1.4},
        whiskerprops={"color": "black", "linewidth": 0.7, "linestyle": (0, (4, 2))},
        capprops={"color": "black", "linewidth": 0.7},
        flierprops={"marker": "+", "markeredgecolor": RED, "markersize": 4, "markeredgewidth": 0.7},
    )
    axes.set_xlim(0.5, len(columns) + 0.5)
    axes.set_xticks([])
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y", color=GREY, linewidth=0.4)
    axes.set_axisbelow(True)


def _label_panels(rows: Sequence[Axes], labels: Sequence[str], panels: Sequence[Sequence[Array]], slot: float) -> None:
    """Write labels and counts below the last panel; counts below the others, too, where they differ."""
    counts = [[_counts(column) for column in columns] for columns in panels]
    for axes, lines in zip(rows[:-1], counts[:-1], strict=True):
        if any(other != lines for other in counts):
            _label_boxes(axes, None, lines, slot)
    _label_boxes(rows[-1], labels, counts[-1], slot)


def _label_boxes(axes: Axes, labels: Sequence[str] | None, counts: Sequence[list[str]], slot: float) -> None:
    """Write label and counts below each box, upright on one line where they do not fit into `slot` points."""
    heads = [wrapped(label, slot) for label in labels] if labels else [[] for _ in counts]
    blocks = [head + lines for head, lines in zip(heads, counts, strict=True)]
    upright = any(width(line) > slot for line in chain(*blocks))
    if upright:
        heads = [label.splitlines() for label in labels] if labels else heads
        blocks = [[", ".join(head + lines)] for head, lines in zip(heads, counts, strict=True)]
        figure = axes.get_figure(root=True)
        assert figure is not None
        figure.set_figheight(figure.get_figheight() + max(width(line) for (line,) in blocks) / POINTS_PER_INCH)
    texts = ["\n".join(block) for block in blocks]
    axes.set_xticks(range(1, len(texts) + 1), texts, rotation=90 if upright else 0)


def _counts(column: Array) -> list[str]:
    n, never = int((~np.isnan(column)).sum()), int(np.isinf(column).sum())
    lines = [f"n={n}" if n == len(column) else f"{n}/{len(column)}"]
    if never:
        lines.append(f"{never} never")
    return lines if n else ["no value", *lines]
