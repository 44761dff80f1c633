"""The boxplot: one box per method in the form of zenere2018, Figs. 7 and 8."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cbook import boxplot_stats, is_math_text
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser
from matplotlib.textpath import TextToPath
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.style import BLUE, FONT, FONT_SIZE, GREY, RED, style
from rmpc_bench.types import Array, MetricInfo

POINTS_PER_INCH = 72
FAR = 1e100  # matplotlib cannot draw the last values on the way to divergence; what lies beyond is drawn here


def draw(trials: Trials, info: MetricInfo, methods: Sequence[str], size: tuple[float, float], *, log: bool) -> Figure:
    """Draw the boxes of one metric; see `figures.boxplot`.

    Parameters
    ----------
    trials : the table of trials
    info : the metric
    methods : methods from left to right
    size : width and height [in]
    log : logarithmic axis where all values are positive
    """
    columns = [trials.column(info.name, method) for method in methods]
    positive = all((column[np.isfinite(column)] > 0).all() for column in columns)
    with style():
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.add_subplot()
        _draw_boxes(axes, columns)
        axes.set_ylabel(_axis_label(info) + (" (linear: some values <= 0)" if log and not positive else ""))
        if log and positive and any(np.isfinite(column).any() for column in columns):
            _make_logarithmic(axes)
        axes.set_xticks([])
        figure.draw_without_rendering()  # tells how wide a box may be
        slot = axes.get_position().width * size[0] * POINTS_PER_INCH / len(methods) - FONT_SIZE / 2
        _label_boxes(axes, [trials.labels.get(method, method) for method in methods], columns, slot)
        # The layout is made once, at one resolution, or a second save would move it.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
    return figure


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
    axes.grid(axis="y", color=GREY, linewidth=0.4)
    axes.set_axisbelow(True)
    if not boxes:
        axes.set_yticks([])


def _make_logarithmic(axes: Axes) -> None:
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    if high < 1e3 * low:
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())


def _label_boxes(axes: Axes, labels: Sequence[str], columns: Sequence[Array], slot: float) -> None:
    """Write label and counts below each box, upright on one line where they do not fit into `slot` points."""
    typeset = [_typeset(label) for label in labels]
    blocks = [_wrapped(label, slot) + _counts(column) for label, column in zip(typeset, columns, strict=True)]
    upright = any(_width(line) > slot for block in blocks for line in block)
    if upright:
        blocks = [
            [", ".join([*label.splitlines(), *_counts(column)])] for label, column in zip(typeset, columns, strict=True)
        ]
        figure = axes.get_figure(root=True)
        assert figure is not None
        figure.set_figheight(figure.get_figheight() + max(_width(line) for (line,) in blocks) / POINTS_PER_INCH)
    texts = ["\n".join(block) for block in blocks]
    axes.set_xticks(range(1, len(texts) + 1), texts, rotation=90 if upright else 0)
    axes.tick_params(axis="x", length=0)


def _counts(column: Array) -> list[str]:
    n, never = int((~np.isnan(column)).sum()), int(np.isinf(column).sum())
    lines = [f"n={n}" if n == len(column) else f"{n}/{len(column)}"]
    if never:
        lines.append(f"{never} never")
    return lines if n else ["no value", *lines]


def _typeset(text: str) -> str:
    """Keep `$...$` where matplotlib can set it, else make the text literal."""
    try:
        for line in text.split("\n"):
            MathTextParser("path").parse(line)
    except ValueError:
        return _literal(text)
    return text


def _literal(text: str) -> str:
    return text.replace(r"\$", "$").replace("$", r"\$")


def _axis_label(info: MetricInfo) -> str:
    """Name and unit, such as mse [rad^2], with the exponents raised."""
    if not info.unit:
        return _literal(info.name)
    unit = re.sub(r"\^(-?\d+(?:\.\d+)?)", r"$^{\1}$", _literal(info.unit))
    return f"{_literal(info.name)} [{unit}]"


def _wrapped(text: str, limit: float) -> list[str]:
    """Break a label at the blanks outside its formulas so that no line is wider than `limit` points, if possible."""
    lines: list[str] = []
    for paragraph in text.splitlines():
        words = re.findall(r"(?:\\\$|\$(?:\\.|[^$])*\$|\S)+", paragraph)
        for index, word in enumerate(words):
            if index and _width(f"{lines[-1]} {word}") <= limit:
                lines[-1] += f" {word}"
            else:
                lines.append(word)
    return lines or [""]


def _width(text: str) -> float:
    """Width of one line of a label in points."""
    formula = is_math_text(text)
    font = FontProperties(family=FONT, size=FONT_SIZE)
    line = text if formula else text.replace(r"\$", "$")
    return float(TextToPath().get_text_width_height_descent(line, font, formula)[0])
