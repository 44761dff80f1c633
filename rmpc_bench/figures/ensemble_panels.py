"""Panels of ensemble moments over the samples, one per state: exact, from runs, and reported bounds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from rmpc_bench.figures.axes import drawable, make_logarithmic_if_positive, stacked_panels
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import line_styles, paler
from rmpc_bench.figures.samples import Curve, SeriesComponent, cut
from rmpc_bench.figures.style import BLACK, REFERENCE, style
from rmpc_bench.figures.sweep_points import MOST_PANELS
from rmpc_bench.figures.window import TimeWindow
from rmpc_bench.types import Array, NonNegative
from rmpc_bench.types.figure import Index, OnePointFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

COMMON = ""
"""Stands for the method of a true state that is the same in all methods."""
STYLES: dict[str, dict[str, Any]] = {
    "runs": {"lw": 0.5, "ls": "-", "zorder": 2.0},
    "true state": {"lw": 1.0, "ls": (0, (1.2, 1.2)), "zorder": 2.3},
    "bound": {"lw": 1.0, "ls": (0, (4, 2)), "zorder": 2.4},
    "main": {"lw": 1.1, "ls": "-", "zorder": 2.5},
}
"""Kinds of lines and their styles, from below to above; those from runs are pale."""
ROUGH = 0.7
"""Factor of the width of a main line that is from runs."""
EDGE = 1.6
"""Factor of the width of the true state's line."""
INTERVAL = 0.8
"""Share of white in the area of an interval."""
BOUND = "reported covariance"


@dataclass(frozen=True, kw_only=True)
class EnsembleFigure(OnePointFigure):
    """A figure of ensemble moments with one panel per state.

    Parameters
    ----------
    component : index of the state (counted from 0); all (6 at most) if not given
    from_ : first time to show [s]
    to : last time to show [s]
    height : height of the whole picture [in]; if not given 0.8 and 1.2 for every panel; legend and title add to it if
        they need more than a line
    order : methods to show, later ones above earlier ones; all that have moments if not given
    """

    component: Index | None = None
    from_: NonNegative | None = None
    to: NonNegative | None = None

    def check_states(self, layout: ResultLayout, moment: str) -> Iterator[Issue]:
        """Yield an issue for a state that the series does not have, for too many panels, and for an empty window."""
        n = layout.n_states(self.order, moment)
        if self.component is None:
            advice = f"choose one of 0 to {(n or 1) - 1}"
            yield from layout.require_at_most(MOST_PANELS, n or 0, "states", "component", advice)
        else:
            yield from layout.require_component("state", [self.component], n, "component")
        yield from layout.require_window(self.from_, self.to)


class MomentLine(NamedTuple):
    """A line of a panel."""

    method: str
    kind: str
    """One of `STYLES`."""
    curve: Curve
    n_runs: frozenset[int] = frozenset()
    """Numbers of runs; empty for an exact line."""
    half: Array | None = None
    """Half the width of the interval of every value that is from runs; None without one."""


class MomentPanel(NamedTuple):
    """The lines of one state."""

    label: str
    lines: tuple[MomentLine, ...]


def count_states(found: Iterable[dict[str, SeriesComponent]]) -> int:
    """Count the states from the names of the components."""
    return 1 + max(int(component.split(",")[0]) for entries in found for component in entries)


def lines_of(name: str, values: SeriesComponent, half: Array | None = None) -> list[MomentLine]:
    """Make the lines of a method or of `COMMON`: the exact values before those from runs, or these alone as main line.

    `half` is half the width of the interval of every value from runs.
    """
    if values.exact is None:
        return [MomentLine(name, "main", values.best, values.n_runs, half)]
    behind = [MomentLine(name, "runs", values.runs, values.n_runs, half)] if values.runs else []
    return [*behind, MomentLine(name, "main", values.exact)]


def last_sample(panels: Sequence[MomentPanel]) -> int:
    """Find the last sample of all panels."""
    return int(max(line.curve.k[-1] for panel in panels for line in panel.lines))


def draw_moments(
    point: Trials,
    title: str,
    methods: Sequence[str],
    panels: Sequence[MomentPanel],
    window: TimeWindow,
    size: tuple[float, float],
    *,
    words: tuple[str, str],
    log: bool,
) -> MplFigure:
    """Draw panels from top to bottom, with methods from below to above, in a picture of some size [in].

    `words` are the names in the legend of main lines that are exact, and of those from runs.  Axes are logarithmic only
    if all values are positive.
    """
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.patches import Patch

    styles = line_styles(point.all_methods, methods)
    colours = {name: styles[name].color for name in methods} | {COMMON: BLACK}
    gids = {name: styles[name].gid for name in methods}
    places = {name: 0.01 * place for place, name in enumerate([COMMON, *methods])}
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        rows = stacked_panels(figure, len(panels))
        drawn: list[MomentLine] = []
        for axes, panel in zip(rows, panels, strict=True):
            pieces = [(line, cut(line.curve, window)) for line in panel.lines]
            shown = [line._replace(curve=piece) for line, piece in pieces if piece is not None]
            _draw_intervals(axes, panel.lines, window, colours, gids)
            for line in shown:
                values, look = drawable(line.curve.values), _look(line, colours[line.method], places[line.method])
                axes.plot(window.sample * line.curve.k, values, **look, gid=gids.get(line.method))
            remark = make_logarithmic_if_positive(axes, [one.curve.values for one in shown]) if log else ""
            axes.set_ylabel(panel.label + remark)
            drawn += shown
        rows[-1].set_xlim(*window.limits)
        rows[-1].set_xlabel(window.label)
        keys = _of_kinds(drawn, words)
        if any(line.half is not None for panel in panels for line in panel.lines):
            keys.append((interval_words(point), Patch(facecolor=paler(REFERENCE, INTERVAL), lw=0)))
        finish(figure, _of_colours(point, methods, drawn, colours, gids), title, keys=keys)
    return figure


