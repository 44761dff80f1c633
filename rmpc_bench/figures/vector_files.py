"""SVG and PDF of a picture from one draw: both have points as units, and what is drawn is the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from io import BytesIO, StringIO
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

FORWARDED = ("draw_path", "draw_markers", "draw_path_collection", "draw_text")
"""Methods of a renderer that draw lines, areas, points and texts."""


def can_be_drawn_once(figure: MplFigure) -> bool:
    """Whether a picture has lines, areas, points and texts only; images depend on the format."""
    from matplotlib.collections import QuadMesh
    from matplotlib.image import _ImageBase

    def is_image(artist: Any) -> bool:
        return isinstance(artist, (QuadMesh, _ImageBase)) or artist.get_rasterized() or bool(artist.get_agg_filter())

    return not figure.findobj(is_image)


def svg_and_pdf(figure: MplFigure, svg: Mapping[str, Any], pdf: Mapping[str, Any]) -> tuple[str, bytes]:
    """Draw a picture that `can_be_drawn_once` as SVG and PDF, with the settings of each for `savefig`.

    Its layout is final; call it under `style`.  The SVG is that of `savefig`, and the texts of the PDF are placed as in
    it.
    """
    from matplotlib.backends import backend_pdf, backend_svg

    module: Any = backend_svg
    of_pdf: Any = backend_pdf
    width, height = (float(size) for size in figure.get_size_inches())
    text, data = StringIO(), BytesIO()
    file = of_pdf.PdfFile(data, metadata=pdf.get("metadata"))
    file.newPage(width, height)
    renderer = of_pdf.RendererPdf(file, 72, height, width)
    usual = module.RendererSVG
    module.RendererSVG = _both(usual, renderer)
    try:
        figure.savefig(text, format="svg", **svg)
    finally:
        module.RendererSVG = usual
    renderer.finalize()
    file.finalize()
    content = data.getvalue()
    file.close()
    return text.getvalue(), content


def _both(svg: Any, pdf: Any) -> Any:
    """Return a renderer of SVG that lets a renderer of PDF draw the same."""

    class Both(svg):  # type: ignore[misc]
        """Draws twice; what a method of the SVG draws by other methods is drawn by it alone."""

        inner = False

        def new_gc(self) -> Any:
            """The PDF keeps more in it than the SVG needs."""
            return pdf.new_gc()

    for name in FORWARDED:
        setattr(Both, name, _forwarded(name, svg, pdf))
    return Both


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
