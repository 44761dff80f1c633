"""Coverage of the regions of reported covariances against their level, and over time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rmpc_bench.analysis.calibration import Region, calibrations, states_of
from rmpc_bench.analysis.estimation_errors import recorded_errors
from rmpc_bench.analysis.intervals import wilson
from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import stacked_panels
from rmpc_bench.figures.labels import at_point, name_of, runs_sentence, sentence
from rmpc_bench.figures.legend import finish
from rmpc_bench.figures.palette import BAND, DIM, line_styles, paler, sample
from rmpc_bench.figures.points import point_at
from rmpc_bench.figures.recorded_runs import window_of
from rmpc_bench.figures.style import new_figure, style
from rmpc_bench.types import Array, DesignError, ResultLayout
from rmpc_bench.types.errors import Issue
from rmpc_bench.types.figure import OnePointFigure
from rmpc_bench.types.metric import CalibrationKeys

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

PANEL, APART = 2.2, 0.012  # height of a panel [in], and distance between the marks of methods at one level
NEEDED = "needs shares of covered errors: calibration: true"


@dataclass(frozen=True, kw_only=True)
class CoverageFigure(OnePointFigure):
    """Share of errors in the regions of the reported covariance against their level, with intervals, for every method.

    The marks of a right covariance lie on the diagonal, those of an overconfident filter below it; the grey band has
    the margin of `calibration`.  Where x and x_hat are recorded, a second panel shows the share over time at the level
    of the verdict, with Wilson intervals.

    Parameters
    ----------
    height : height of the whole picture [in]; if not given 0.4 plus 2.2 for every panel
    order : methods to show; all that report a covariance if not given
    """

    needs_runs: ClassVar[bool] = True

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: the shares of the key `calibration`."""
        yield from super().check(layout)
        if not any(name.startswith(CalibrationKeys.name(0)[:-1]) for name in layout.metrics):
            yield Issue("", NEEDED)

    def caption(self, results: Trials) -> str:
        """Say what marks, band and lines are; see `Figure.caption`."""
        point, title, keys, rows, over_time = self._content(results)
        band = f"grey: errors up to {100 * keys.margin:g} % larger or smaller than promised"
        what = f"Share of errors in the regions of the reported covariance{at_point(title)} against their level"
        below = f"below, over time at {100 * keys.verdict:g} %, the share of the recorded runs with Wilson intervals"
        marks = f"{what}, with {100 * point.confidence:g} % intervals"
        return sentence(marks, band, below * bool(over_time), runs_sentence([point], [*rows]))

    def draw(self, results: Trials) -> MplFigure:
        """Draw the marks of every method, and the shares over time; see `Figure.draw`."""
        self.require(layout_of(results))
        point, title, keys, rows, over_time = self._content(results)
        styles, grid = line_styles(point.all_methods, [*rows]), np.linspace(0.005, 0.995, 199)
        with style():
            figure = new_figure(self.size(0.4 + PANEL * (1 + bool(over_time))))
            first, *below = stacked_panels(figure, 1 + bool(over_time), sharex=False)
            band = [Region(float(p), max(1, len(states_of(point)))).margin(keys.margin) for p in grid]
            first.fill_between(grid, *np.array(band).T, color=BAND, lw=0, zorder=0.4)
            first.plot([0, 1], [0, 1], color=DIM, lw=0.8, zorder=0.5)
            first.set(xlim=(0, 1), ylim=(0, 1.02), xlabel="level", ylabel="coverage")
            for place, (name, of) in enumerate(rows.items()):
                p, c, low, high = (np.array([row[key] for row in of]) for key in ("level", "covered", "low", "high"))
                p, look = p + APART * (place - (len(rows) - 1) / 2), styles[name]
                first.vlines(p, low, high, lw=1.0, color=look.color, gid=look.gid)
                first.plot(p, c, ls="", marker=look.marker, ms=4.0, color=look.color, gid=look.gid)
            for axes in below:
                for name, (share, low, high) in over_time.items():
                    window = window_of(point, len(share) - 1, None, None)
                    axes.fill_between(window.times, low, high, color=paler(styles[name].color, 0.8), lw=0)
                    axes.plot(window.times, share, lw=1.0, color=styles[name].color, gid=styles[name].gid)
                axes.axhline(keys.verdict, color=DIM, lw=0.8)
                axes.set(ylim=(-0.02, 1.02), xlabel=window.label, ylabel=f"coverage, {100 * keys.verdict:g} %")
            marks = [sample(ls="", marker=each.marker, color=each.color) for each in styles.values()]
            finish(figure, [*zip((name_of(point, name) for name in styles), marks, strict=True)], title)
        return figure

    def _content(
        self, results: Trials
    ) -> tuple[Trials, str, CalibrationKeys, dict[str, list[Mapping[str, Any]]], dict[str, list[Array]]]:
        """Find the point with its title, the rows of every method for all states, and shares over time."""
        point, title = point_at(results, self.at)
        rows = next((rows for each, rows in calibrations(results) if each is point), [])
        known = [row for row in rows if row["of"] == "joint" and row["n"]]
        found = {name: [row for row in known if row["method"] == name] for name in self.order or point.methods}
        found, keys = {name: of for name, of in found.items() if of}, point.calibration
        if keys is None or not found:
            raise DesignError(NEEDED if keys is None else "no method to show reports a covariance P", "order")
        over_time = {name: each for name in found if (each := covered_over_time(point, name, keys.verdict))}
        return point, title, keys, found, over_time


def covered_over_time(point: Trials, method: str, level: float) -> list[Array]:
    """Return over k the share of recorded runs that are covered, NaN without P, and its interval; empty if unknown."""
    from scipy.special import gammaincinv

    found = recorded_errors(point, method)
    if found is None or found.P is None or not len(found.runs):
        return []
    values, freedom = found.squares()
    limits = np.where(freedom > 0, 2 * gammaincinv(np.maximum(freedom, 1) / 2, level), 0.0)
    k, n = (values <= limits).sum(axis=0), (~np.isnan(values)).sum(axis=0)
    ends = [wilson(int(some), int(of), point.confidence) for some, of in zip(k, n, strict=True)]
    return [np.where(n > 0, k / np.maximum(n, 1), np.nan), *np.array(ends).T]
