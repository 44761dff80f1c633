"""Choices of a report: names of fonts, styles, formats and columns, shared by configuration, tables and figures."""

from __future__ import annotations

from typing import Literal

Font = Literal["dejavu", "stix", "times"]
Style = Literal["bench", "paper"]
Format = Literal["svg", "pdf", "png", "pgf"]
Column = Literal[
    "mean", "lost", "median", "change", "other", "counts", "superiority", "p", "verdict", "n", "held", "steps", "pairs"
]
"""Columns of the LaTeX table of a metric behind the label of the method; `other` is the change of the other average."""
DEFAULT_FORMATS: tuple[Format, ...] = ("svg", "pdf")
LEAST_WIDTH, MOST_WIDTH = 1.0, 100.0
"""Narrowest and widest figure [in]."""
