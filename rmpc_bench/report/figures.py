"""Pictures of the table of trials, at the width of a printed column."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cbook import boxplot_stats, is_math_text
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser
from matplotlib.textpath import TextToPath
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array, DesignError, MetricInfo

RED, BLUE, GREY = "#d7191c", "#0b5ba8", "#d9d9d9"
POINTS_PER_INCH = 72
FONT, FONT_SIZE = "DejaVu Sans", 8  # comes with matplotlib
STYLE: dict[Any, Any] = {
    "font.family": FONT,
    "font.size": FONT_SIZE,
    "axes.labelsize": FONT_SIZE,
    "xtick.labelsize": FONT_SIZE,
    "ytick.labelsize": FONT_SIZE,
    "axes.linewidth": 0.6,
    "ytick.major.width": 0.6,
    "ytick.minor.width": 0.4,
    "svg.fonttype": "path",  # the same picture in every viewer
    "svg.hashsalt": "rmpc-bench",
}


@contextmanager
def _style() -> Iterator[None]:
    """Draw with our parameters on top of matplotlib's own, whatever the user's matplotlibrc says."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield


def boxplot(
    trials: Trials,
    *,
    metric: str | None = None,
    width: float = 3.5,
    height: float = 2.4,
    log: bool = False,
    order: list[str] | None = None,
) -> Figure:
    """Draw one box per method: red median, blue quartiles, whiskers to 1.5 of their distance, red outliers.

    Below a box stands the number of runs, as n/total where some failed, and how many of them are never; these are
    not part of the box.

    Parameters
    ----------
    trials : the table of trials
    metric : name of the metric; the first one if not given
    width, height : of the whole picture [in]; labels too wide for their box stand upright and add to the height
    log : logarithmic axis; linear nevertheless, and said so, where a value is not positive
    order : methods to show, from left to right; all if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when a metric or method is unknown or the size below an inch
    """
    info = _metric(trials, metric)
    methods = _methods(trials, order)
    for name, size in (("width", width), ("height", height)):
        if not 1 <= size < np.inf:
            raise DesignError(f"must be at least 1 inch (got {size:g})", name)
    columns = [trials.column(info.name, method) for method in methods]
    positive = all((column[np.isfinite(column)] > 0).all() for column in columns)
    with _style():
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.add_subplot()
        _draw_boxes(axes, columns)
        axes.set_ylabel(_axis_label(info) + (" (linear: some values <= 0)" if log and not positive else ""))
        if log and positive and any(np.isfinite(column).any() for column in columns):
            _make_logarithmic(axes)
        # The vertical axis with its labels takes up to three quarters of an inch.
        slot = max(0.0, width - 0.75) * POINTS_PER_INCH / len(methods) - FONT_SIZE / 2
        _label_boxes(axes, [trials.labels.get(method, method) for method in methods], columns, slot)
        # The layout is made once, at one resolution, or a second save would move it.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
    return figure


def save(figure: Figure, directory: Path, stem: str) -> list[Path]:
    """Write a picture as SVG and as PNG (200 dpi), with the same bytes every time.

    Parameters
    ----------
    figure : the picture
    directory : where to; made if it is not there
    stem : file name without ending

    Returns
    -------
    the two files
    """
    directory.mkdir(parents=True, exist_ok=True)
    svg, png = directory / f"{stem}.svg", directory / f"{stem}.png"
    with _style():
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
        figure.savefig(png, format="png", dpi=200, metadata={"Software": None})
    return [svg, png]


def _metric(trials: Trials, name: str | None) -> MetricInfo:
    known = {info.name: info for info in trials.metrics}
    if name is None:
        return trials.metrics[0]
    if name not in known:
        raise DesignError(f"'{name}' is not a metric of this experiment (known: {', '.join(known)})", "metric")
    return known[name]


def _methods(trials: Trials, order: list[str] | None) -> Sequence[str]:
    if order is None:
        return trials.methods
    for name in order:
        if name not in trials.methods:
            known = ", ".join(trials.methods)
            raise DesignError(f"'{name}' is not a method of this experiment (known: {known})", "order")
    if not order or len(set(order)) < len(order):
        raise DesignError("must name at least one method, and each one once", "order")
    return order


def _draw_boxes(axes: Axes, columns: Sequence[Array]) -> None:
    boxes, positions = [], []
    for position, column in enumerate(columns, start=1):
        values = column[np.isfinite(column)]
        if len(values):
            with np.errstate(over="ignore", invalid="ignore"):  # of the mean, which is not shown
                boxes += boxplot_stats(values, whis=1.5)
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
