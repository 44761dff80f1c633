"""The figures of an experiment as files; those of a user are drawn by `run` only, which loads their code."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rmpc_bench.components.code import CodeError
from rmpc_bench.components.designs import is_built_in
from rmpc_bench.components.figure_names import figure_names
from rmpc_bench.components.loading import user_code
from rmpc_bench.config.short_forms import FILE
from rmpc_bench.execution.evaluation import figure_component, figure_of
from rmpc_bench.execution.results import Results
from rmpc_bench.figures.files import save
from rmpc_bench.figures.rendering import Rendering
from rmpc_bench.types import DesignError

OWN = "is not part of this package, and stored results are read without its code; `rmpc-bench run` draws it"


class WrittenFigure(NamedTuple):
    """A figure with its files."""

    name: str
    """File name without ending, such as ``boxplot`` or ``boxplot-2``."""
    kind: str
    """Kind, or the reference to a user's figure."""
    keys: Mapping[str, Any]
    """The keys of the configuration."""
    caption: str
    """What it shows, in full sentences."""
    paths: tuple[Path, ...]
    """One file per format."""


def write_figures(
    results: Results, directory: Path, rendering: Rendering
) -> tuple[tuple[WrittenFigure, ...], tuple[str, ...]]:
    """Draw the figures of an experiment.

    Parameters
    ----------
    results : what to draw
    directory : where the pictures are written
    rendering : width, font, style and formats

    Returns
    -------
    the figures, and what could not be drawn with the reason
    """
    figures: list[WrittenFigure] = []
    left_out: list[str] = []
    kinds = [str(keys.get(FILE) or keys["kind"]) for keys in results.experiment.figures]
    for number, (kind, stem) in enumerate(zip(kinds, figure_names(kinds), strict=True)):
        keys = results.experiment.figures[number]
        try:
            caption, paths = _written(results, number, directory / stem, rendering)
            figures.append(WrittenFigure(stem, kind, keys, caption, tuple(paths)))
        except DesignError as error:
            # A method that the figure shows has not been computed yet.
            left_out.append(f"{kind}: {error}")
        except CodeError as error:
            left_out.append(f"{kind}: {error.line}")
    return tuple(figures), tuple(left_out)


def _written(results: Results, number: int, stem: Path, rendering: Rendering) -> tuple[str, list[Path]]:
    """Draw a figure and write its files; return its caption and the files."""
    keys = results.experiment.figures[number]
    own = results.components.get(number)
    if own is not None:
        # The code of a user may raise anything; the tables and the other figures are written all the same.
        with user_code(None if own.code is None else own.code.path):
            made = figure_of(results, own)
            picture = made.draw(results.plotted)
            if not hasattr(picture, "savefig"):
                raise DesignError(f"draw returned {type(picture).__name__}, not a figure of matplotlib")
            return str(made.caption(results.plotted)), save(picture, stem.parent, stem.name, rendering.formats)
    if FILE in keys or not is_built_in("figures", keys["kind"]):
        raise DesignError(OWN)
    made = figure_of(results, figure_component(keys))
    picture = made.draw(results.plotted)
    return made.caption(results.plotted), save(picture, stem.parent, stem.name, rendering.formats)
