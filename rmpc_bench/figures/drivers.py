"""Which uncertain quantities drive a metric: shares of its variance, and the metric against the strongest of them."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np

from rmpc_bench.analysis.driver_text import PAIRED, response_text, share_text
from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures import captions
from rmpc_bench.figures.axes import drawable, few_ticks
from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, metric_of, with_unit, wrapped
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import LineStyle, line_styles, paler
from rmpc_bench.figures.method_groups import grouped
from rmpc_bench.figures.shared_content import shared_content
from rmpc_bench.figures.style import BLACK, GREY, REFERENCE, style
from rmpc_bench.figures.sweep_points import point_at
from rmpc_bench.types import Array, DesignError, MetricInfo, ResultLayout
from rmpc_bench.types.figure import OnePointFigure
from rmpc_bench.types.issue import Issue

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.responses import Response
    from rmpc_bench.analysis.trials import Trials

MOST_QUANTITIES = 8
"""Quantities with bars; of more the strongest ones are shown."""
MOST_POINTS = 500
"""Runs of a method that are drawn as points; of more every second one, or fewer, are shown."""
REST_LABEL = "not explained"
NO_QUANTITY = "needs an uncertain quantity: there is none under `uncertainty`"
N_CURVE = 41
ROW, PANEL = 0.12, 1.5
"""Height of a bar and of a panel with points [in]."""


@dataclass(frozen=True, kw_only=True)
class Drivers(OnePointFigure):
    """Shares of a metric's variance that uncertain quantities explain, and the metric against the strongest of them.

    A bar is the total effect of a quantity on the log ratio of a method to the baseline: what the adjusted R^2 of a
    quadratic response surface loses without all terms of the quantity.  Total effects need not sum to 100 %.  Lines are
    intervals from a bootstrap of whole runs.  The last group of bars is what no quantity explains.  The panels below
    show the response in every run and a quadratic fit to the quantity alone.  Below 50 runs there are no bars and no
    curves.

    Parameters
    ----------
    metric : name of the metric; the primary one if not given
    panels : number of quantities, the strongest first, against which the response is drawn
    height : height of the whole picture [in]; if not given it follows from the numbers of bars and panels
    order : methods to show; all but the baseline if not given
    at : point of the sweep, by values of its paths; the first one if not given
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    metric: str | None = None
    panels: Literal[0, 1, 2, 3] = 2

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: uncertain quantities."""
        yield from super().check(layout)
        if not layout.is_uncertain:
            yield Issue("", NO_QUANTITY)

    def draw(self, results: Trials) -> MplFigure:
        """Draw bars and panels; see `Figure.draw`."""
        return _draw(self, results, self._content(results))

    def caption(self, results: Trials) -> str:
        """Say what bars, lines and curves are, with the shares of every method; see `Figure.caption`."""
        content = self._content(results)
        kind = content.responses[0].kind
        of = response_text(kind, content.info, content.trials.baseline)
        n = [int(response.known.sum()) for response in content.responses]
        runs = f"{min(n)}" if min(n) == max(n) else f"{min(n)} to {max(n)}"
        parts = [
            f"Share of the variance of {of} that each uncertain quantity explains in {runs} runs: what the adjusted "
            "$R^2$ of a quadratic response surface loses without all terms of the quantity. These total effects need "
            f"not sum to 100 %. Lines: {100 * content.trials.confidence:g} % intervals from a bootstrap of whole runs.",
        ]
        if self.panels and content.quantities:
            shown = " and ".join(content.quantities[: self.panels])
            drawn = "every run" if max(n) <= MOST_POINTS else f"at most {MOST_POINTS} runs of a method"
            parts.append(f"Below: {drawn} against {shown}; curves: quadratic fits to the quantity alone.")
        for method, rows in content.rows.items():
            texts = [f"{row['quantity']} {share_text(row)}" for row in _sorted(rows) if row["quantity"] != "(rest)"]
            parts.append(f"{method}: {', '.join(texts)}.")
        if content.title:
            parts.insert(1, f"{captions.place(content.trials, content.title)}.")
        return " ".join(parts)

    def _content(self, results: Trials) -> DriversContent:
        return shared_content(results, self, lambda: self._compute(results))

    def _compute(self, results: Trials) -> DriversContent:
        """Compute what the figure shows."""
        from rmpc_bench.analysis.drivers import FAILED, REST, drivers, inputs
        from rmpc_bench.analysis.responses import response_of

        self.require(layout_of(results))
        trials, title = point_at(results, self.at)
        info = metric_of(trials, self.metric)
        others = [name for name in trials.methods if name != trials.baseline]
        methods = [name for name in self.order or others or trials.methods if name in trials.methods]
        if trials.baseline in methods and len(methods) > 1:
            raise DesignError("the baseline is no ratio to itself; show it alone", "order")
        frame, values = drivers(trials, info, with_regions=False), dict(inputs(trials).values)
        if not len(frame):
            raise DesignError(NO_QUANTITY)
        shares = frame[frame["response"] != FAILED]
        rows = {name: shares[shares["method"] == name].to_dict("records") for name in methods}
        largest = {
            name: max(_strength(row) for each in rows.values() for row in each if row["quantity"] == name)
            for name in values
        }
        quantities = sorted(values, key=lambda name: -largest[name])
        responses = [response_of(trials, name, info) for name in methods]
        return DriversContent(trials, title, info, rows, quantities, responses, values, REST)


class DriversContent(NamedTuple):
    """What the figure shows."""

    trials: Trials
    title: str
    info: MetricInfo
    rows: Mapping[str, Sequence[Mapping[Hashable, Any]]]
    """Method -> its rows of `rmpc_bench.analysis.drivers`."""
    quantities: Sequence[str]
    """The strongest first."""
    responses: Sequence[Response]
    values: Mapping[str, Array]
    """Quantity -> (n_runs,) values."""
    rest: str
    """Name of the row of what no quantity explains."""


def _strength(row: Mapping[Hashable, Any]) -> float:
    return float(row["share"]) if row["share"] == row["share"] else 0.0


def _sorted(rows: Sequence[Mapping[Hashable, Any]]) -> list[Mapping[Hashable, Any]]:
    return sorted(rows, key=lambda row: -_strength(row))


def _draw(keys: Drivers, results: Trials, content: DriversContent) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure

    shown = list(content.quantities[:MOST_QUANTITIES])
    strongest = content.quantities[: keys.panels]
    bars = 0.6 + ROW * (len(content.rows) + 0.6) * (len(shown) + 1)
    size = keys.size(bars + PANEL * bool(strongest))
    styles = line_styles(results.all_methods, list(content.rows))
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        heights = [bars, PANEL] if strongest else [bars]
        grid = figure.add_gridspec(len(heights), max(1, len(strongest)), height_ratios=heights)
        top = figure.add_subplot(grid[0, :])
        _bars(top, content, shown, styles, size[0])
        first: Axes | None = None
        for place, quantity in enumerate(strongest):
            axes = figure.add_subplot(grid[1, place], sharey=first)
            _points(axes, content, quantity, styles)
            if first is None:
                first = axes
                # A label of the axis would be aligned with the names of the quantities, far from the panel.
                axes.set_title(_response_label(content), loc="left")
            else:
                axes.tick_params(labelleft=False)
        finish(figure, _handles(results, content, styles), _note(content, len(shown)))
    return figure


def _bars(
    axes: Axes, content: DriversContent, shown: Sequence[str], styles: Mapping[str, LineStyle], width: float
) -> None:
    """Draw a group of bars per quantity and one for what none of them explains."""
    n = len(content.rows)
    groups = [*shown, content.rest]
    for group, quantity in enumerate(groups):
        for place, (method, rows) in enumerate(content.rows.items()):
            row = next(row for row in rows if row["quantity"] == quantity)
            y = group * (n + 0.6) + place
            with grouped(axes, styles[method].gid):
                _bar(axes, row, y, styles[method])
    middle = [group * (n + 0.6) + (n - 1) / 2 for group in range(len(groups))]
    labels = [*(literal(name) for name in shown), REST_LABEL]
    axes.set_yticks(middle, ["\n".join(wrapped(label, 0.3 * width * POINTS_PER_INCH)) for label in labels])
    axes.set_ylim(len(groups) * (n + 0.6) - 0.8, -0.8)
    axes.set_xlim(0.0, 100.0)
    axes.grid(color=GREY, linewidth=0.4, axis="x")
    axes.set_axisbelow(True)
    of = response_text(content.responses[0].kind, content.info, content.trials.baseline)
    label = literal(f"share of the variance of {of} [%]")
    axes.set_xlabel("\n".join(wrapped(label, 0.62 * width * POINTS_PER_INCH)))


def _bar(axes: Axes, row: Mapping[Any, Any], y: float, look: LineStyle) -> None:
    """Draw the share of one quantity with its interval, or say why there is none."""
    if row["share"] != row["share"] or not row["resolved"]:
        axes.text(1.0, y, share_text(row), color=look.color, va="center", fontsize="small")
        return
    share = 100 * min(1.0, max(0.0, float(row["share"])))
    face = paler(look.color, 0.35)
    axes.barh(y, share, 0.85, color=face, edgecolor=BLACK, linewidth=0.3, zorder=2.1)
    ends = np.clip(100 * np.array([row["share_low"], row["share_high"]], dtype=float), 0.0, 100.0)
    axes.plot(ends, [y, y], color=BLACK, lw=0.9, zorder=2.5)


def _points(axes: Axes, content: DriversContent, quantity: str, styles: Mapping[str, LineStyle]) -> None:
    """Draw the response of the runs, at most `MOST_POINTS`, against one quantity, with the fitted curve."""
    from matplotlib.ticker import MaxNLocator

    x = content.values[quantity]
    if content.responses[0].kind in PAIRED:
        axes.axhline(0.0, color=REFERENCE, lw=0.9, zorder=2.0)
    for response in content.responses:
        look, known = styles[response.method], response.known
        step = -(-int(known.sum()) // MOST_POINTS) or 1
        y = np.array([response.shown(float(value)) for value in response.values[known][::step]])
        mark: dict[str, Any] = {"marker": look.marker, "ms": 1.6, "mew": 0.0, "ls": "", "gid": look.gid}
        axes.plot(x[known][::step], drawable(y), color=paler(look.color, 0.5), zorder=2.2, **mark)
    for response in content.responses:
        at, fitted = _curve(content, response, quantity)
        axes.plot(at, drawable(fitted), **{**styles[response.method].line(), "zorder": 2.6})
    few_ticks(axes)
    axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    axes.grid(color=GREY, linewidth=0.4)
    axes.set_axisbelow(True)
    axes.set_xlabel(literal(quantity))


def _curve(content: DriversContent, response: Response, quantity: str) -> tuple[Array, Array]:
    """Evaluate the fit over the range of a quantity; empty where nothing is resolved."""
    from rmpc_bench.analysis.response_surface import curve

    known = response.known
    x, row = content.values[quantity][known], content.rows[response.method][0]
    if row["share"] != row["share"] or not len(x) or np.ptp(x) == 0:
        return np.zeros(0), np.zeros(0)
    at = np.linspace(x.min(), x.max(), N_CURVE)
    found = curve(x, response.values[known], at)
    return at, np.array([response.shown(float(value)) for value in found])


def _response_label(content: DriversContent) -> str:
    """Name the vertical axis of the panels in the unit in which a response is written."""
    response, name = content.responses[0], literal(content.info.name)
    paired = response.method != content.trials.baseline
    text = f"change of {name} against {literal(content.trials.baseline)}" if paired else name
    return with_unit(text, response.unit(content.info))


def _handles(results: Trials, content: DriversContent, styles: Mapping[str, LineStyle]) -> list[Handle]:
    from matplotlib.patches import Patch

    found: list[Handle] = []
    for name in content.rows:
        look = styles[name]
        face = paler(look.color, 0.35)
        patch = Patch(facecolor=face, edgecolor=BLACK, linewidth=0.3, gid=look.gid)
        found.append((results.labels.get(name, name), patch))
    return found


def _note(content: DriversContent, n_shown: int) -> str:
    """Name the point of the sweep, the runs, and what is left out."""
    n = [int(response.known.sum()) for response in content.responses]
    parts = [content.title, f"{min(n)} runs" if min(n) == max(n) else f"{min(n)} to {max(n)} runs"]
    failed = {name: content.trials.n_failed(name) for name in (content.trials.baseline, *content.rows)}
    texts = [f"{name} {count}" for name, count in failed.items() if count]
    parts += [f"failed: {', '.join(texts)}"] if texts else []
    left = len(content.quantities) - n_shown
    parts += [f"{left} weaker quantities in drivers.csv"] if left else []
    return ", ".join(filter(None, parts))
