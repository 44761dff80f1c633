"""Fonts in PDF files: only the glyphs that are shown, without the tables that a PDF has no use for."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import Any

from rmpc_bench.figures.font_subset import subset_of

LAYOUT_TABLES = ("GDEF", "GPOS", "GSUB")
"""Tables of a font for the composition of texts, which take fontTools most of its time."""


@contextmanager
def small_fonts() -> Iterator[None]:
    """Let matplotlib embed small fonts inside the block: by `subset_of`, and by fontTools what that does not read."""
    from fontTools import subset
    from matplotlib.backends import _backend_pdf_ps

    module: Any = _backend_pdf_ps
    options, found, written = subset.Options, module.get_glyphs_subset, module.font_as_file

    def smaller(**settings: Any) -> Any:
        made = options(**{**settings, "hinting": False})
        made.drop_tables = [*made.drop_tables, *LAYOUT_TABLES]
        return made

    @contextmanager
    def chosen(file: Any, glyphs: Collection[int]) -> Iterator[Any]:
        small = subset_of(str(file), frozenset(glyphs)) if hasattr(module, "SubsetResults") else None
        if small is None:
            with found(file, glyphs) as result:
                yield result
        else:
            yield module.SubsetResults(BytesIO(small[0]), small[1])

    subset.Options = smaller
    module.get_glyphs_subset = chosen
    module.font_as_file = lambda font: font if isinstance(font, BytesIO) else written(font)
    try:
        yield
    finally:
        subset.Options, module.get_glyphs_subset, module.font_as_file = options, found, written