def source_of(lines: Sequence[MomentLine]) -> str:
    """Say for a caption which lines are exact and which are from runs."""
    mains = [line for line in lines if line.kind == "main"]
    runs = _from_runs(line for line in lines if line.n_runs)
    if all(line.n_runs for line in mains):
        return f"All of them are {runs}"
    behind = any(line.kind == "runs" for line in lines)
    return f"Main lines are exact; thin pale lines behind them are {runs}" if behind else "They are exact"


def interval_words(point: Trials) -> str:
    """Name the areas about means from runs."""
    return f"{100 * point.confidence:g} % interval of the mean"


def _draw_intervals(
    axes: Axes,
    lines: Sequence[MomentLine],
    window: TimeWindow,
    colours: Mapping[str, str],
    gids: Mapping[str, str | None],
) -> None:
    """Draw the intervals of values that are from runs as areas behind the lines."""
    for line in lines:
        if line.half is not None:
            inside = (line.curve.k >= window.first) & (line.curve.k <= window.last)
            middle, half = line.curve.values[inside], line.half[inside]
            low, high = drawable(middle - half), drawable(middle + half)
            area: dict[str, Any] = {"color": paler(colours[line.method], INTERVAL), "lw": 0, "zorder": 1.8}
            axes.fill_between(window.sample * line.curve.k[inside], low, high, **area, gid=gids.get(line.method))


def _look(line: MomentLine, color: str, place: float) -> dict[str, Any]:
    look = {"color": color, **STYLES[line.kind]}
    if line.kind == "runs":
        look["color"] = paler(color)
    elif line.kind == "main":
        # A wider black line is visible on both sides of an estimate that is right, but not of one that is rough.
        look["lw"] *= ROUGH if line.n_runs else EDGE if line.method == COMMON else 1.0
    return {**look, "zorder": look["zorder"] + place}


def _of_colours(
    point: Trials,
    methods: Sequence[str],
    drawn: Sequence[MomentLine],
    colours: dict[str, str],
    gids: Mapping[str, str | None],
) -> list[Handle]:
    """Name the methods by their colours, and mark main lines from runs if others are exact."""
    from matplotlib.lines import Line2D

    mains = [line for line in drawn if line.kind == "main"]
    mixed = len({bool(line.n_runs) for line in mains}) > 1
    handles: list[Handle] = []
    for name in [COMMON, *methods] if any(line.method == COMMON for line in mains) else methods:
        label = "true state" if name == COMMON else point.labels.get(name, name)
        source = _from_runs(line for line in mains if line.method == name) if mixed else ""
        sample = Line2D([], [], color=colours[name], lw=1.3, gid=gids.get(name))
        handles.append((f"{label} ({source})" if source else label, sample))
    return handles


def _of_kinds(drawn: Sequence[MomentLine], words: tuple[str, str]) -> list[Handle]:
    """Name the kinds of lines, in grey."""
    from matplotlib.lines import Line2D

    kinds = {kind: [line for line in drawn if line.kind == kind] for kind in ("main", "true state", "bound", "runs")}
    all_from_runs = all(line.n_runs for line in kinds["main"])
    texts = {
        "main": f"{words[1]} {_from_runs(kinds['main'])}" if all_from_runs else words[0],
        "true state": "true state",
        "bound": BOUND,
        "runs": _from_runs(kinds["runs"]),
    }
    looks = {kind: {**STYLES[kind], "color": REFERENCE} for kind in kinds}
    # On its own a line as pale as in the panels is hardly visible.
    looks["runs"] |= {"color": paler(REFERENCE, 0.4), "lw": 0.8}
    return [(texts[kind], Line2D([], [], **looks[kind])) for kind, lines in kinds.items() if lines]


def _from_runs(lines: Iterable[MomentLine]) -> str:
    numbers = sorted(frozenset().union(*(line.n_runs for line in lines)))
    if not numbers:
        return ""
    few, many = numbers[0], numbers[-1]
    return f"from {few} runs" if few == many else f"from {few} to {many} runs"
