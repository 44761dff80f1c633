"""Figures as PGF, which a LaTeX document inputs: its texts are set by the document."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

PROGRAMS = ("pdflatex", "xelatex", "lualatex")
"""Programs that measure the texts, the preferred one first."""
NO_LATEX = f"pgf needs a LaTeX ({', '.join(PROGRAMS)}) on the search path, and there is none; choose pdf or svg"
_SPECIAL = {
    "\\": r"\textbackslash{}",
    "#": r"\#",
    "_": r"\_",
    "&": r"\&",
    "~": r"\textasciitilde{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
}
_FORMULA = re.compile(r"((?<!\\)\$(?:\\(?!text\b).|[^$\\])*\$)")
r"""A formula.  Inside ``\text{..}`` matplotlib leaves every command to LaTeX, so that one with it is plain text."""


def latex_program() -> str | None:
    """Name an installed LaTeX; None where there is none."""
    return next(filter(shutil.which, PROGRAMS), None)


@contextmanager
def as_latex() -> Iterator[None]:
    """Let matplotlib measure texts with the LaTeX that is there, and write their special characters as text.

    Raises a FileNotFoundError if no LaTeX is installed.
    """
    import matplotlib
    from matplotlib.backends.backend_pgf import RendererPgf

    program = latex_program()
    if program is None:
        raise FileNotFoundError(NO_LATEX)
    renderer: Any = RendererPgf
    measure, draw = renderer.get_text_width_height_descent, renderer.draw_text

    def measured(self: Any, s: str, prop: Any, ismath: Any) -> Any:
        return measure(self, _escaped(s, ismath=bool(ismath)), prop, ismath)

    def drawn(
        self: Any, gc: Any, x: Any, y: Any, s: str, prop: Any, angle: Any, ismath: Any = False, **more: Any
    ) -> None:
        draw(self, gc, x, y, _escaped(s, ismath=bool(ismath)), prop, angle, ismath, **more)

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
        plain = parts[place].replace(r"\$", "$")
        parts[place] = "".join(_SPECIAL.get(each, each) for each in plain)
    return "".join(parts)
