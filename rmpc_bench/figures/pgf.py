"""Figures as PGF, which a LaTeX document inputs: its texts are set by the document."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

PROGRAMS = ("pdflatex", "xelatex", "lualatex")
"""Programs that measure the texts, the preferred one first."""
NO_LATEX = f"pgf needs a LaTeX ({', '.join(PROGRAMS)}) on the search path, and there is none; choose pdf or svg"
_SPECIAL = {"\\": r"\textbackslash{}", "#": r"\#", "&": r"\&", "~": r"\textasciitilde{}", "{": r"\{", "}": r"\}"}
_FORMULA = re.compile(r"((?<!\\)\$(?:\\.|[^$\\])*\$)")


def latex_program() -> str | None:
    """Name an installed LaTeX; None where there is none."""
    return next(filter(shutil.which, PROGRAMS), None)


@contextmanager
def as_latex(figure: MplFigure) -> Iterator[None]:
    """Let matplotlib measure texts with the LaTeX that is there, and write its special characters as text.

    Raises
    ------
    FileNotFoundError
        If no LaTeX is installed.
    """
    import matplotlib
    from matplotlib.text import Text

    program = latex_program()
    if program is None:
        raise FileNotFoundError(NO_LATEX)
    changed = [(text, text.get_text()) for text in figure.findobj(Text)]
    with matplotlib.rc_context({"pgf.texsystem": program}):
        try:
            for text, usual in changed:
                text.set_text(_escaped(usual))
            yield
        finally:
            for text, usual in changed:
                text.set_text(usual)


def _escaped(text: str) -> str:
    """Write the characters as text that matplotlib leaves to LaTeX; it treats `_`, `^` and `%` itself."""
    parts = _FORMULA.split(text)
    for place in range(0, len(parts), 2):
        plain = parts[place].replace(r"\$", "$")
        parts[place] = "".join(_SPECIAL.get(each, r"\$" if each == "$" else each) for each in plain)
    return "".join(parts)
