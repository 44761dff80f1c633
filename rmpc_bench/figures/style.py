"""How and where figures are rendered: width, fonts, formulas, settings for reproducible files, a place of the user."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from rmpc_bench import notices
from rmpc_bench.types import DesignError
from rmpc_bench.types.result_layout import DEFAULT_FORMATS, Font, Format, Style

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure


class Place:
    """Stands for a new picture, and draws into `at`, an Axes or a SubFigure; size and layout are those of the user."""

    def __init__(self, at: Any) -> None:
        from matplotlib.axes import Axes
        from matplotlib.figure import FigureBase

        if not isinstance(at, Axes | FigureBase):
            raise DesignError(f"ax must be an Axes or a SubFigure of matplotlib (got {type(at).__name__})", "ax")
        self.is_panel = isinstance(at, Axes)
        self.at: Any = at
        self.root: Any = at.get_figure(root=True)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.at, {"suptitle": "set_title"}.get(name, name) if self.is_panel else name)

    @property
    def axes(self) -> list[Any]:
        """The panels."""
        return [self.at] if self.is_panel else self.at.axes

    @property
    def legends(self) -> list[Any]:
        """The legends, of which a panel has one."""
        return [self.at.get_legend()] if self.is_panel else self.at.legends

    def subplots(self, nrows: int = 1, ncols: int = 1, **keys: Any) -> Any:
        """Return panels; a DesignError where there are several, and a single Axes is given."""
        if not self.is_panel:
            return self.at.subplots(nrows, ncols, **keys)
        if nrows * ncols > 1:
            raise DesignError(
                f"ax: this figure has {nrows * ncols} panels; give a SubFigure, as subfigures() makes", "ax"
            )
        return np.array([[self.at]])

    def legend(self, *handles: Any, **keys: Any) -> Any:
        """Write a legend above the panels, or inside of a panel."""
        return self.at.legend(*handles, **{**keys, **({"loc": "best"} if self.is_panel else {})})

    def get_figwidth(self) -> float:
        """Return the width [in]."""
        return float(self.at.bbox.width / self.root.dpi)

    def get_figheight(self) -> float:
        """Return the height [in]."""
        return float(self.at.bbox.height / self.root.dpi)

    def get_layout_engine(self) -> Place:
        """Return what does nothing."""
        return self

    def _leave(self, *_: Any) -> None:
        """Leave size and layout to the user."""

    execute = set_figheight = set_layout_engine = align_ylabels = _leave


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """How all figures of a report are rendered."""

    width: float | None = None  # width of every figure [in]; that of its configuration if None
    font: Font = "dejavu"  # family of the texts and formulas
    style: Style = "bench"  # ``bench`` for the screen, ``paper`` for a printed column
    formats: tuple[Format, ...] = DEFAULT_FORMATS  # endings of the files to write
    labels: bool = False  # whether methods have their labels in place of their keys, as in files for papers
    place: Place | None = None  # where to draw in a picture of the user; a picture of its own if None


DEJAVU, STIX = "DejaVu Sans", "STIXGeneral"  # both come with matplotlib
TIMES = ("Times New Roman", "Nimbus Roman", "TeX Gyre Termes", "Tinos", "Liberation Serif", "FreeSerif")
"""Times and fonts with the same widths, the best first."""
SANS_INSTEAD = ("Verdana", "Geneva", "sans-serif")  # where DejaVu Sans is missing: as wide (Verdana), or narrower
SERIF_INSTEAD = ("Times New Roman", "Times", "Liberation Serif", "STIX Two Text", "serif")
TRUETYPE = (".ttf", ".ttc")  # endings of files that are embedded in PDF as Type 42


@cache
def family_of(font: Font) -> str:
    """Return the family that texts are set in; ``times`` is the first of `TIMES` installed as TrueType, else STIX."""
    if font == "times":
        return next(filter(_is_installed, TIMES), STIX)
    return DEJAVU if font == "dejavu" else STIX


def remark_on(font: Font) -> str:
    """Say that another font is taken in place of a missing one; empty where the font is there."""
    if font != "times" or family_of(font) != STIX:
        return ""
    return f"no Times font is installed as TrueType (looked for {', '.join(TIMES)}): the figures have STIX"


def families(name: str) -> tuple[str, ...]:
    """Return a family, or a font of matplotlib for formulas, and what a browser may take where it is missing."""
    instead = SANS_INSTEAD if name.startswith("DejaVu Sans") else SERIF_INSTEAD
    first = (name, DEJAVU) if name.startswith("DejaVu Sans ") else (name,)
    return tuple(dict.fromkeys((*first, *instead)))


@cache
def complete_fonts() -> None:
    """Put matplotlib's own fonts first in its list of fonts.

    The list is a file that all processes of a user share.  One of them may have written it without these fonts, and
    the letters of formulas are then those of another font in every figure from then on.
    """
    import matplotlib
    from matplotlib.font_manager import fontManager

    own = {str(path) for path in Path(matplotlib.get_data_path(), "fonts", "ttf").glob("*.ttf")}
    for missing in sorted(own - {entry.fname for entry in fontManager.ttflist}):
        fontManager.addfont(missing)
    fontManager.ttflist.sort(key=lambda entry: entry.fname not in own)


def _is_installed(family: str) -> bool:
    from matplotlib.font_manager import FontProperties, findfont

    try:
        return str(findfont(FontProperties(family=family), fallback_to_default=False)).lower().endswith(TRUETYPE)
    except ValueError:
        return False


_FORMULAS: dict[Any, Any] = {}
MOST = 2000  # formulas that are kept; matplotlib keeps 50 for each renderer, and makes a renderer for every file


@contextmanager
def formulas_once() -> Iterator[None]:
    """Keep the formulas that matplotlib reads inside the block, for all figures of this process.

    Reading a formula takes about 4 ms, and a label with one stands in every format of several figures.
    """
    from matplotlib.mathtext import MathTextParser

    parser: Any = MathTextParser
    usual = getattr(parser, "_parse_cached", None)
    # The names inside matplotlib may change; its own cache is then used as it is.
    if usual is None or not hasattr(usual, "__wrapped__"):
        yield
        return

    def parsed(self: Any, *settings: Any) -> Any:
        key = self._output_type, *settings
        if key not in _FORMULAS:
            if len(_FORMULAS) == MOST:
                _FORMULAS.clear()
            _FORMULAS[key] = usual.__wrapped__(self, *settings)
        return _FORMULAS[key]

    parser._parse_cached = parsed
    try:
        yield
    finally:
        parser._parse_cached = usual


@contextmanager
def without_docstrings_of_artists() -> Iterator[None]:
    """Let matplotlib define its artists without the docstrings that it makes, half of the time of its import."""
    import matplotlib
    from matplotlib.artist import Artist

    changes: list[tuple[Any, str, Any]] = [
        (Artist, "_update_set_signature_and_docstring", classmethod(lambda cls: None)),
    ]
    for name in ("_ArtistPropertiesSubstitution", "Substitution"):
        described = getattr(getattr(matplotlib, "_docstring", None), name, SimpleNamespace())
        changes.append((described, "__call__", lambda _, artist: artist))
    usual = [vars(owner).get(name) for owner, name, _ in changes]
    for change in changes:
        setattr(*change)
    try:
        yield
    finally:
        for (owner, name, _), before in zip(changes, usual, strict=True):
            setattr(owner, name, before) if before is not None else delattr(owner, name)


FONT_SIZE = 8  # size of all texts at the printed width [pt, of which an inch has 72]
POINTS_PER_INCH = 72
LINE_HEIGHT = 1.25 * FONT_SIZE  # height of a line of text [pt]
EDGE = 4.0  # free space at the left and right edges [pt]: a browser gives an exponent the height of a whole letter
SIZES = ("font.size", "axes.labelsize", "axes.titlesize", "xtick.labelsize", "ytick.labelsize", "legend.fontsize")
STYLE: dict[Any, Any] = {
    **dict.fromkeys(SIZES, FONT_SIZE),
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


PAPER: dict[Any, Any] = {"axes.linewidth": 0.5}
PAPER |= {f"{side}tick.{kind}.width": width for side in "xy" for kind, width in (("major", 0.5), ("minor", 0.3))}
"""What the style `paper` changes."""
MATHTEXT = {"dejavu": "dejavusans", "stix": "stix", "times": "stix"}  # font -> formulas that fit to it
_USUAL = Rendering()
_CURRENT: ContextVar[Rendering] = ContextVar("rendering", default=_USUAL)


@contextmanager
def rendered(rendering: Rendering) -> Iterator[None]:
    """Draw and write figures with this font and style inside the block."""
    token = _CURRENT.set(rendering)
    try:
        with own_words():
            yield
    finally:
        _CURRENT.reset(token)


@contextmanager
def own_words() -> Iterator[None]:
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
    own: dict[Any, Any] = {key: value for key, value in matplotlib.rcParamsDefault.items() if key != "backend"}
    own |= STYLE | (PAPER if is_for_paper() else {})
    own |= {"font.family": font_family(), "mathtext.fontset": MATHTEXT[_CURRENT.get().font]}
    with matplotlib.rc_context(own), formulas_once():
        yield


def new_figure(size: tuple[float, float]) -> MplFigure:
    """Make an empty picture [in], or empty the place for it, with room for its labels; call it under `style`."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    place: Any = _CURRENT.get().place
    if place is not None:
        # Some figures are drawn anew where their labels cover something.
        place.at.clear()
        return place  # type: ignore[no-any-return]
    return Figure(figsize=size, layout=ConstrainedLayoutEngine(w_pad=EDGE / POINTS_PER_INCH))


def fix_layout(figure: MplFigure) -> None:
    """Make the layout of a picture once, at one resolution; call it under `style`."""
    lay_out(figure)
    # With the placeholder that "none" would leave a file takes two draws.
    figure.set_layout_engine(None)


def lay_out(figure: MplFigure) -> None:
    """Let the layout engine of a picture place its panels; those of a given aspect need a draw."""
    engine: Any = figure.get_layout_engine()
    if all(axes.get_aspect() == "auto" for axes in figure.axes):
        engine.execute(figure)
    else:
        figure.draw_without_rendering()
