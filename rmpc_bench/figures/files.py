"""Files of figures, written with reproducible bytes: SVG, PDF, PNG, and PGF, which a LaTeX document inputs.

SVG and PDF come from one draw: both have points as units, and what is drawn is the same.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import import_module
from io import BytesIO, StringIO
from logging import ERROR, getLogger
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rmpc_bench.extras import stand_ins
from rmpc_bench.figures.style import Rendering, families, font_family, rendered, style
from rmpc_bench.figures.svg_text import as_file, for_page, themed
from rmpc_bench.replaced_file import refuse_outside, replace_text, replaced

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

PROGRAMS = ("pdflatex", "xelatex", "lualatex")  # programs that measure the texts, the preferred one first
NO_LATEX = f"pgf needs a LaTeX ({', '.join(PROGRAMS)}) on the search path, and there is none; choose pdf or svg"
_SPECIAL = str.maketrans(
    {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}"} | {each: f"\\{each}" for each in "#_&{}$"}
)
_FORMULA = re.compile(r"((?<!\\)\$(?:\\(?!text\b).|[^$\\])*\$)")
r"""A formula.  Inside ``\text{..}`` matplotlib leaves every command to LaTeX, so that one with it is plain text."""


def latex_program() -> str | None:
    """Name an installed LaTeX; None where there is none."""
    return next(filter(shutil.which, PROGRAMS), None)


@contextmanager
def as_latex() -> Iterator[None]:
    """Let the LaTeX that is there measure texts, with special characters as text; FileNotFoundError without LaTeX."""
    import matplotlib
    from matplotlib.backends.backend_pgf import RendererPgf

    program = latex_program()
    if program is None:
        raise FileNotFoundError(NO_LATEX)
    renderer: Any = RendererPgf
    measure, draw = renderer.get_text_width_height_descent, renderer.draw_text

    def measured(self: Any, s: str, prop: Any, ismath: Any) -> Any:
        return measure(self, _escaped(s, ismath=bool(ismath)), prop, ismath)

    def drawn(self: Any, gc: Any, x: Any, y: Any, s: str, prop: Any, angle: Any, ismath: Any = False, **m: Any) -> None:
        draw(self, gc, x, y, _escaped(s, ismath=bool(ismath)), prop, angle, ismath, **m)

    # Labels of ticks are made while a figure is drawn, so its texts cannot be changed before.
    renderer.get_text_width_height_descent, renderer.draw_text = measured, drawn
    try:
        with matplotlib.rc_context({"pgf.texsystem": program}):
            yield
    finally:
        renderer.get_text_width_height_descent, renderer.draw_text = measure, draw


def _escaped(text: str, *, ismath: bool) -> str:
    """Write the characters as text that matplotlib leaves to LaTeX; it treats `^` and `%` itself."""
    parts = _FORMULA.split(text) if ismath else [text]
    for place in range(0, len(parts), 2):
        parts[place] = parts[place].replace(r"\$", "$").translate(_SPECIAL)
    return "".join(parts)


FORWARDED = ("draw_path", "draw_markers", "draw_path_collection", "draw_text")
"""Methods of a renderer that draw lines, areas, points and texts."""


def can_be_drawn_once(figure: MplFigure) -> bool:
    """Whether a picture has lines, areas, points and texts only; images depend on the format."""
    from matplotlib.collections import QuadMesh
    from matplotlib.image import _ImageBase

    def is_image(artist: Any) -> bool:
        return isinstance(artist, (QuadMesh, _ImageBase)) or artist.get_rasterized() or bool(artist.get_agg_filter())

    return not figure.findobj(is_image)


def svg_and_pdf(figure: MplFigure) -> tuple[str, bytes]:
    """Draw a picture that `can_be_drawn_once`, whose layout is final, as SVG and PDF; call it under `style`.

    The SVG is that of `savefig`, and the texts of the PDF are placed as in it.
    """
    from matplotlib.backends import backend_pdf, backend_svg

    module: Any = backend_svg
    of_pdf: Any = backend_pdf
    width, height = (float(size) for size in figure.get_size_inches())
    text, data = StringIO(), BytesIO()
    file = of_pdf.PdfFile(data, metadata=FORMATS[".pdf"]["metadata"])
    file.newPage(width, height)
    renderer = of_pdf.RendererPdf(file, 72, height, width)
    usual = module.RendererSVG
    module.RendererSVG = _both(usual, renderer)
    try:
        figure.savefig(text, format="svg", **FORMATS[".svg"])
    finally:
        module.RendererSVG = usual
    renderer.finalize()
    file.finalize()
    content = data.getvalue()
    file.close()
    return text.getvalue(), content


def _both(svg: Any, pdf: Any) -> Any:
    """Return a renderer of SVG that lets a renderer of PDF draw the same.

    What a method of the SVG draws by other methods is drawn by it alone.  The PDF keeps more in `new_gc` than the SVG
    needs.
    """
    methods = {name: _forwarded(name, svg, pdf) for name in FORWARDED}
    return type("Both", (svg,), {"inner": False, "new_gc": lambda _: pdf.new_gc(), **methods})


def _forwarded(name: str, svg: Any, pdf: Any) -> Callable[..., Any]:
    usual, other = getattr(svg, name), getattr(pdf, name)

    def draw(self: Any, gc: Any, *arguments: Any, **settings: Any) -> Any:
        if self.inner:
            return usual(self, gc, *arguments, **settings)
        if name == "draw_text":
            x, y, *rest = arguments
            # An SVG counts from the upper end, a PDF from the lower one.
            other(gc, x, self.height - y, *rest, **settings)
        else:
            other(gc, *arguments, **settings)
        self.inner = True
        try:
            return usual(self, gc, *arguments, **settings)
        finally:
            self.inner = False

    return draw


THINNER = 0.8  # factor on the widths of all lines
LEAST = 0.35  # thinnest line [pt]; a printer may lose thinner ones


def thin_lines(figure: MplFigure) -> None:
    """Make all lines thinner, those of markers and frames included; nothing moves, so the layout may be final."""
    from matplotlib.collections import Collection
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    for line in figure.findobj(Line2D):
        line.set_linewidth(_thinner(line.get_linewidth()))
        line.set_markeredgewidth(_thinner(line.get_markeredgewidth()))
    for patch in figure.findobj(Patch):
        patch.set_linewidth(_thinner(patch.get_linewidth()))
    for collection in figure.findobj(Collection):
        collection.set_linewidth([_thinner(float(width)) for width in np.atleast_1d(collection.get_linewidth())])


def _thinner(width: float) -> float:
    """Return the new width; lines that are thinner than the thinnest stay as they are."""
    return max(min(LEAST, width), THINNER * width)


FORMATS: dict[str, dict[str, Any]] = {
    ".svg": {"metadata": {"Date": None, "Creator": None}},
    ".png": {"metadata": {"Software": None}, "dpi": 200},
    ".pdf": {"metadata": {"CreationDate": None, "Creator": None, "Producer": None}},
    ".pgf": {},
}  # endings of files, with the settings that make their bytes the same every time


def save(figure: MplFigure, directory: Path, stem: str, rendering: Rendering | None = None) -> list[Path]:
    """Write a picture in the formats of the rendering, with the same bytes every time; the directory is made."""
    rendering = rendering or Rendering()
    files = [directory / f"{stem}.{ending}" for ending in rendering.formats]
    if files:
        directory.mkdir(parents=True, exist_ok=True)
    with rendered(rendering):
        together = {"svg", "pdf"} <= set(rendering.formats) and can_be_drawn_once(figure)
        if together:
            with style(), small_fonts():
                svg, pdf = svg_and_pdf(figure)
            replace_text(directory / f"{stem}.svg", as_file(themed(svg), families(font_family())))
            with replaced(directory / f"{stem}.pdf") as partial:
                partial.write_bytes(pdf)
        for file in files:
            if not (together and file.suffix in (".svg", ".pdf")):
                save_as(figure, file)
    return files


def save_as(figure: MplFigure, file: Path) -> None:
    """Write a picture in the format of the file's ending, one of `FORMATS`, with the same bytes every time."""
    ending = file.suffix.lower()
    options = FORMATS[ending]
    if ending == ".pgf":
        # Its images are files beside it, whose names follow from its own.
        refuse_outside(file.parent)
        for old in (file, *file.parent.glob(f"{file.stem}-img*.png")):
            old.unlink(missing_ok=True)
        with style(), as_latex():
            figure.savefig(file, format="pgf", **options)
        return
    with style(), replaced(file) as partial:
        if ending == ".svg":
            partial.write_text(svg_of(figure), encoding="utf-8", newline="\n")
        elif ending == ".pdf":
            with small_fonts():
                figure.savefig(partial, format="pdf", **options)
        else:
            figure.savefig(partial, format=ending[1:], **options)


