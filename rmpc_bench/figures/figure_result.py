"""A drawn figure as the Python interface returns it: the matplotlib figure, its axes, and a way to save it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from rmpc_bench.figures.rendering import Rendering

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure


@dataclass(frozen=True, eq=False)
class FigureResult:
    """A drawn figure.

    Parameters
    ----------
    figure : the matplotlib figure, which may be adjusted
    rendering : font and style
    """

    figure: MplFigure
    rendering: Rendering = field(default_factory=Rendering)

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
        from rmpc_bench.figures.files import FORMATS, save_as
        from rmpc_bench.figures.style import rendered

        file = Path(path)
        if file.suffix.lower() not in FORMATS:
            raise ValueError(f"{file}: the ending gives the format, one of {', '.join(FORMATS)}")
        with rendered(self.rendering):
            save_as(self.figure, file)
        return file
