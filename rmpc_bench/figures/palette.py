"""Colours of figures and pages, and the look of every method: colour, dashes, marker, and its group in an SVG.

A colour is the name of a CSS variable with its values on a light and on a dark ground.  matplotlib draws with the
colours of `PRINT`, which PDF, PNG and PGF keep.  An SVG has the variables in their place.
A method has the same look in every figure of an experiment.  Seven have looks of their own; the lines of more are thin
and grey.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.legend import Legend
    from matplotlib.lines import Line2D

_GROUNDS = {
    "bg": ("#ffffff", "#14171a"),
    "fg": ("#1b1f24", "#e6e9ec"),
    "dim": ("#59636e", "#a3adb8"),
    "line": ("#d0d7de", "#3a424a"),
    "soft": ("#f3f5f7", "#1d2226"),
    "band": ("#e4e8ec", "#2b3238"),
    "better": ("#0b5cad", "#7cb8f5"),
    "worse": ("#a34700", "#f0a35e"),
    "fail": ("#8a0f3c", "#f58ab0"),
    "m1": ("#1177aa", "#4499bb"),
    "m2": ("#cc4400", "#cc7a22"),
    "m3": ("#9900ff", "#bb66ff"),
    "m4": ("#660000", "#ffdd00"),
    "m5": ("#112288", "#77ffee"),
    "m6": ("#996666", "#999977"),
    "m7": ("#442244", "#ccff99"),
}  # name -> colour on a light and on a dark ground; readers with any colour vision can tell m1 to m7 apart
LIGHT: Mapping[str, str] = {name: light for name, (light, _) in _GROUNDS.items()}
DARK: Mapping[str, str] = {name: dark for name, (_, dark) in _GROUNDS.items()}
PRINT: Mapping[str, str] = {**LIGHT, "fg": "#000000"}
"""Colours that matplotlib draws with; each stands for one variable."""
METHODS = tuple(PRINT[f"m{number}"] for number in range(1, 8))
INK, GROUND, DIM, LINE, BAND = (PRINT[name] for name in ("fg", "bg", "dim", "line", "band"))


def in_css(colour: str) -> str:
    """Return the variable that stands for a colour of `PRINT`; any other colour stays as it is."""
    name = _NAMES.get(colour)
    return "currentColor" if name == "fg" else f"var(--{name})" if name else colour


_NAMES = {colour: name for name, colour in PRINT.items()}


def css_variables(ground: Mapping[str, str], names: Collection[str] | None = None) -> str:
    """Return the declarations of a ground, `LIGHT` or `DARK`, such as ``--m1:#1177aa``; all if no names are given."""
    return ";".join(f"--{name}:{value}" for name, value in ground.items() if names is None or name in names)


DASHES: tuple[Any, ...] = (
    "-",
    (0, (4, 2)),
    (0, (1.2, 1.2)),
    (0, (7, 1.5, 1.2, 1.5)),
    (0, (8, 3)),
    (0, (3, 1.2)),
    (0, (8, 1.5, 1.2, 1.5, 1.2, 1.5)),
)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
THIN = 0.7  # width of the grey lines of methods beyond the seventh, which are too many to be distinguished [pt]
MOST_TRAVEL = 6.0  # total variation of a held signal, relative to its range, up to which it is drawn in dashes


class LineStyle(NamedTuple):
    """Style of the lines, markers and areas of one method."""

    color: str
    linestyle: Any
    linewidth: float
    stepwidth: float  # width of the line of a rough signal
    zorder: float
    marker: str = "o"  # of single points, such as the mean of a method
    n_shown: int = 1
    gid: str | None = None  # name of the groups of the method in an SVG, by which a page hides them

    def line(self, *, held: bool = False, rough: bool = False) -> dict[str, Any]:
        """Return the keywords of a line: steps for a held signal; no dashes for a rough one, where they are lost.

        Nor has a line dashes that is the only one: there is nothing to distinguish it from.
        """
        dashes = self.linestyle if self.n_shown > 1 else "-"
        shape = {"ls": "-", "lw": self.stepwidth} if rough else {"ls": dashes, "lw": self.linewidth}
        look = {"color": self.color, "zorder": self.zorder, "drawstyle": "steps-post" if held else "default"}
        return {**look, **shape, "gid": self.gid}


def line_styles(methods: Sequence[str], shown: Sequence[str]) -> dict[str, LineStyle]:
    """Give every method its style, by its place among all methods of the experiment.

    A method that is not shown keeps its place, so that the same method looks the same in all figures.  Later lines lie
    above earlier ones.  Where curves are equal, a lower line is visible through the gaps of the upper one.  Of rough
    signals, whose lines have no gaps, it is wider and visible as an edge.
    """
    found = {}
    for place, name in enumerate(shown):
        number = methods.index(name)
        stepwidth = 0.6 + min(0.3, 1.2 / len(shown)) * (len(shown) - 1 - place)
        dashes, marker = (each[number % len(each)] for each in (DASHES, MARKERS))
        color, dashes, width = (METHODS[number], dashes, 1.3) if number < len(METHODS) else (DIM, "-", THIN)
        zorder = 2.5 + 0.01 * place - (number >= len(METHODS))
        gid = f"method-{name}"
        found[name] = LineStyle(color, dashes, width, stepwidth, zorder, marker, len(shown), gid)
    return found


def paler(color: str, share: float = 0.6) -> tuple[str, float]:
    """Let a share of the ground shine through a colour, whether the ground is white or dark."""
    return color, round(1 - share, 3)


def are_rough(signals: Sequence[Array]) -> bool:
    """Whether some curve of a panel changes direction so often that dashes would be lost in it."""
    values = np.concatenate(signals)
    reach = np.ptp(values[np.isfinite(values)]) if np.isfinite(values).any() else 0.0
    return any(bool(np.nansum(np.abs(np.diff(values))) > MOST_TRAVEL * reach) for values in signals)


def sample(**look: Any) -> Line2D:
    """Make a piece of a line for the legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **look)


@contextmanager
def grouped(axes: Axes, gid: str | None) -> Iterator[None]:
    """Give `LineStyle.gid` of a method to all that is drawn into a panel meanwhile and has no group."""
    before = {id(each) for each in axes.get_children()}
    yield
    for each in axes.get_children():
        if id(each) not in before and each.get_gid() is None:
            each.set_gid(gid)


def name_entries(legend: Legend, samples: Sequence[Artist]) -> None:
    """Put the drawn copies of samples in a legend, and their labels, into the groups of the given samples."""
    for given, shown, text in zip(samples, legend.legend_handles, legend.get_texts(), strict=True):
        if (gid := given.get_gid()) is not None:
            text.set_gid(gid)
            if shown is not None:
                shown.set_gid(gid)
