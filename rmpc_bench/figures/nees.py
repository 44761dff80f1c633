"""Average normalised error squared of estimates (NEES) or innovations (NIS) over time, with its chi-square band."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from annotated_types import Gt, Lt

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.analysis.nees import chi_square_band
from rmpc_bench.figures.axes import drawable, few_ticks, make_logarithmic, stacked_panels
from rmpc_bench.figures.estimation_error import methods_with_errors, require_errors, sets_sentence
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import LineStyle, line_styles, paler
from rmpc_bench.figures.nees_lines import NeesLines, methods_with_innovations, nees_of, nis_of
from rmpc_bench.figures.shared_content import shared_content
from rmpc_bench.figures.style import BLACK, style
from rmpc_bench.figures.sweep_points import point_at
from rmpc_bench.figures.window import TimeWindow, window_of
from rmpc_bench.types import Array, DesignError, NonNegative
from rmpc_bench.types.figure import OnePointFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

INSIDE = "#e3e3e3"
"""Colour of the band of all methods."""
ONE: dict[str, Any] = {"color": BLACK, "lw": 0.7, "zorder": 2.1}
EDGE: dict[str, Any] = {"lw": 0.6, "zorder": 2.2}
NAMES = {"nees": "NEES", "nis": "NIS"}
NO_INNOVATIONS = "needs recorded e and S of some method that reports both: record: {runs: 20, signals: [e, S]}"


@dataclass(frozen=True, kw_only=True)
class NeesOverTime(OnePointFigure):
    """Average NEES over the runs at every sample, with the chi-square band of a consistent estimator; 1 is best.

    NEES = e' P^-1 e with e = x_hat - x and the reported covariance P.  For a Gaussian error with mean 0 and covariance
    P, the sum over n independent runs has a chi-square distribution with n nx degrees of freedom (Bar-Shalom, Li,
    Kirubarajan: Estimation with Applications to Tracking and Navigation, 2001, Section 5.4).  The figure shows the
    average divided by nx, as the metric `nees`, and the central band of this distribution divided by n nx.  A line
    above the band shows an overconfident estimator, one below it a conservative one.  NIS is the same of the recorded
    innovation `e` with its covariance `S`, which needs no true state.

    The average over the runs of an ensemble follows from its mean and covariance if all runs have the same P, else from
    the recorded runs.  If exact moments exist, the expected NEES is the main line, and the one from runs lies behind
    it, thin and pale.  Where P is singular its pseudo-inverse is used, and the degrees of freedom are its rank.  There
    is a gap where an error leaves the range of P: its NEES is infinite.  A logarithmic axis has a gap where the NEES is
    0, as at a start that is known exactly.  Failed runs are left out, which the number n
    in the legend shows.  A sample without a measurement (NaN) does not count for the NIS.  Of few runs the band is
    wide.  A line that is inside the band at every sample is no proof: the NEES tests size and not whiteness.

    Parameters
    ----------
    of : `nees` or `nis`
    level : probability of the band, such as 95%
    log : logarithmic axis, on which 2 and 1/2 are equally far from 1
    from_ : first time to show and to count [s]
    to : last time to show and to count [s]
    height : height of the whole picture [in]; 2.2 if not given; legend and title add to it if they need more than a
        line
    order : methods to show, later ones above earlier ones; all that have what is needed if not given
    """

    of: Literal["nees", "nis"] = "nees"
    level: Annotated[float, Gt(0), Lt(1)] = 0.95
    log: bool = True
    from_: NonNegative | None = None
    to: NonNegative | None = None

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: what NEES or NIS is computed from, of all methods to show, and a window."""
        yield from super().check(layout)
        if not layout.is_complete:
            return
        if self.of == "nees":
            yield from require_errors(layout, self.order)
        else:
            having = methods_with_innovations(layout)
            if not having:
                yield Issue("of", NO_INNOVATIONS)
            for name in self.order or ():
                if having and name in layout.methods and name not in having:
                    text = f"no innovation e with its covariance S is recorded of '{name}'"
                    yield Issue("order", f"{text} (recorded of: {', '.join(having)})")
        yield from layout.require_window(self.from_, self.to)

    def draw(self, results: Trials) -> MplFigure:
        """Draw the averages of one point; see `Figure.draw`."""
        return _draw(self, self._content(results), self.size(2.2))

    def caption(self, results: Trials) -> str:
        """Define lines and band, and state the share of the samples outside of it; see `Figure.caption`."""
        content = self._content(results)
        what = "error $e = \\hat{x} - x$ and its reported covariance $P$"
        if self.of == "nis":
            what = "innovation $e$ and its reported covariance $P = S$"
        freedom = "n_x" if self.of == "nees" else "n_y"
        sentences = [
            f"{NAMES[self.of]}, $e^T P^{{-1}} e$ with the {what}, averaged over the runs at every sample and divided "
            f"by the degrees of freedom ${freedom}$ (the rank of a singular $P$); 1 is best.",
            f"Grey: the central {100 * self.level:g} % band of $\\chi^2$ with $n {freedom}$ degrees of freedom, "
            "divided by them; the average over $n$ runs of a consistent estimator lies in it with this probability.",
        ]
        if any(each.exact is not None for each in content.lines.values()):
            sentences.append("Main lines are expected values from exact moments, pale ones averages over runs.")
        sentences += [self._share(content, name) for name in content.lines]
        if any(each.average is not None for each in content.lines.values()):
            sentences.append(
                f"A consistent estimator is outside at {100 * (1 - self.level):.3g} % of the samples on average; "
                "successive samples are correlated."
            )
        if self.of == "nees":
            sentences.append(sets_sentence(content.point, content.lines))
        return " ".join(filter(None, sentences))

    def _share(self, content: NeesContent, name: str) -> str:
        """State the average over time of a method, and its share of samples outside of the band."""
        lines = content.lines[name]
        label = content.point.labels.get(name, name)
        if lines.average is None:
            assert lines.exact is not None, "a method has one of both"
            return f"{label}: {_mean_text(lines.exact[content.window.slice])} on average over time, exact."
        values = lines.average[content.window.slice]
        low, high = (end[content.window.slice] for end in chi_square_band(lines.freedom, self.level))
        n_infinite = int(np.isinf(values).sum())
        known = np.isfinite(low) & ~np.isnan(values)
        above, below = (float(np.mean(each[known])) if known.any() else 0.0 for each in (values > high, values < low))
        runs = f"n = {lines.n}" + (f", {lines.n_failed} failed" if lines.n_failed else "")
        infinite = f", infinite at {n_infinite} samples where an error leaves the range of $P$" if n_infinite else ""
        return (
            f"{label} ({runs}): {_mean_text(values)} on average over time, above the band at {100 * above:.3g} % and "
            f"below it at {100 * below:.3g} % of the samples{infinite}."
        )

    def _content(self, results: Trials) -> NeesContent:
        return shared_content(results, self, lambda: self._compute(results))

    def _compute(self, results: Trials) -> NeesContent:
        """Compute the averages of all methods."""
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        usual = methods_with_errors(layout) if self.of == "nees" else methods_with_innovations(layout)
        lines = {}
        for name in self.order or usual:
            found = nees_of(point, name) if self.of == "nees" else nis_of(point, name)
            if found is None and self.order:
                raise DesignError(f"'{name}' has no finished run with a covariance", "order")
            if found is not None:
                lines[name] = found
        if not lines:
            raise DesignError("no method has a finished run with a covariance", "")
        last = max(each.n_samples for each in lines.values()) - 1
        return NeesContent(point, title, lines, window_of(point, last, self.from_, self.to))