UNUSED_TABLES = ("GDEF", "GPOS", "GSUB", "OS/2", "SVG ", "cmap", "post")
"""Tables for composed texts, characters, names of glyphs and glyphs that are SVG; a PDF has numbers of glyphs.

They take fontTools most of its time.
"""


@contextmanager
def small_fonts() -> Iterator[None]:
    """Let fontTools leave out of the fonts of a PDF what only a text processor and a coarse screen use.

    What it logs of the fonts, such as an early date, is no concern of the user.
    """
    import fontTools

    # Of varLib two modules are used, and lxml serves glyphs that are SVG, which a PDF does not have (0.03 s).
    folders = [str(Path(folder, "varLib")) for folder in fontTools.__path__]
    with stand_ins({"fontTools.subset.svg": {"__all__": []}, "fontTools.varLib": {"__path__": folders}}):
        with suppress(AttributeError, ImportError):
            import_module("fontTools.subset")
    from fontTools import subset

    usual = subset.load_font

    def smaller(file: Any, options: Any, **settings: Any) -> Any:
        options.hinting = False
        font = usual(file, options, **settings)
        # `drop_tables` would leave them out, too, but after fontTools has read them.  It drops kern beside GPOS only.
        for table in (*["kern"] * ("GPOS" in font), *UNUSED_TABLES):
            if table in font:
                del font[table]
        if "glyf" in font:
            font.setGlyphOrder([f"glyph{number:05d}" for number in range(font.getGlyphCount())])
        return font

    log = getLogger("fontTools")
    level = log.level
    log.setLevel(ERROR)
    subset.load_font = smaller
    try:
        yield
    finally:
        subset.load_font = usual
        log.setLevel(level)


