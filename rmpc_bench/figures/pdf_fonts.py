"""Fonts in PDF files: only the glyphs that are shown, without the tables that a PDF has no use for."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from importlib import util
from io import BytesIO
from typing import Any

from rmpc_bench.figures.font_subset import subset_of

LAYOUT_TABLES = ("GDEF", "GPOS", "GSUB")
"""Tables of a font for the composition of texts, which take fontTools most of its time."""
_SLOW = "fontTools.subset"
"""Module that takes 0.1 s to import; matplotlib imports it for every PDF, and most PDF files do not need it."""


@contextmanager
def small_fonts() -> Iterator[None]:
    """Let matplotlib embed small fonts inside the block: by `subset_of`, and by fontTools what that does not read."""
    _import_when_used(_SLOW)
    from matplotlib.backends import _backend_pdf_ps

    module: Any = _backend_pdf_ps
    found, written = module.get_glyphs_subset, module.font_as_file

    @contextmanager
    def chosen(file: Any, glyphs: Collection[int]) -> Iterator[Any]:
        small = subset_of(str(file), frozenset(glyphs)) if hasattr(module, "SubsetResults") else None
        if small is not None:
            yield module.SubsetResults(BytesIO(small[0]), small[1])
            return
        with _without_layout_tables(), found(file, glyphs) as result:
            yield result

    module.get_glyphs_subset = chosen
    module.font_as_file = lambda font: font if isinstance(font, BytesIO) else written(font)
    try:
        yield
    finally:
        module.get_glyphs_subset, module.font_as_file = found, written


@contextmanager
def _without_layout_tables() -> Iterator[None]:
    """Let fontTools leave out what only a text processor and a coarse screen use."""
    from fontTools import subset

    usual = subset.Options

    def smaller(**settings: Any) -> Any:
        made = usual(**{**settings, "hinting": False})
        made.drop_tables = [*made.drop_tables, *LAYOUT_TABLES]
        return made

    subset.Options = smaller
    try:
        yield
    finally:
        subset.Options = usual


def _import_when_used(name: str) -> None:
    """Put a module in its place that is executed when an attribute of it is used."""
    if name in sys.modules:
        return
    spec = util.find_spec(name)
    if spec is None or spec.loader is None:
        return
    loader = util.LazyLoader(spec.loader)
    spec.loader = loader
    module = util.module_from_spec(spec)
    sys.modules[name] = module
    loader.exec_module(module)
    # Without the attribute `from package import module` would execute it.
    package, _, own = name.rpartition(".")
    setattr(sys.modules[package], own, module)
