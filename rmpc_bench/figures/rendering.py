"""How figures are rendered: width, font, style and formats of all figures of a report."""

from __future__ import annotations

from dataclasses import dataclass

from rmpc_bench.types.report_choices import DEFAULT_FORMATS, Font, Format, Style


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """How all figures of a report are rendered.

    Parameters
    ----------
    width : width of every figure [in]; that of its configuration if None
    font : family of the texts and formulas
    style : ``bench`` for the screen, ``paper`` for a printed column
    formats : endings of the files to write
    labels : whether methods have their labels in place of their keys, as in files for papers
    """

    width: float | None = None
    font: Font = "dejavu"
    style: Style = "bench"
    formats: tuple[Format, ...] = DEFAULT_FORMATS
    labels: bool = False