def svg_of(figure: MplFigure) -> str:
    """Return a picture as SVG, the same text every time, as in a file."""
    return as_file(_drawn(figure), families(font_family()))


def page_svg(figure: MplFigure, css_class: str) -> str:
    """Return a picture as the SVG element of a page, whose style sheet has the variables of `palette`.

    The class, which no other figure of the page may have, stands in front of every id.
    """
    return for_page(_drawn(figure), css_class)


def _drawn(figure: MplFigure) -> str:
    text = StringIO()
    with style():
        figure.savefig(text, format="svg", **FORMATS[".svg"])
    return themed(text.getvalue())


@dataclass(frozen=True, eq=False, repr=False)
class FigureResult:
    """A drawn figure."""

    figure: MplFigure  # the figure of matplotlib, which may be adjusted
    rendering: Rendering = field(default_factory=Rendering)  # font and style

    def __repr__(self) -> str:
        return f"<FigureResult: {len(self.figure.axes)} panels>"

    def _repr_svg_(self) -> str:
        with rendered(self.rendering), style():
            return svg_of(self.figure)

    @property
    def axes(self) -> tuple[Axes, ...]:
        """The axes of the figure."""
        return tuple(self.figure.axes)

    def save(self, path: str | Path) -> Path:
        """Write the figure in the format of the file name's ending: .svg, .pdf, .png or .pgf.

        Parameters
        ----------
        path : the file, replaced; its directory must exist

        Returns
        -------
        the file

        Raises
        ------
        ValueError
            If the ending is not one of these.
        FileNotFoundError
            If a .pgf is asked for and no LaTeX is installed.
        """
        file = Path(path)
        if file.suffix.lower() not in FORMATS:
            raise ValueError(f"{file}: the ending gives the format, one of {', '.join(FORMATS)}")
        with rendered(self.rendering):
            save_as(self.figure, file)
        return file
