"""Covariance ellipses of the methods among the runs (souto2011, Fig. 3)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import numpy as np
from annotated_types import Len

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import drawable, few_ticks, stacked_panels
from rmpc_bench.figures.curves import Curve, components
from rmpc_bench.figures.labels import (
    DID_NOT_OCCUR,
    at_point,
    joined,
    metric_label,
    metric_of,
    name_of,
    quantity,
    runs_sentence,
    sentence,
)
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.palette import DIM, LineStyle, grouped, line_styles, paler, sample
from rmpc_bench.figures.points import point_at
from rmpc_bench.figures.style import new_figure, style
from rmpc_bench.types import Array, DesignError, Positive
from rmpc_bench.types.errors import Issue
from rmpc_bench.types.figure import Index, OnePointFigure
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

N_POINTS = 181
FLAT = 1e-12  # distance from 1 of the correlation of a segment: the rounding of a singular P

THIN = 0.02
"""Width of an ellipse, relative to its length in units of the standard deviations, below which it looks like a line."""


class Ellipse(NamedTuple):
    """The ellipse (z - centre)' P^-1 (z - centre) = 1."""

    centre: Array  # (2,)
    P: Array  # (2, 2) covariance or shape matrix

    @property
    def shape(self) -> str:
        """What it looks like: ``ellipse``, ``segment``, ``point``, or ``none`` where P is no covariance or not finite.

        An ellipse so thin that both of its sides coincide on paper counts as a segment.
        """
        if outline(self, 1.0) is None:
            return "none"
        deviations = np.sqrt(np.diag(self.P))
        if not deviations.any():
            return "point"
        if not deviations.all():
            return "segment"
        correlation = min(1.0, abs(self.P[0, 1] + self.P[1, 0]) / 2 / float(deviations.prod()))
        return "segment" if math.sqrt(1 - correlation**2) < THIN else "ellipse"


def outline(ellipse: Ellipse, radius: float) -> Array | None:
    """Find the points z with (z - centre)' P^-1 (z - centre) = radius^2; the segment where P is singular.

    Return (points, 2) coordinates, two points for a segment; None where P is no covariance or not finite.
    """
    if not (np.isfinite(ellipse.P).all() and np.isfinite(ellipse.centre).all()):
        return None
    covariance = (ellipse.P[0, 1] + ellipse.P[1, 0]) / 2
    if min(ellipse.P[0, 0], ellipse.P[1, 1]) < 0:
        return None
    # Each coordinate in its own unit: states of very different sizes make no ellipse degenerate.
    deviations = np.sqrt(np.diag(ellipse.P))
    product = float(deviations.prod())
    if abs(covariance) > (1 + math.sqrt(FLAT)) * product:
        return None
    correlation = min(1.0, max(-1.0, covariance / product)) if product else 1.0
    t = np.array([0.0, math.pi]) if abs(correlation) > 1 - FLAT else np.linspace(0.0, 2 * math.pi, N_POINTS)
    across = math.sqrt(1 - correlation**2)
    unit = np.stack([np.cos(t), correlation * np.cos(t) + across * np.sin(t)], axis=1)
    return np.asarray(ellipse.centre + radius * deviations * unit)


RINGS: tuple[dict[str, Any], ...] = (
    {"ls": "-", "lw": 1.2},
    {"ls": (0, (4, 2)), "lw": 0.9},
    {"ls": (0, (1.2, 1.2)), "lw": 0.9},
    {"ls": (0, (7, 1.5, 1.2, 1.5)), "lw": 0.7},
)  # lines of the radii, the first one first
Radii = Annotated[tuple[Positive, ...], Len(1, len(RINGS))]
DOTS: dict[str, Any] = {"ls": "", "marker": "o", "ms": 1.7, "mew": 0.0}
BROAD = 2.0  # factor of the width of the lines of a segment, which a thin ellipse is not
END: dict[str, Any] = {"marker": "D", "ms": 3.0, "mew": 0.0}
POINT: dict[str, Any] = {"marker": "x", "ms": 8.0, "mew": 2.0}
REMARKS = {"ellipse": "", "segment": " (segment: $P$ is singular)", "point": " (point: $P = 0$)"}
REMARKS["none"] = " (no ellipse)"  # what the legend says of a shape
SERIES = ("mean(x_hat)", "P")  # series that give the centre and the shape of an ellipse