class NeesContent(NamedTuple):
    """What the figure shows."""

    point: Trials
    title: str
    lines: Mapping[str, NeesLines]
    window: TimeWindow


def _mean_text(values: Array) -> str:
    finite = values[np.isfinite(values)]
    return f"{finite.mean():.3g}" if len(finite) else "infinite"


def _draw(keys: NeesOverTime, content: NeesContent, size: tuple[float, float]) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    point, window, lines = content.point, content.window, content.lines
    styles = line_styles(point.all_methods, list(lines))
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        (axes,) = stacked_panels(figure, 1)
        few_ticks(axes)
        axes.axhline(1.0, **ONE)
        _draw_bands(axes, keys.level, lines, styles, window)
        handles: list[Handle] = []
        for name, each in lines.items():
            look = styles[name]
            _draw_line(axes, each, look, window, log=keys.log)
            n = f" (n = {each.n})" if each.average is not None else " (exact)"
            sample = Line2D([], [], **{**look.line(), "marker": look.marks(2).get("marker", "")}, ms=2.8)
            handles.append((point.labels.get(name, name) + n, sample))
        handles.append((f"{100 * keys.level:g} % band", Patch(facecolor=INSIDE, edgecolor="none")))
        if keys.log:
            make_logarithmic(axes)
        axes.set_ylabel(f"average {NAMES[keys.of]} / ${'n_x' if keys.of == 'nees' else 'n_y'}$")
        axes.set_xlim(*window.limits)
        axes.set_xlabel(window.label)
        finish(figure, handles, content.title)
    return figure


def _draw_bands(
    axes: Axes, level: float, lines: Mapping[str, NeesLines], styles: Mapping[str, LineStyle], window: TimeWindow
) -> None:
    """Draw one grey band if it is the same for all methods, else its edges in the colour of each; return the ends."""
    t = window.sample * np.arange(window.first, window.last + 1)
    freedoms = {name: each.freedom[window.slice] for name, each in lines.items() if each.average is not None}
    same = len({freedom.tobytes() for freedom in freedoms.values()}) == 1
    for name, freedom in freedoms.items():
        low, high = chi_square_band(freedom, level)
        axes.fill_between(t, low, high, color=INSIDE, lw=0, zorder=0.2)
        if same:
            break
        for end in (low, high):
            axes.plot(t, end, color=styles[name].color, ls=styles[name].linestyle, gid=styles[name].gid, **EDGE)


def _draw_line(axes: Axes, lines: NeesLines, look: LineStyle, window: TimeWindow, *, log: bool) -> None:
    """Draw the main line of a method, and the average over runs behind an exact one."""
    t = window.sample * np.arange(window.first, window.last + 1)
    if lines.exact is not None and lines.average is not None:
        pale = drawable(_gaps(lines.average[window.slice], log=log))
        axes.plot(t, pale, color=paler(look.color, 0.45), lw=0.6, zorder=look.zorder - 0.2, gid=look.gid)
    axes.plot(t, drawable(_gaps(lines.main[window.slice], log=log)), **look.line(), **look.marks(len(t)))


def _gaps(values: Array, *, log: bool) -> Array:
    return np.where(np.isfinite(values) & ((values > 0) | (not log)), values, np.nan)
