"""The section `report`: what tables and figures show, and how figures are written.

It belongs neither to the experiment hash nor to the trials.  Options of `rmpc-bench report` replace its keys.
This module imports no pydantic, since stored results are read without it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Len

from rmpc_bench.expressions.units import inches
from rmpc_bench.types.result_layout import DEFAULT_FORMATS, LEAST_WIDTH, MOST_WIDTH, Column, Font, Format, Style

Names = Annotated[list[str], Len(1)]
MOST_ROWS = 1_000_000  # rows of trials.csv that are written unasked, about 100 MB


@dataclass(frozen=True)
class ReportKeys:
    """What tables and figures show, and how figures are written.

    Parameters
    ----------
    order : methods to show, in this order; all in that of the configuration if not given
    width : width of all figures, such as 252pt, 88mm or 3.5in, where 72.27 pt are an inch; that of each figure if not
        given
    metrics : metrics to show in tables, in this order; figures without a `metric` show the first; all if not given
    columns : columns of the LaTeX tables behind the label of the method; the usual ones that fit into the width if not
        given
    style : `bench` for the screen, or `paper` for a printed column: thinner lines and no text that the caption repeats
    font : font of the figures; `times` is a Times font of the system, and STIX where there is none
    format : formats of the figures, one or a list
    trials : whether trials.csv is written, with a row per method and run; if not given, up to 1,000,000 rows are
    """

    order: Names | None = None
    width: str | None = None
    metrics: Names | None = None
    columns: Annotated[list[Column], Len(1)] | None = None
    style: Style = "bench"
    font: Font = "dejavu"
    format: Format | Annotated[list[Format], Len(1)] = field(default_factory=lambda: list(DEFAULT_FORMATS))
    trials: bool | None = None

    def __post_init__(self) -> None:
        """Refuse a width that is no length, or of no use."""
        if self.width is not None and not LEAST_WIDTH <= inches(self.width) <= MOST_WIDTH:
            raise ValueError(f"the width must be between {LEAST_WIDTH:g} in and {MOST_WIDTH:g} in (got {self.width})")
        for name in ("order", "metrics", "columns"):
            given = getattr(self, name) or []
            if len(set(given)) < len(given):
                raise ValueError(f"{name} must name each entry once (got {', '.join(given)})")

    @property
    def width_in(self) -> float | None:
        """Width of all figures [in]; None for that of each figure."""
        return None if self.width is None else inches(self.width)

    @property
    def formats(self) -> tuple[Format, ...]:
        """Formats of the figures, each once."""
        given = [self.format] if isinstance(self.format, str) else self.format
        return tuple(dict.fromkeys(given))

    def writes_trials(self, n_rows: int) -> bool:
        """Whether so many rows are written to trials.csv."""
        return n_rows <= MOST_ROWS if self.trials is None else self.trials
