"""Style of all figures: palette, fonts, and settings of matplotlib for reproducible files."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import TYPE_CHECKING, Any

from rmpc_bench import notices
from rmpc_bench.figures.fonts import complete_fonts, family_of
from rmpc_bench.figures.formulas import formulas_once
from rmpc_bench.figures.palette import DIM, GROUND, INK, LINE, METHODS
from rmpc_bench.figures.rendering import Rendering

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

RED, BLUE = "#d7191c", "#0b5ba8"
COLOURS = METHODS
GREY, REFERENCE = LINE, DIM
"""Colours of the grid, and of what belongs to no method."""
BLACK, WHITE = INK, GROUND
FONT_SIZE = 8
"""Size of all texts at the printed width [pt, of which an inch has 72]."""
STYLE: dict[Any, Any] = {
    "font.size": FONT_SIZE,
    "axes.labelsize": FONT_SIZE,
    "axes.titlesize": FONT_SIZE,
    "xtick.labelsize": FONT_SIZE,
    "ytick.labelsize": FONT_SIZE,
    "legend.fontsize": FONT_SIZE,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.facecolor": "none",
    "lines.solid_capstyle": "butt",
    "axes.titlepad": 3.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "ytick.minor.width": 0.4,
    "path.simplify_threshold": 0.3,  # distance of points that lines leave out [pt]
    "svg.fonttype": "none",  # text stays text, which can be searched and edited
    "pdf.fonttype": 42,  # TrueType: the same in PDF
    "pgf.rcfonts": False,  # the fonts are those of the document
    "svg.hashsalt": "rmpc-bench",
}


PAPER: dict[Any, Any] = {
    "axes.linewidth": 0.5,
    "xtick.major.width": 0.5,
    "ytick.major.width": 0.5,
    "xtick.minor.width": 0.3,
    "ytick.minor.width": 0.3,
}
"""What the style `paper` changes."""
MATHTEXT = {"dejavu": "dejavusans", "stix": "stix", "times": "stix"}
"""Font -> formulas that fit to it."""
_USUAL = Rendering()
_CURRENT: ContextVar[Rendering] = ContextVar("rendering", default=_USUAL)


@contextmanager
def rendered(rendering: Rendering) -> Iterator[None]:
    """Draw and write figures with this font and style inside the block."""
    token = _CURRENT.set(rendering)
    try:
        with _own_words():
            yield
    finally:
        _CURRENT.reset(token)


@contextmanager
def _own_words() -> Iterator[None]:
    """Say, once per process, what matplotlib warns of: characters that the font lacks, and panels without room."""
    signs = set[str]()
    with warnings.catch_warnings(record=True) as found:
        warnings.filterwarnings("always", r"Glyph \d+ |constrained_layout not applied", UserWarning)
        yield
    for each in found:
        text = str(each.message)
        if glyph := re.match(r"Glyph (\d+) ", text):
            signs.add(chr(int(glyph[1])))
        elif not text.startswith("constrained_layout"):
            warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)
    if signs:
        _say_once(f"figures: the font {font_family()} lacks {' '.join(sorted(signs))}; choose others for figures")
    if any(str(each.message).startswith("constrained_layout") for each in found):
        _say_once("figures: labels leave no room for the panels; shorten them, or make the figure larger")


@cache
def _say_once(text: str) -> None:
    notices.say(text)


def font_family() -> str:
    """Return the font family of the texts."""
    return family_of(_CURRENT.get().font)


def is_for_paper() -> bool:
    """Whether figures are drawn for a paper, whose caption says what a note above the panels says on the screen."""
    return _CURRENT.get().style == "paper"


def has_labels() -> bool:
    """Whether methods have their labels, as in a file for a paper, and not their keys."""
    return _CURRENT.get().labels


@contextmanager
def style() -> Iterator[None]:
    """Draw with these settings on top of the defaults of matplotlib; the user's matplotlibrc has no effect."""
    import matplotlib

    complete_fonts()
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        matplotlib.rcParams.update(PAPER if is_for_paper() else {})
        fontset = MATHTEXT[_CURRENT.get().font]
        matplotlib.rcParams.update({"font.family": font_family(), "mathtext.fontset": fontset})
        with formulas_once():
            yield


def fix_layout(figure: MplFigure) -> None:
    """Make the layout of a picture once, at one resolution; call it under `style`.

    Without a layout engine a file takes one draw; with the placeholder that "none" would leave it takes two.
    """
    lay_out(figure)
    figure.set_layout_engine(None)


def lay_out(figure: MplFigure) -> None:
    """Let the layout engine of a picture place its panels.

    The draw that follows in `draw_without_rendering` is needed for panels of a given aspect only.
    """
    engine: Any = figure.get_layout_engine()
    if all(axes.get_aspect() == "auto" for axes in figure.axes):
        engine.execute(figure)
    else:
        figure.draw_without_rendering()
