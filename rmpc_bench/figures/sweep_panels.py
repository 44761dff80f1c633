"""Panels over a swept value: curves over numbers, rows of marks over categories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.figures.axes import drawable, few_ticks, make_logarithmic, stacked_panels
from rmpc_bench.figures.labels import LINEAR, POINTS_PER_INCH, literal, metric_label, typeset, with_unit, wrapped
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import LineStyle, line_styles
from rmpc_bench.figures.paired import BAND
from rmpc_bench.figures.style import REFERENCE, style
from rmpc_bench.figures.sweep_axis import SweepAxis
from rmpc_bench.figures.sweep_values import PointValue, SweepValues, change_label, interval_words, runs_words
from rmpc_bench.types import Array, MetricInfo
from rmpc_bench.types.figure import SweepFigure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.lines import Line2D

    from rmpc_bench.analysis.trials import Trials

MEANING = {
    "quartiles": "medians, {}: interquartile range",
    "se": "means, {}: standard errors",
    "interval": "means, {}: {} % intervals",
}
"""Spread -> what lines and spreads are."""
BEST = {"one": 1.0, "zero": 0.0}
"""Best values of the metrics for which neither low nor high values are best."""
MOST_BANDS = 3
"""Methods whose bands a reader can distinguish in one panel."""
ALPHA = 0.18
APART = 3.0
"""Distance of the bars of two methods at one value [points]."""
ROW, ROWS, PANEL = 0.13, 0.1, 0.35
"""Heights of a row, between categories, and of a panel without its rows [in]."""
LABEL_SHARE = 0.3
"""Share of the width that the name of a category may take before it is broken."""


class SweepContent(NamedTuple):
    """What a figure over a swept value shows."""

    info: MetricInfo
    axis: SweepAxis
    panels: Mapping[str, Mapping[str, int]]
    """Title, empty if nothing else is swept -> value of the axis -> place in the rows of the values."""
    values: SweepValues

    def of(self, title: str, method: str) -> dict[str, PointValue]:
        """Return the values of a method in a panel by the value of the axis, in the order of the axis."""
        places = self.panels[title]
        found = {text: self.values.rows[places[text]] for text in self.axis.texts if text in places}
        return {text: row[method] for text, row in found.items() if method in row}


def draw_sweep(
    keys: SweepFigure, trials: Trials, content: SweepContent, *, drawn: str, spread: str, log: bool
) -> MplFigure:
    """Draw all panels with the size and by the keys of the figure."""
    from matplotlib.figure import Figure as MplFigure

    methods, in_rows = content.values.methods, content.axis.numbers is None
    n_rows = [len(places) for places in content.panels.values()]
    if in_rows:
        height = 0.6 + sum(PANEL + n * (ROWS + ROW * len(methods)) for n in n_rows)
    else:
        height = 1.2 + 1.4 * len(content.panels)
    size = keys.size(height)
    bands = drawn == "bands" or (drawn == "auto" and len(methods) <= MOST_BANDS)
    styles = line_styles(trials.all_methods, methods)
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        panels = stacked_panels(figure, len(content.panels))
        quantity, ends = _quantity(trials, content), {title: _shown_ends(content, title) for title in content.panels}
        if in_rows:
            # The panels have a common axis.
            ends = dict.fromkeys(ends, np.concatenate(list(ends.values())))
        for axes, title in zip(panels, content.panels, strict=True):
            axes.set_title("\n".join(wrapped(literal(title), 0.8 * size[0] * POINTS_PER_INCH)))
            lines = {name: content.of(title, name) for name in methods}
            _references(axes, content, horizontal=in_rows)
            (_draw_rows if in_rows else _draw_curves)(axes, content.axis, lines, styles, bands=bands)
            remark = _limit(axes, ends[title], log=log, horizontal=in_rows)
            if in_rows:
                texts = [text for text in content.axis.texts if text in content.panels[title]]
                _name_rows(axes, texts, LABEL_SHARE * size[0] * POINTS_PER_INCH)
            else:
                axes.set_ylabel("\n".join(wrapped(quantity, 1.3 * POINTS_PER_INCH)) + remark)
                axes.set_xlabel(content.axis.label if axes is panels[-1] else "")
        if in_rows:
            panels[-1].set_xlabel("\n".join(wrapped(quantity, 0.6 * size[0] * POINTS_PER_INCH)) + remark)
        handles: list[Handle] = [
            (trials.labels.get(name, name), _sample(styles[name], in_rows=in_rows)) for name in methods
        ]
        note = _note(trials, content, spread, "bands" if bands and not in_rows else "bars")
        finish(figure, handles, "; ".join(filter(None, [next(iter(content.panels)), note])))
    return figure


def _quantity(trials: Trials, content: SweepContent) -> str:
    """Label the axis of the metric or its change."""
    if not content.values.kind:
        return metric_label(content.info)
    return with_unit(typeset(change_label(trials, content.info, content.values.kind)), content.values.unit)


def _sample(look: LineStyle, *, in_rows: bool) -> Line2D:
    from matplotlib.lines import Line2D

    line = {"color": look.color, "ls": "-", "lw": 1.0, "gid": look.gid} if in_rows else look.line()
    return Line2D([], [], **_mark(look), **line)


def _mark(look: LineStyle) -> dict[str, Any]:
    return {"marker": look.marker, "ms": 3.5, "mew": 0.6}


def _references(axes: Axes, content: SweepContent, *, horizontal: bool) -> None:
    """Mark no change with the margin of relevance, or the best value of a metric."""
    line, span = (axes.axvline, axes.axvspan) if horizontal else (axes.axhline, axes.axhspan)
    if content.values.kind:
        if content.values.margin[1] > 0:
            span(*content.values.margin, color=BAND, lw=0, zorder=0.2)
        line(0.0, color=REFERENCE, lw=0.9, zorder=2.1)
    elif content.info.direction in BEST:
        line(BEST[content.info.direction], color=REFERENCE, lw=0.9, zorder=2.1)


def _draw_curves(
    axes: Axes,
    axis: SweepAxis,
    lines: Mapping[str, Mapping[str, PointValue]],
    styles: Mapping[str, LineStyle],
    *,
    bands: bool,
) -> None:
    """Draw a curve per method over the swept numbers, with a band or with bars beside those of the others."""
    few_ticks(axes)
    axis.scale(axes)
    for place, (name, line) in enumerate(lines.items()):
        x = np.array([axis.position(text) for text in line])
        low, middle, high = _ends(line)
        look, shift = styles[name], 0.0 if bands else APART * (place - (len(lines) - 1) / 2)
        place_of = {} if bands else {"transform": _shifted(axes, shift)}
        axes.plot(x, np.where(np.isfinite(middle), middle, np.nan), **_mark(look), **look.line(), **place_of)
        if bands:
            axes.fill_between(x, low, high, color=look.color, alpha=ALPHA, linewidth=0, zorder=1.5, gid=look.gid)
            for edge in (low, high):
                axes.plot(x, edge, **{**look.line(), "lw": 0.5, "zorder": 1.6})
        else:
            axes.vlines(x, low, high, color=look.color, lw=0.9, zorder=2.4, gid=look.gid, **place_of)


def _draw_rows(
    axes: Axes,
    axis: SweepAxis,
    lines: Mapping[str, Mapping[str, PointValue]],
    styles: Mapping[str, LineStyle],
    *,
    bands: bool,
) -> None:
    """Draw a row per category, with a mark and a bar per method one below the other."""
    texts = [text for text in axis.texts if any(text in line for line in lines.values())]
    height = ROW / (ROWS + ROW * len(lines))
    for place, (name, line) in enumerate(lines.items()):
        low, middle, high = _ends(line)
        y = np.array([texts.index(text) for text in line]) + height * (place - (len(lines) - 1) / 2)
        look = styles[name]
        axes.hlines(y, low, high, color=look.color, lw=1.0, zorder=2.4, gid=look.gid)
        shown = np.where(np.isfinite(middle), middle, np.nan)
        axes.plot(shown, y, ls="", color=look.color, zorder=2.6, gid=look.gid, **_mark(look))


def _name_rows(axes: Axes, texts: Sequence[str], limit: float) -> None:
    axes.set_yticks(range(len(texts)), ["\n".join(wrapped(typeset(text), limit)) for text in texts])
    axes.set_ylim(len(texts) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    for edge in range(1, len(texts)):
        axes.axhline(edge - 0.5, color=REFERENCE, lw=0.3, zorder=0.5)


def _ends(line: Mapping[str, PointValue]) -> tuple[Array, Array, Array]:
    ends = np.array([value[:3] for value in line.values()], dtype=float).reshape(-1, 3)
    return drawable(ends[:, 0]), ends[:, 1], drawable(ends[:, 2])


def _shifted(axes: Axes, points: float) -> Any:
    """Transformation of data that is moved to the right by some points, so that bars stand side by side."""
    from matplotlib.transforms import ScaledTranslation

    figure = axes.get_figure(root=True)
    assert figure is not None
    return axes.transData + ScaledTranslation(points / POINTS_PER_INCH, 0.0, figure.dpi_scale_trans)


def _shown_ends(content: SweepContent, title: str) -> Array:
    """Return the finite ends of all spreads of a panel, and what every panel shows of the references."""
    lines = [content.of(title, name) for name in content.values.methods]
    ends = [end for line in lines for value in line.values() for end in value[:3]]
    if content.values.kind:
        ends.append(0.0)
    elif content.info.direction in BEST:
        ends.append(BEST[content.info.direction])
    found = np.array(ends, dtype=float)
    return np.asarray(found[np.isfinite(found)])


def _limit(axes: Axes, ends: Array, *, log: bool, horizontal: bool) -> str:
    """Choose scale and limits of the axis of the values; return a remark for its label."""
    if not len(ends):
        return ""
    if log and (ends <= 0).any():
        return LINEAR + _limit(axes, ends, log=False, horizontal=horizontal)
    forward, back = (np.log10, lambda number: 10.0**number) if log else (np.asarray, np.asarray)
    low, high = (float(forward(end)) for end in (ends.min(), ends.max()))
    margin = 0.06 * (high - low) or 0.05 * abs(low) or 1.0
    limits = float(back(low - margin)), float(back(high + margin))
    (axes.set_xlim if horizontal else axes.set_ylim)(limits)
    if log:
        make_logarithmic(axes, horizontal=horizontal)
    return ""


def _note(trials: Trials, content: SweepContent, spread: str, word: str) -> str:
    """Explain the marks and count the runs."""
    values = content.values
    if values.kind:
        return f"{word}: {interval_words(trials, values)}; {runs_words(values, 'paired run')}"
    meaning = MEANING[spread].format(word, f"{100 * trials.confidence:g}")
    n = runs_words(values)
    return n if n == "1 run" else f"{meaning}, {n}"