@dataclass(frozen=True, kw_only=True)
class Ellipses(OnePointFigure):
    """Covariance ellipses of the methods among the runs, one dot each.

    The centre of an ellipse (a cross) is the mean of the method's estimates, and its radius is s times the standard
    deviation of the reported covariance P: (z - c)' P^-1 (z - c) = s^2.  If P is singular, it is a broad segment with
    marks at its ends; if P is 0, a large cross.  Dots that are the same for all methods, such as true states, are
    grey.  Failed runs have none; the title counts them.

    Parameters
    ----------
    x : name of the metric that is the horizontal coordinate of the dots
    y : name of the metric that is the vertical coordinate of the dots
    k : the sample whose P and mean are shown; the last one if not given
    sigmas : radii of the ellipses in standard deviations, 4 at most: solid, dashed, dotted and dash-dotted
    components : the two states of the ellipses (counted from 0), the horizontal one first
    height : height of the whole picture [in]; if not given 2.6; long legends and titles add to it
    order : methods to show, later ones above earlier ones; all that have moments and P if not given
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("x", "y")

    x: str
    y: str
    k: Index | None = None
    sigmas: Radii = (1.0, 3.0)
    components: tuple[Index, Index] = (0, 1)

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: moments, a method that reports P, and two states."""
        yield from super().check(layout)
        yield from layout.require_series(*SERIES)
        yield from layout.require_series_of(self.order, *SERIES)
        n = layout.n_states(self.order, *SERIES)
        yield from layout.require_component("state", self.components, n, "components")
        yield from layout.require_pair("state", self.components, "components")
        if not 1 <= len(self.sigmas) <= len(RINGS) or not all(0 < radius < math.inf for radius in self.sigmas):
            yield Issue("sigmas", f"must be 1 to {len(RINGS)} positive numbers")

    def caption(self, results: Trials) -> str:
        """Define ellipses and dots, and count the runs; see `Figure.caption`."""
        point, title = point_at(results, self.at)
        methods = self.order or layout_of(point).methods_having(*SERIES)
        x, y = (metric_of(point, name) for name in (self.x, self.y))
        k, ellipses = ellipses_of(point, methods, self.components, self.k)
        radii = joined(f"{radius:g}" for radius in self.sigmas)
        names = joined(name_of(point, name) + REMARKS[ellipse.shape] for name, ellipse in ellipses.items())
        return sentence(
            f"Ellipses of the covariance $P$ that {names} report at k = {k}{at_point(title)}, with the radii {radii} "
            "standard deviations about the mean of the estimates (crosses), and dots of the runs in the plane of "
            f"{quantity(x)} and {quantity(y)}",
            runs_sentence([point], methods),
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw ellipses and runs of one point; see `Figure.draw`."""
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        infos = metric_of(point, self.x), metric_of(point, self.y)
        k, ellipses = ellipses_of(point, self.order or layout.methods_having(*SERIES), self.components, self.k)
        methods = list(ellipses)
        styles = line_styles(point.all_methods, methods)
        dots = dots_of(point, methods, *(info.name for info in infos))
        with style():
            figure = new_figure(self.size(2.6))
            (axes,) = stacked_panels(figure, 1)
            few_ticks(axes)
            handles: list[Handle] = []
            for name, ellipse in ellipses.items():
                look = styles[name]
                with grouped(axes, look.gid):
                    keys_of = _draw_ellipse(axes, ellipse, self.sigmas, look.color, look.zorder)
                handles.append((name_of(point, name) + REMARKS[ellipse.shape], sample(**keys_of, gid=look.gid)))
            radii = zip(self.sigmas, RINGS, strict=False)
            keys: list[Handle] = [(rf"${radius:g}\sigma$", sample(color=DIM, **ring)) for radius, ring in radii]
            keys += _draw_dots(axes, dots, styles)
            axes.set(xlabel=metric_label(infos[0]), ylabel=metric_label(infos[1]))
            finish(figure, handles, "\n".join(filter(None, [title, _note(k, dots)])), keys=keys)
        return figure


class Dots(NamedTuple):
    """The runs that did not fail and have finite values."""

    x: Array
    y: Array
    n_failed: int
    n_infinite: int


def ellipses_of(
    point: Trials, methods: Sequence[str], pair: tuple[int, int], k: int | None
) -> tuple[int, dict[str, Ellipse]]:
    """Find the ellipses of methods at sample k, or the last where all have P and mean(x_hat); DesignError if none."""
    entries = [*map(str, pair), *(f"{i},{j}" for i in pair for j in pair)]
    found: dict[str, list[Curve]] = {}
    for name in methods:
        known = components(point, "P", name) | components(point, "mean(x_hat)", name)
        found[name] = [known[entry].best for entry in entries]
    # Some curves may be constant.
    last = int(min(min([each.k[-1] for each in parts if len(each.k) > 1], default=0) for parts in found.values()))
    if k is not None and not 0 <= k <= last:
        raise DesignError(f"there is no sample {k} (the samples are 0 to {last})", "k")
    k = last if k is None else k
    values = {name: np.array([curve.at(k) for curve in parts]) for name, parts in found.items()}
    return k, {name: Ellipse(each[:2], each[2:].reshape(2, 2)) for name, each in values.items()}


def dots_of(point: Trials, methods: Sequence[str], x: str, y: str) -> dict[str, Dots]:
    """Find the dots of every method, or of the first one for all where the values do not depend on the method."""
    found = {name: (point.column(x, name), point.column(y, name)) for name in methods}
    first = found[methods[0]]
    # Columns are equal in the runs that both methods finished.
    pairs = [(a, b, ~(np.isnan(a) | np.isnan(b))) for each in found.values() for a, b in zip(first, each, strict=True)]
    common = all(np.array_equal(a[both], b[both]) for a, b, both in pairs)
    dots = {}
    for name in methods[:1] if common else methods:
        a, b = found[name]
        finite, n_infinite = np.isfinite(a) & np.isfinite(b), int((np.isinf(a) | np.isinf(b)).sum())
        dots[name] = Dots(drawable(a[finite]), drawable(b[finite]), point.n_failed(name), n_infinite)
    return dots


def _draw_ellipse(axes: Axes, ellipse: Ellipse, radii: Sequence[float], color: str, zorder: float) -> dict[str, Any]:
    """Draw one ellipse per radius and its centre; return the keywords of its sample in the legend."""
    look: dict[str, Any] = {"color": color}
    shape = ellipse.shape
    if shape == "none":
        return {**look, "lw": 1.3}
    if shape == "point":
        axes.plot(*drawable(ellipse.centre), ls="", zorder=zorder, **look, **POINT)
        return {**look, "ls": "", **POINT}
    broad = BROAD if shape == "segment" else 1.0
    for radius, ring in zip(radii, RINGS, strict=False):
        points = outline(ellipse, radius)
        if points is not None:
            x, y = drawable(points).T
            axes.plot(x, y, zorder=zorder, solid_capstyle="butt", **look, **{**ring, "lw": broad * ring["lw"]})
            if shape == "segment":
                ends = [0, len(x) // 2 if len(x) > 2 else 1]
                axes.plot(x[ends], y[ends], ls="", zorder=zorder, **look, **END)
    axes.plot(*drawable(ellipse.centre), zorder=zorder, marker="+", ms=4, mew=0.9, **look)
    return {**look, "lw": 1.3 * broad, **(END if shape == "segment" else {})}


def _draw_dots(axes: Axes, dots: Mapping[str, Dots], styles: Mapping[str, LineStyle]) -> list[Handle]:
    """Draw the runs below the ellipses; return their legend entry."""
    for name, (x, y, *_) in dots.items():
        color = DIM if len(dots) == 1 else paler(styles[name].color, 0.35)
        axes.plot(x, y, color=color, zorder=2.0, gid=None if len(dots) == 1 else styles[name].gid, **DOTS)
    numbers = sorted({len(each.x) for each in dots.values()})
    text = f"{numbers[0]} runs" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]} runs"
    return [(text, sample(color=DIM, **{**DOTS, "ms": 3.0}))]


def _note(k: int, dots: dict[str, Dots]) -> str:
    """Name the sample of the ellipses, and count the runs that are missing."""
    n_failed, n_infinite = (sum(each[place] for each in dots.values()) for place in (2, 3))
    parts = [f"at k = {k}", f"{n_failed} failed" if n_failed else ""]
    parts += [f"{n_infinite} {DID_NOT_OCCUR}"] if n_infinite else []
    return ", ".join(filter(None, parts))
