"""Files of figures: their formats, written with reproducible bytes."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmpc_bench.figures.fonts import families
from rmpc_bench.figures.pdf_fonts import small_fonts
from rmpc_bench.figures.pgf import as_latex
from rmpc_bench.figures.rendering import Rendering
from rmpc_bench.figures.style import font_family, rendered, style
from rmpc_bench.figures.svg_text import as_file, for_page, themed
from rmpc_bench.figures.vector_files import can_be_drawn_once, svg_and_pdf
from rmpc_bench.replaced_file import refuse_outside, replace_text, replaced

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

FORMATS: dict[str, dict[str, Any]] = {
    ".svg": {"metadata": {"Date": None, "Creator": None}},
    ".png": {"metadata": {"Software": None}, "dpi": 200},
    ".pdf": {"metadata": {"CreationDate": None, "Creator": None, "Producer": None}},
    ".pgf": {},
}
"""Endings of files, with the settings that make their bytes the same every time."""


def save(figure: MplFigure, directory: Path, stem: str, rendering: Rendering | None = None) -> list[Path]:
    """Write a picture in the formats of the rendering, PNG with 200 dpi, with the same bytes every time.

    The directory is made if it does not exist.
    """
    rendering = rendering or Rendering()
    files = [directory / f"{stem}.{ending}" for ending in rendering.formats]
    if files:
        directory.mkdir(parents=True, exist_ok=True)
    with rendered(rendering):
        together = {"svg", "pdf"} <= set(rendering.formats) and can_be_drawn_once(figure)
        if together:
            _save_vectors(figure, directory, stem)
        for file in files:
            if not (together and file.suffix in (".svg", ".pdf")):
                save_as(figure, file)
    return files


def _save_vectors(figure: MplFigure, directory: Path, stem: str) -> None:
    """Write SVG and PDF from one draw."""
    with style(), small_fonts():
        svg, pdf = svg_and_pdf(figure, FORMATS[".svg"], FORMATS[".pdf"])
    replace_text(directory / f"{stem}.svg", as_file(themed(svg), families(font_family())))
    with replaced(directory / f"{stem}.pdf") as partial:
        partial.write_bytes(pdf)


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
