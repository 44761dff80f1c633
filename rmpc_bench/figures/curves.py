"""What pictures of curves share: how a method looks, stacked panels, the time, the legend above them, the note."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, typeset, width, wrapped
from rmpc_bench.figures.style import COLOURS, FONT_SIZE, GREY
from rmpc_bench.types import Array, DesignError

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

FAR = 1e100  # matplotlib cannot draw the last values on the way to divergence; what lies beyond is drawn here
ROUND = 1e-9  # of a sample: the rounding of a time that is a multiple of the sampling time
HANDLE, PAD, GAP = 1.7, 0.5, 1.0  # of the legend, in units of the font size
MOST_TRAVEL = 6.0  # times its range that a held signal may go up and down and still be drawn in dashes
DASHES: tuple[Any, ...] = ("-", (0, (4, 2)), (0, (1.2, 1.2)), (0, (7, 1.5, 1.2, 1.5)))


Entry: TypeAlias = tuple[list[str], Artist]
"""Of a legend: the lines of the label, and a sample."""


class Look(NamedTuple):
    """How the lines of a method are drawn."""

    color: str
    linestyle: Any
    linewidth: float
    stepwidth: float
    """Of a rough signal."""
    zorder: float

    def line(self, *, held: bool = False, rough: bool = False) -> dict[str, Any]:
        """Keywords for a line; that of a held signal is steps, that of a rough one has no dashes, which are lost."""
        shape = {"ls": "-", "lw": self.stepwidth} if rough else {"ls": self.linestyle, "lw": self.linewidth}
        return {"color": self.color, "zorder": self.zorder, "drawstyle": "steps-post" if held else "default", **shape}


class Window(NamedTuple):
    """The samples that are shown, both ends included, and how long one is on the axis."""

    first: int
    last: int
    sample: float
    label: str
    """Of the axis."""

    @property
    def limits(self) -> tuple[float, float]:
        """Both ends on the axis."""
        return self.first * self.sample, self.last * self.sample


def window_of(point: Trials, last: int, start: float | None, stop: float | None) -> Window:
    """Find the samples between two times [s]; these are samples where the sampling time is not known.

    Parameters
    ----------
    point : the table that is shown
    last : the last sample there is
    start, stop : both ends, included; those of the samples if not given

    Raises
    ------
    DesignError
        when less than two samples are left
    """
    sample, label = (point.Ts, "$t$ [s]") if point.Ts else (1.0, "$k$")
    window = Window(
        0 if start is None else max(0, math.ceil(start / sample - ROUND)),
        last if stop is None else min(last, math.floor(stop / sample + ROUND)),
        sample,
        label,
    )
    if window.first >= window.last:
        message = f"fewer than two samples lie between `from` and `to` (there are 0 to {last * sample:g})"
        raise DesignError(message, "from" if start is not None else "to")
    return window


def looks(methods: Sequence[str], shown: Sequence[str]) -> dict[str, Look]:
    """Give every method its look.

    Colour and dashes are the same whatever else is shown.  Later lines lie above earlier ones; where curves are
    equal, the lower ones are seen through the gaps, those of rough signals, which have no gaps, as an edge.

    Parameters
    ----------
    methods : all methods of the experiment, in their order
    shown : methods to draw
    """
    found = {}
    for place, name in enumerate(shown):
        number = methods.index(name)
        stepwidth = 0.6 + min(0.3, 1.2 / len(shown)) * (len(shown) - 1 - place)
        color, dashes = COLOURS[number % len(COLOURS)], DASHES[number % len(DASHES)]
        found[name] = Look(color, dashes, 1.3, stepwidth, 2.5 + 0.01 * place)
    return found


def paler(color: str, share: float = 0.6) -> str:
    """Mix a colour with so much white; unlike one that is seen through, it stays itself where lines cross.

    Parameters
    ----------
    color : as "#rrggbb"
    share : of white
    """
    parts = (int(color[place : place + 2], 16) for place in (1, 3, 5))
    return "#" + "".join(f"{round(part + share * (255 - part)):02x}" for part in parts)


def panels(figure: Figure, n: int, *, sharex: bool = True) -> list[Axes]:
    """Stack panels, on a common horizontal axis unless told otherwise."""
    rows = list(figure.subplots(n, sharex=sharex, squeeze=False)[:, 0])
    for axes in rows:
        axes.grid(color=GREY, linewidth=0.4)
        axes.set_axisbelow(True)
        axes.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10]))
    return rows


def are_rough(signals: Sequence[Array]) -> bool:
    """Whether some of the curves of a panel goes up and down so much that dashes would be lost in it."""
    values = np.concatenate(signals)
    reach = np.ptp(values[np.isfinite(values)]) if np.isfinite(values).any() else 0.0
    return any(bool(np.nansum(np.abs(np.diff(values))) > MOST_TRAVEL * reach) for values in signals)


def drawable(values: Array) -> Array:
    """Bring what is too far away to where matplotlib can draw it; gaps stay gaps."""
    return np.where(np.isnan(values), np.nan, np.clip(values, -FAR, FAR))


def make_logarithmic(axes: Axes, *, horizontal: bool = False) -> None:
    """Make the vertical axis logarithmic, with more than powers of ten on it where it spans few of them.

    Parameters
    ----------
    axes : a panel
    horizontal : the horizontal axis and not the vertical one
    """
    (axes.set_xscale if horizontal else axes.set_yscale)("log")
    low, high = axes.get_xlim() if horizontal else axes.get_ylim()
    if high < 1e3 * low:
        axis = axes.xaxis if horizontal else axes.yaxis
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def make_logarithmic_if_positive(axes: Axes, values: Sequence[Array]) -> str:
    """Make the vertical axis logarithmic where all numbers are positive; else return what its label must say."""
    if all((each[np.isfinite(each)] > 0).all() for each in values):
        make_logarithmic(axes)
        return ""
    return "\n(linear: some <= 0)"


def finish(
    figure: Figure,
    handles: Sequence[tuple[str, Artist]],
    note: str = "",
    *,
    keys: Sequence[tuple[str, Artist]] = (),
    columns: bool = False,
) -> None:
    """Write the note above the panels and the legend above all, then make the layout once for every resolution.

    Parameters
    ----------
    figure : the picture, which becomes taller where legend and note need more than a line
    handles : label and sample of what the legend shows
    note : what is drawn, in plain words
    keys : label and sample of what the kinds of lines mean, which the legend shows in rows of their own
    columns : whether panels stand beside each other; the note then stands above the legend, which there must be
    """
    limit = figure.get_figwidth() * POINTS_PER_INCH - FONT_SIZE
    entries = [(wrapped(typeset(label), limit - (HANDLE + PAD) * FONT_SIZE), handle) for label, handle in handles]
    if keys:
        others = [(wrapped(typeset(label), limit - (HANDLE + PAD) * FONT_SIZE), handle) for label, handle in keys]
        entries, n_columns = _in_rows(entries, others, limit)
    else:
        n_columns = _columns([max(map(width, lines)) for lines, _ in entries], limit)
    lines = wrapped(literal(note), limit - 6 * FONT_SIZE) if note else []
    if entries:
        figure.legend(
            [handle for _, handle in entries],
            ["\n".join(lines) for lines, _ in entries],
            loc="outside upper center",
            ncols=n_columns,
            frameon=False,
            handlelength=HANDLE,
            handletextpad=PAD,
            columnspacing=GAP,
            labelspacing=0.25,
            borderpad=0.0,
            borderaxespad=0.3,
        )
    if lines and columns:
        figure.legends[0].set_title("\n".join(lines), prop=FontProperties(size=FONT_SIZE))
    elif lines:
        figure.axes[0].set_title("\n".join(lines))
    height = -(-sum(len(text) for text, _ in entries) // n_columns) - 1 + len(lines)
    figure.set_figheight(figure.get_figheight() + max(0.0, height) * 1.25 * FONT_SIZE / POINTS_PER_INCH)
    figure.align_ylabels()
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


def _columns(widths: Sequence[float], limit: float) -> int:
    """Count the columns of a legend: as few rows as fit into `limit` points, then as few columns as these need."""
    for n in range(len(widths), 1, -1):
        if _fits(np.array_split(widths, n), limit):
            n_rows = -(-len(widths) // n)
            return -(-len(widths) // n_rows)
    return 1


def _fits(columns: Sequence[Sequence[float] | Array], limit: float) -> bool:
    """Whether columns of labels with these widths fit into `limit` points."""
    widths = [max(column) + (HANDLE + PAD) * FONT_SIZE for column in columns]
    return sum(widths) + GAP * FONT_SIZE * (len(widths) - 1) <= limit


def _in_rows(above: Sequence[Entry], below: Sequence[Entry], limit: float) -> tuple[list[Entry], int]:
    """Order the entries of a legend, which fills its columns first, so that two groups have rows of their own.

    Returns the entries, with empty ones at the ends of rows, and the number of columns: as few rows as fit into `limit`
    points, then as few columns as these need.
    """
    found: list[tuple[int, int, list[list[Entry]]]] = []
    for n in range(1, max(len(above), len(below)) + 1):
        cells = [entry for group in (above, below) for entry in [*group, *[_empty()] * (-len(group) % n)]]
        columns = [cells[place::n] for place in range(n)]
        if n == 1 or _fits([[max(map(width, lines)) for lines, _ in column] for column in columns], limit):
            found.append((len(columns[0]), n, columns))
    _, n_columns, columns = min(found, key=lambda each: each[:2])
    return [entry for column in columns for entry in column], n_columns


def _empty() -> Entry:
    return [""], Line2D([], [], ls="")


def sample(look: Look, *, rough: bool = False) -> Line2D:
    """Draw a piece of a method's line for the legend, without dashes where all signals are rough."""
    return Line2D([], [], **look.line(rough=rough))
